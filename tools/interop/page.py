"""The tables, and their place in the page."""
from files import DIVES
from judge import group
from programs import version_of

BEGIN, END = "<!-- interop: begin -->", "<!-- interop: end -->"


def tables(points, messages):
    return "\n".join([*point_table(points), "", *message_table(messages)])


def point_table(rows):
    head = line("file", "program", *DIVES, "places", "colour", "sigma", "lost")
    lines = [head, "|---" * (len(DIVES) + 6) + "|"]
    seen = None
    for row in rows:
        if row.file != seen:
            seen = row.file
            counts = [count(len(w.places), w.triangles) for w in row.written.values()]
            some = next(iter(row.written.values()))
            told = ["none" if some.colour is None else "yes", "yes" if sigma_of(some) else "none"]
            lines.append(line(f"**`{row.file}`**", "*written*", *counts, "", *told, ""))
        lines.append(line("", f"{row.program} {version_of(row.program)}", *cells(row)))
    return lines


def cells(row):
    found = [arrival for arrival in row.arrived.values() if not isinstance(arrival, str)]
    counts = [cell(arrival, row.written[dive]) for dive, arrival in row.arrived.items()]
    if len(found) == 0:
        return [*counts, "", "", "", ""]
    # A map without Gaussians tells nothing of columns.
    told = [arrival for arrival in found if arrival.off_m is not None]
    off_m = max((arrival.off_m for arrival in told), default=None)
    best = told[0] if told else found[0]
    sigma = sigma_of(best)
    return [*counts, places(off_m), best.colour or "", sigma and (best.columns[sigma] or ["no"])[0] or "", lost(best)]


def cell(arrival, written):
    """How many arrived, or the word why none."""
    if isinstance(arrival, str):
        return f"– ({arrival})"
    return count(arrival.count, None if written.triangles is None else arrival.triangles)


def places(off_m):
    if off_m is None:
        return ""
    return "exact" if off_m < 2e-4 else f"off by {off_m:.2g} m"


def sigma_of(of):
    return next((name for name in ("sigma", "sigma_m") if name in of.columns), None)


def lost(best):
    """Columns that did not arrive, by their groups, and those that did in another form."""
    of_groups = {}
    for name, came in best.columns.items():
        of_groups.setdefault(group(name), []).append(came)
    if best.colour == "yes":
        of_groups.pop("f_dc", None)
    gone = [name for name, came in of_groups.items() if not all(came)]
    forms = [f"{name} {came[0][1]}" for name, came in of_groups.items() if all(came) and came[0][1]]
    kept = [name for name in of_groups if name not in gone]
    if of_groups and len(kept) <= 1 and len(gone) > 2:
        gone = [", ".join(["all but places", *(["colour"] if best.colour == "yes" else []), *kept])]
    return "; ".join(filter(None, [", ".join(gone), ", ".join(forms)]))


def count(points, triangles):
    return f"{points:,}" if triangles is None else f"{points:,} / {triangles:,}"


def message_table(rows):
    lines = ["| file | program | written | decoded | what |", "|---|---|---|---|---|"]
    seen = None
    for row in rows:
        name = "" if row.file == seen else f"**`{row.file}`**"
        seen = row.file
        total = sum(row.written.values())
        if isinstance(row.arrived, str):
            lines.append(line(name, f"{row.program} {version_of(row.program)}", f"{total:,}", f"– ({row.arrived})", ""))
            continue
        decoded = sum(min(row.arrived.get(topic, 0), n) for topic, n in row.written.items())
        lines.append(line(name, f"{row.program} {version_of(row.program)}", f"{total:,}", f"{decoded:,}", what(row)))
    return lines


def what(row):
    if list(row.written) == ["rows"]:
        return "poses" if row.file.endswith(".tum") else "pings"
    lacking = [f"`{topic}`" for topic, n in row.written.items() if row.arrived.get(topic, 0) != n]
    channels = f"{len(row.written) - len(lacking)} of {len(row.written)} channels"
    as_bytes = sum(topic.endswith(" as bytes") for topic in row.written)
    channels += f", {as_bytes} of JSON as bytes" if as_bytes else ""
    return channels + (f", not {', '.join(lacking)}" if lacking else "")


def line(*cells):
    return "| " + " | ".join(cells) + " |"


def put(file, text):
    """Between the two comments; the page around them is written by hand."""
    before, rest = file.read_text().split(BEGIN)
    _, after = rest.split(END)
    file.write_text(f"{before}{BEGIN}\n{text}\n{END}{after}")
