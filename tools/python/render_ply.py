"""Renders pings from a map of 3-D Gaussians, in double precision and from the formulas alone.

    python render_ply.py MAP.ply --poses F.tum --ping 0 10 20 > pings.json

The sensor looks along its x, y is left, z is up. In its frame, for one beam turned to the beam's
axis, a Gaussian with mean q = (x, y, z) and covariance S has range r = |q|, azimuth θ = atan2(y, x)
and elevation φ = atan2(z, ρ), ρ = √(x² + y²), with covariance C = J S Jᵀ, J being the derivative of
(r, θ, φ) by (x, y, z). With the beam's pattern exp(−θ²/2σb²) across and g(φ) = 2^−(φ/φh)⁸ along,
σb = width/2.35482, φh half the fan's width, bin b between r_b and r_b+1 receives

    I_b = U ρ α Ω g(φ) σb/√V exp(−θ²/2V) [Φ((r_b+1 − r′)/s) − Φ((r_b − r′)/s)]
    Ω   = 2π cos φ √det C_θφ
    V   = σb² + σa² + C_θθ
    r′  = r − θ C_rθ/V
    s²  = C_rr + σp² − C_rθ²/V

where U is the map's intensity unit, α the opacity, ρ the reflectivity, σa one sigma of the
sensor's attitude, and σp² the variance of the pulse (as wide at half its height as it is long,
c·duration/2) and of the sensor's position. Left out are Gaussians nearer than 5 cm, with x ≤ r/4,
with θ² > 2.8² V, or with g ≤ 0.001; and of each the bins that lie wholly further than 3 s from r′.
Nothing hides anything, as in the mapper's own model.
"""

import argparse
import json
import math
import pathlib

import numpy as np

FWHM = 2.35482  # full width at half maximum of a Gaussian, in sigmas
erf = np.frompyfunc(math.erf, 1, 1)


# Numbers are floats, bytes where they are colours, and doubles where they say why.
KINDS = {"float": "<f4", "double": "<f8", "uchar": "u1"}


def read_ply(path):
    """Rows of numbers by name, and the header's origin and intensity unit."""
    data = pathlib.Path(path).read_bytes()
    end = data.index(b"end_header\n") + len(b"end_header\n")
    lines = [line.split() for line in data[:end].decode().splitlines()]
    assert ["format", "binary_little_endian", "1.0"] in lines, "not a map"
    names = [line[2] for line in lines if line[0] == "property"]
    types = [KINDS[line[1]] for line in lines if line[0] == "property"]
    notes = {line[1]: line[2:] for line in lines if line[0] == "comment"}
    count = next(int(line[2]) for line in lines if line[:2] == ["element", "vertex"])
    rows = np.frombuffer(data, np.dtype(list(zip(names, types))), count, end)
    origin = np.array([float(x) for x in notes.get("origin_m", [0, 0, 0])])
    return rows, origin, float(notes.get("intensity_unit", [1])[0])


def rotation(w, x, y, z):
    """Matrices of quaternions of any length, shape [n, 3, 3]."""
    n = np.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w / n, x / n, y / n, z / n
    return np.moveaxis(np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]), -1, 0)


def load(path):
    """Means in the world, covariances and strengths of a map with its ambiguous part."""
    path = pathlib.Path(path)
    beside = path.with_name(path.stem + ".ambiguous.ply")
    parts = []
    for file in [path] + ([beside] if beside.exists() else []):
        rows, origin, unit = read_ply(file)
        column = {name: rows[name].astype(float) for name in rows.dtype.names}
        stack = lambda *names: np.stack([column[name] for name in names], axis=-1)
        axes = rotation(*(column[f"rot_{k}"] for k in range(4)))
        scaled = axes * np.exp(stack("scale_0", "scale_1", "scale_2"))[:, None, :]
        opacity = 1 / (1 + np.exp(-column["opacity"]))
        strength = opacity * column["reflectivity"] * unit
        covariance = scaled @ np.swapaxes(scaled, 1, 2)
        parts.append((stack("x", "y", "z") + origin, covariance, strength))
    return [np.concatenate(column) for column in zip(*parts)]


