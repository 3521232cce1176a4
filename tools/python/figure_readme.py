"""Draws what a sonar heard of a simulated dive, the truth and the map side by side.

    python figure_readme.py DIVE_DIRECTORY MAP.ply OUT.webp

DIVE_DIRECTORY is what `echosplat simulate` wrote, MAP.ply what `echosplat replay` made of it, its
ambiguous part beside it. Needs matplotlib 3.8 or later, and numpy.
"""

import pathlib
import sys

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import ping_wire

# Opaque, so that the picture reads the same on a light and on a dark page.
BACKGROUND, TEXT = "#14181c", "#e4e8eb"
AMBIGUOUS = matplotlib.colors.to_rgba("#b9a3ea")
# How much of the dive the waterfall shows, seconds, and where the transducer rings, metres.
SHOWN_S, RINGING_M = 90, 0.5
# The size of a Gaussian of 1 m on the picture, in points.
POINTS_PER_M = 44
TYPES = {"float": "<f4", "double": "<f8", "uchar": "u1"}


def points(path):
    """Vertices of a binary PLY: positions in metres and normals, shape (n, 3) each, and one sigma
    along the longest axis of each Gaussian in metres, shape (n,), 0 for points without one."""
    data = pathlib.Path(path).read_bytes()
    end = data.index(b"end_header\n") + len(b"end_header\n")
    lines = [line.split() for line in data[:end].decode().splitlines()]
    layout = np.dtype([(line[2], TYPES[line[1]]) for line in lines if line[0] == "property"])
    count = next(int(line[2]) for line in lines if line[:2] == ["element", "vertex"])
    origin = next((line[2:] for line in lines if line[:2] == ["comment", "origin_m"]), [0, 0, 0])
    rows = np.frombuffer(data, layout, count, end)
    stack = lambda names: np.stack([rows[name].astype(float) for name in names], axis=1)
    scales = [name for name in layout.names if name.startswith("scale_")]
    sigmas = np.exp(stack(scales)).max(axis=1) if scales else np.zeros(count)
    return stack("xyz") + np.array(origin, float), stack(["nx", "ny", "nz"]), sigmas


def waterfall(log):
    """Echo power in dB, shape (bins, pings), seconds of the last ping, metres of the last bin."""
    decoder = ping_wire.Decoder()
    profiles = [
        ping_wire.Profile.unpack(frame.payload)
        for frame in decoder.feed(pathlib.Path(log).read_bytes())
        if frame.message_id == ping_wire.OS_MONO_PROFILE
    ]
    first_ms = profiles[0].timestamp_ms
    profiles = [p for p in profiles if p.timestamp_ms - first_ms <= SHOWN_S * 1000]
    columns = [
        p.min_pwr_db + np.array(p.pwr_results) / 65535 * (p.max_pwr_db - p.min_pwr_db)
        for p in profiles
    ]
    seconds = (profiles[-1].timestamp_ms - profiles[0].timestamp_ms) / 1000
    return np.stack(columns, axis=1), seconds, profiles[-1].length_mm / 1000


def draw_waterfall(figure, axes, log):
    power_db, seconds, range_m = waterfall(log)
    # The strongest of neighbouring pings, so that a pixel shows the echo that it holds.
    step = max(1, power_db.shape[1] // 600)
    whole = power_db.shape[1] // step * step
    power_db = power_db[:, :whole].reshape(len(power_db), -1, step).max(axis=2)
    beyond_ringing = power_db[int(RINGING_M / range_m * len(power_db)):]
    low, high = np.percentile(beyond_ringing, [50, 99.9])
    image = axes.imshow(power_db, origin="lower", aspect="auto", cmap="magma", vmin=low, vmax=high,
                        extent=(0, seconds, 0, range_m))
    axes.set(xlabel="time, s", ylabel="range, m", title="what the sonar hears")
    figure.colorbar(image, ax=axes, label="echo power, dB", orientation="horizontal", pad=0.17)


def draw_points(axes, box, title, surface, ambiguous=None):
    places, normals, sigmas = within(box, surface)
    low, high = box
    light = np.array([0.35, -0.75, 0.56])
    lit = 0.35 + 0.65 * np.abs(normals @ light)
    height = (places[:, 2] - low[2]) / (high[2] - low[2])
    colours = plt.get_cmap("viridis")(0.15 + 0.85 * np.clip(height, 0, 1))
    colours[:, :3] *= lit[:, None]
    sizes = np.clip(2 * sigmas * POINTS_PER_M, 1.4, 9) ** 2
    if ambiguous is not None:
        # In one scatter with the rest, which is sorted by depth as a whole.
        doubtful, _, _ = within(box, ambiguous)
        places = np.concatenate([places, doubtful])
        colours = np.concatenate([colours, np.tile(AMBIGUOUS, (len(doubtful), 1))])
        sizes = np.concatenate([sizes, np.full(len(doubtful), 1.0)])
    axes.scatter(*places.T, s=sizes, c=colours, linewidths=0, depthshade=False)
    axes.set_proj_type("ortho")
    axes.view_init(elev=22, azim=-62)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]), title=title)
    axes.set_xlabel("east, m")
    axes.set_ylabel("north, m")
    axes.set_zlabel("up, m", labelpad=-3)
    axes.set_box_aspect(high - low, zoom=1.0)
    axes.patch.set_visible(False)
    axes.tick_params(pad=-1, labelsize=8)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_pane_color((1, 1, 1, 0.03))
        axis.line.set_color(TEXT)
        axis._axinfo["grid"].update(color=(1, 1, 1, 0.12), linewidth=0.5)
        axis.set_major_locator(matplotlib.ticker.MultipleLocator(2))


def around_structure(places):
    """Corners of a box, whole metres: all that stands 0.2 m above the lowest place, and 1 m around."""
    standing = places[places[:, 2] > places[:, 2].min() + 0.2]
    low, high = np.floor(standing.min(axis=0) - [1, 1, 0]), np.ceil(standing.max(axis=0) + [1, 1, 0])
    return np.minimum(low, [*low[:2], np.floor(places[:, 2].min() - 0.1)]), high


def within(box, cloud):
    inside = np.all((cloud[0] >= box[0]) & (cloud[0] <= box[1]), axis=1)
    return tuple(column[inside] for column in cloud)


def main(dive, map_path, out):
    plt.rcParams.update({key: TEXT for key in ("text.color", "axes.labelcolor", "xtick.color",
                                               "ytick.color", "axes.edgecolor")})
    plt.rcParams.update({"figure.facecolor": BACKGROUND, "axes.facecolor": BACKGROUND,
                         "font.size": 10})
    truth = points(dive / "truth/seen.ply")
    confident, ambiguous = points(map_path), points(map_path.with_suffix(".ambiguous.ply"))
    box = around_structure(truth[0])

    figure = plt.figure(figsize=(13, 4.9), dpi=130)
    draw_waterfall(figure, figure.add_axes((0.05, 0.05, 0.25, 0.84)), dive / "dive.svlog")
    axes = figure.add_axes((0.315, 0.0, 0.33, 0.97), projection="3d")
    draw_points(axes, box, "the truth, as far as it came into sight", truth)
    axes = figure.add_axes((0.645, 0.0, 0.33, 0.97), projection="3d")
    draw_points(axes, box, "the map; violet: ambiguous", confident, ambiguous)
    figure.savefig(out)


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    main(pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2]), sys.argv[3])
