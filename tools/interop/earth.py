#!/usr/bin/env python3
"""Are exports on Earth where PROJ has them? earth.py ECHOSPLAT MAP.ply POSES.tum

Needs pyproj 3.7.2, laspy[lazrs] 2.7.0, rasterio 1.4.4, rio-cogeo 7.0.4 and geojson 3.3.0. Places the map at 60° north, south of
the equator and on the antimeridian, and says how far LAS, LAZ, COG, CSV and GeoJSON are off. Ends with 1 beyond a centimetre."""
import csv, pathlib, subprocess, sys, tempfile

import geojson, laspy, numpy as np, rasterio
from pyproj import Transformer
from rio_cogeo.cogeo import cog_validate

PLACES = [(60.17, 24.94, -3.0), (-33.86, 151.21, -8.25), (-16.79, 179.99998, 3.0)]
MOST_M = 0.01


def topocentric(place):
    """World metres to longitude, latitude and height, by PROJ alone."""
    lat, lon, height = place
    x, y, z = Transformer.from_crs(4979, 4978, always_xy=True).transform(lon, lat, height)
    steps = f"+step +inv +proj=topocentric +ellps=WGS84 +X_0={x!r} +Y_0={y!r} +Z_0={z!r} +step +inv +proj=cart +ellps=WGS84"
    return Transformer.from_pipeline(f"+proj=pipeline {steps} +step +proj=unitconvert +xy_in=rad +xy_out=deg")


def places_of(map_file):
    """Of a map without an origin of its own: its centres, metres."""
    head, _, body = map_file.read_bytes().partition(b"end_header\n")
    lines = [line.split() for line in head.decode().splitlines()]
    origin = next([float(x) for x in line[2:]] for line in lines if line[:2] == ["comment", "origin_m"])
    kinds = {"float": "<f4", "double": "<f8", "uchar": "u1"}
    names = [(line[2], kinds[line[1]]) for line in lines if line[0] == "property"]
    rows = np.frombuffer(body, np.dtype(names))
    return [rows[axis].astype(float) + shift for axis, shift in zip("xyz", origin)]


def off_m(found, expected):
    return max(float(np.abs(np.asarray(a) - np.asarray(b)).max()) for a, b in zip(found, expected))


def check(program, map_file, poses, place, folder):
    def export(name, *more):
        origin = ["--origin", ",".join(map(str, place)), "--datum", "ellipsoid"]
        subprocess.run([program, "export", map_file, folder / name, *origin, *more], check=True, capture_output=True)
        return folder / name

    lon, lat, height = topocentric(place).transform(*places_of(map_file))
    las = laspy.read(export("map.las"))
    crs = las.header.parse_crs()
    east, north = Transformer.from_crs(4326, crs, always_xy=True).transform(lon, lat)
    told = {"las": off_m((las.x, las.y, las.z), (east, north, height))}
    laz = laspy.read(export("map.laz"))
    told["laz"] = off_m((laz.x, laz.y, laz.z), (east, north, height))
    for cell in ("0.1", "0.01"):
        tif = export("map.tif", "--cell", cell)
        is_valid, errors, warnings = cog_validate(tif)
        if not is_valid or warnings:
            sys.exit(f"{tif}: {errors} {warnings}")
        with rasterio.open(tif) as found:
            highest, (left, top), size = found.read(1), (found.bounds.left, found.bounds.top), found.res
            row, column = np.floor((top - north) / size[1]).astype(int), np.floor((east - left) / size[0]).astype(int)
            expected = np.full(highest.shape, -np.inf)
            np.maximum.at(expected, (row, column), height)
        filled = np.isfinite(expected)
        if (np.isfinite(highest) != filled).any():
            sys.exit(f"{tif}: other cells are filled")
        told[f"tif {cell} {highest.shape[1]}x{highest.shape[0]}"] = off_m([highest[filled]], [expected[filled]])
    rows = list(csv.DictReader(open(export("track.csv", "--track", poses))))
    number = lambda name: [float(row[name]) for row in rows]
    lon, lat, height = topocentric(place).transform(number("x_m"), number("y_m"), number("z_m"))
    east, north = Transformer.from_crs(4326, crs, always_xy=True).transform(lon, lat)
    names = [name for name in rows[0] if name.startswith(("east", "north"))]
    told["csv"] = off_m(map(number, [*names, "height_ellipsoid_m"]), (east, north, height))
    shapes = geojson.load(open(export("dive.geojson", "--track", poses)))
    if not (shapes.is_valid and all(feature.geometry.is_valid for feature in shapes.features)):
        sys.exit("dive.geojson is not valid")
    kinds = "/".join(feature.geometry.type for feature in shapes.features)
    print(f"{place}: {crs.name}, {kinds}; " + ", ".join(f"{name} {off * 1e3:.3f} mm" for name, off in told.items()))
    return max(told.values())


def main():
    program, map_file, poses = map(pathlib.Path, sys.argv[1:])
    with tempfile.TemporaryDirectory() as folder:
        worst = max(check(program.resolve(), map_file, poses, place, pathlib.Path(folder)) for place in PLACES)
    sys.exit(worst > MOST_M)


if __name__ == "__main__":
    main()
