"""Holds what a program decoded to what was written."""
from dataclasses import dataclass, field

import numpy as np

from files import HARMONIC_0

# Numbers in text, and single precision.
RELATIVE, ABSOLUTE = 1e-4, 1e-6
# Of colours in eight bits.
STEP = 1.01 / 255
# Of normals, which some keep as the number of one of many directions.
DIRECTION = 0.01
# Columns that are told of together, where their names do not say so.
GROUPS = {"rot": "rotation", "cov": "covariance", "position_covariance_m2": "covariance"}


@dataclass
class Arrived:
    """Of one file in one program."""

    count: int
    triangles: int | None = None
    off_m: float | None = None
    colour: str | None = None
    columns: dict = field(default_factory=dict)


def is_same(a, b, absolute=ABSOLUTE):
    return a.shape == b.shape and np.allclose(a, b, rtol=RELATIVE, atol=absolute, equal_nan=True)


def logit(share):
    return np.log(share / (1 - share))


# Files of Gaussians say scales as logarithms and opacities as logits; what reads them may have turned that round.
FORMS = {
    "scale": {"in metres": np.exp, "as logarithms": np.log},
    "opacity": {"as a share": lambda x: 1 / (1 + np.exp(-x)), "as a logit": logit},
}


def arrival(name, values, decoded):
    """As what a column arrived, its own name or another, and in which form; `None` if it did not."""
    forms = {"": lambda x: x} | FORMS.get(group(name), {})
    absolute = {"opacity": STEP, "normal": DIRECTION}.get(group(name), ABSOLUTE)
    for form, of in forms.items():
        with np.errstate(all="ignore"):
            wanted = np.sort(of(values))
        same = [other for other, found in decoded.items() if is_same(wanted, found, absolute)]
        if same:
            return name if name in same else same[0], form
    return None


def group(name):
    """`scale_0` is of `scale`."""
    stem = name.rsplit("_", 1)[0] if name[-2:].startswith("_") or name.startswith("cov_") else name
    return "normal" if name in ("nx", "ny", "nz") else GROUPS.get(stem, stem)


def arrived(written, decoded):
    places, columns = decoded["places"], decoded["columns"]
    ordered = {name: np.sort(values) for name, values in columns.items() if len(values) == len(places)}
    found = Arrived(len(places), decoded.get("triangles"))
    if len(places) == len(written.places) > 0:
        # Each axis by itself: a program may keep the points in another order.
        found.off_m = float(np.abs(np.sort(places, 0) - np.sort(written.places, 0)).max())
        found.columns = {name: arrival(name, values, ordered) for name, values in written.columns.items()}
        found.colour = colour(written, decoded)
    return found


def colour(written, decoded):
    if written.colour is None:
        return None
    columns = decoded["columns"]
    if "colour" in decoded:
        got, as_what = decoded["colour"], "yes"
    elif "red" in columns:
        got, as_what = np.stack([columns[name] for name in ("red", "green", "blue")], 1) / 255, "yes"
    elif "f_dc_0" in columns:
        got, as_what = 0.5 + HARMONIC_0 * np.stack([columns[f"f_dc_{i}"] for i in range(3)], 1), "as f_dc"
    else:
        return "no"
    got, wanted = (np.sort(np.clip(array, 0, 1), 0) for array in (got, written.colour))
    is_it = got.shape == wanted.shape and np.abs(got - wanted).max() <= STEP
    return as_what if is_it else "another"