def project(q, S):
    """(r, θ, φ) of means and their covariances."""
    x, y, z = q.T
    rho, r = np.hypot(x, y), np.linalg.norm(q, axis=1)
    zero = np.zeros_like(x)
    J = np.moveaxis(np.array([
        [x / r, y / r, z / r],
        [-y / rho**2, x / rho**2, zero],
        [-x * z / (r**2 * rho), -y * z / (r**2 * rho), rho / r**2],
    ]), -1, 0)
    return r, np.arctan2(y, x), np.arctan2(z, rho), J @ S @ np.swapaxes(J, 1, 2)


def render(gaussians, position, orientation_xyzw, o):
    """Intensity per bin of one ping."""
    mean, covariance, strength = gaussians
    x, y, z, w = (np.array([number]) for number in orientation_xyzw)
    axes = rotation(w, x, y, z)[0]
    q, S = (mean - position) @ axes, axes.T @ covariance @ axes
    sigma_b = math.radians(o.beam_deg) / FWHM
    sigma_a, fan_half = math.radians(o.attitude_sigma_deg), math.radians(0.5 * o.fan_deg)
    sigma = math.hypot(sigma_b, sigma_a)
    sigma_p2 = (0.5 * o.pulse_us * 1e-6 * o.speed_of_sound / FWHM) ** 2 + o.position_sigma_m**2

    r, rho = np.linalg.norm(q, axis=1), np.hypot(q[:, 0], q[:, 1])
    seen = (r > 0.05) & (q[:, 0] > 0.25 * r)
    seen &= 2.0 ** -((np.arctan2(q[:, 2], rho) / fan_half) ** 8) > 1e-3
    q, S, strength = q[seen], S[seen], strength[seen]

    r, theta, phi, C = project(q, S)
    V = sigma**2 + C[:, 1, 1]
    omega = 2 * math.pi * np.cos(phi) * np.sqrt(np.maximum(np.linalg.det(C[:, 1:, 1:]), 0))
    g = 2.0 ** -((phi / fan_half) ** 8)
    energy = strength * omega * g * sigma_b / np.sqrt(V) * np.exp(-0.5 * theta**2 / V)
    energy[theta**2 > 2.8**2 * V] = 0
    middle = r - theta * C[:, 0, 1] / V
    s = np.sqrt(C[:, 0, 0] + sigma_p2 - C[:, 0, 1] ** 2 / V)
    edges = np.linspace(o.start_m, o.range_m, o.bins + 1)
    z = (edges - middle[:, None]) / s[:, None]
    below = 0.5 * (1 + erf(z / math.sqrt(2)).astype(float))
    heard = np.where((z[:, 1:] > -3) & (z[:, :-1] < 3), np.diff(below, axis=1), 0)
    return energy @ heard


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("map")
    parser.add_argument("--poses", required=True, help="TUM file")
    parser.add_argument("--ping", type=int, nargs="+", required=True, help="poses, from 0")
    parser.add_argument("--start-m", type=float, default=0.0)
    parser.add_argument("--range-m", type=float, default=10.0)
    parser.add_argument("--bins", type=int, default=600)
    parser.add_argument("--speed-of-sound", type=float, default=1500.0)
    parser.add_argument("--pulse-us", type=float, default=20.0)
    parser.add_argument("--position-sigma-m", type=float, default=0.0)
    parser.add_argument("--attitude-sigma-deg", type=float, default=0.0)
    parser.add_argument("--beam-deg", type=float, default=0.8)
    parser.add_argument("--fan-deg", type=float, default=50.0)
    options = parser.parse_args()
    lines = pathlib.Path(options.poses).read_text().splitlines()
    poses = [line.split() for line in lines if line.strip() and not line.startswith("#")]
    gaussians = load(options.map)
    pings = []
    for number in options.ping:
        pose = [float(field) for field in poses[number][1:8]]
        pings.append(render(gaussians, np.array(pose[:3]), pose[3:], options).tolist())
    print(json.dumps({"pings": pings}))


if __name__ == "__main__":
    main()
