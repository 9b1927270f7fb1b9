"""The measured part of the page, from raw numbers."""

import math
import re
from collections import Counter

from benchmarks.stability import courant, design, extremes
from benchmarks.stability.cells import DX, MATTERS
from benchmarks.stability.verdict import KINDS, LIMITS, Kind


def template(message: str) -> str:
    """A message without its numbers."""
    return re.sub(r"[-+]?(\d+\.?\d*|\.\d+|inf|nan)(e[-+]?\d+)?", "…", message)


def escaped(words: str) -> str:
    """Words in a cell of a table."""
    return words.replace("|", "\\|")


def counted(rows: list[dict]) -> dict[Kind, int]:
    """How many of each verdict."""
    found = Counter(r["verdict"] for r in rows)
    return {k: found[k] for k in KINDS}


def tally(rows: list[dict]) -> str:
    """The same as words."""
    return ", ".join(f"{n} {kind}" for kind, n in counted(rows).items())


def by_matter(data: dict) -> str:
    """Verdicts, worst numbers and margins of every matter."""
    head = "| matter | cells | stable | drift | error | silent | largest gain | largest loss at 0.1 c | deepest [Δx] |"
    lines = [head + " 1/J, J | float32 from float64 |", "|---|" + "--:|" * 10]
    for matter in dict.fromkeys(r["matter"] for r in data["cells"]):
        rows = [r for r in data["cells"] if r["matter"] == matter]
        n = counted(rows)
        lost = [r["lost"] for r in rows if r["place"] == "E" and math.isfinite(r["lost"])]
        worst = {k: max((r[k] for r in rows if math.isfinite(r[k])), default=math.nan) for k in LIMITS}
        kinds = " | ".join(str(n[k]) for k in KINDS)
        numbers = f"{worst['gain']:.1e} | {max(lost, default=math.nan):.0%} | {worst['sunk']:.2f}"
        lines.append(f"| {matter} | {len(rows)} | {kinds} | {numbers} | {worst['shrunk']:.2g} | {worst['apart']:.1e} |")
    return "\n".join(lines)


def unusual(data: dict) -> str:
    """Cells that are not stable, by what decided."""
    groups: dict[tuple[str, str], list[dict]] = {}
    for r in data["cells"]:
        if r["verdict"] not in ("stable", "error"):
            groups.setdefault((r["verdict"], r["why"].split(" ")[0]), []).append(r)
    if not groups:
        return "None."
    lines = ["| verdict | by | cells | speeds | ν | worst | of |", "|---|---|--:|---|---|--:|---|"]
    for (kind, by), rows in sorted(groups.items()):
        worst = max(rows, key=lambda r: r[by] if math.isfinite(r[by]) else math.inf)
        spans = [f"{min(r[k] for r in rows):.2g} … {max(r[k] for r in rows):.4g}" for k in ("speed", "nu")]
        numbers = f"{spans[0]} c | {spans[1]} | {worst[by]:.3g}"
        lines.append(f"| {kind} | {by} | {len(rows)} | {numbers} | {worst['matter']} |")
    return "\n".join(lines)


def messages(data: dict) -> str:
    """Every error once, with how often it came."""
    found: dict[str, list[str]] = {}
    for r in [*data["cells"], *data["long"]]:
        if r["verdict"] == "error":
            what = f"{r['matter']} at {r['speed']:.2g} c, ν = {r['nu']:.4g}, CFL {r['cfl']:.2g}, {r['precision']}"
            found.setdefault(template(r["why"]), [r["why"], what]).append(what)
    for r in data["refusals"]:
        if r["kind"] == "error":
            found.setdefault(template(r["why"]), [r["why"], r["input"]]).append(r["input"])
    lines = ["| when | times | what it says, and what to do |", "|---|--:|---|"]
    for message, first, *every in found.values():
        lines.append(f"| {first} | {len(every)} | {escaped(message)} |")
    return "\n".join(lines)


def long_runs(rows: list[dict]) -> str:
    """Runs of a hundred thousand substeps."""
    lines = ["| matter | precision | substeps | verdict | largest gain | momentum | deepest [Δx] | energy left |"]
    lines.append("|---|---|--:|---|--:|--:|--:|--:|")
    for r in rows:
        numbers = f"{r['gain']:.1e} | {r['momentum']:.2g} | {r['sunk']:.2f} | {1 - r['lost']:.1e}"
        verdict = r["verdict"] if r["verdict"] == "stable" else f"{r['verdict']}: {r['why'].split(';')[0]}"
        lines.append(f"| {r['matter']} | {r['precision']} | {r['substeps']} | {verdict} | {numbers} |")
    return "\n".join(lines)


def steps(rows: list[dict]) -> str:
    """Largest stable steps and margins."""
    columns = list(dict.fromkeys((r["alone"], r["nu"]) for r in rows))
    names = [f"{'alone' if alone else 'body'}, ν = {nu:g}" for alone, nu in columns]
    lines = ["| matter | " + " | ".join(names) + " | least, over what the clock takes |"]
    lines.append("|---|" + "--:|" * (len(columns) + 1))
    for matter in dict.fromkeys(r["matter"] for r in rows):
        found = [r["largest"] for r in rows if r["matter"] == matter]
        words = [f"> {v:g}" if v >= courant.HIGH else f"{v:.2f}" for v in found]
        lines.append(f"| {matter} | " + " | ".join(words) + f" | {min(found) / courant.CHOSEN:.1f} |")
    return "\n".join(lines)


def contract_table(rows: list[dict]) -> str:
    lines = ["| | case | checks | outside |", "|---|---|--:|---|"]
    lines += [f"| {r['id']} | {r['title']} | {r['checks']} | {'; '.join(r['outside']) or 'none'} |" for r in rows]
    return "\n".join(lines)


def far_table(rows: list[dict]) -> str:
    lines = ["| from the origin [m] | rounding of places [Δx], float32 | change of v, float32 | float64 |"]
    lines.append("|--:|--:|---|---|")
    for place in extremes.PLACES:
        single, double = (next(r for r in rows if r["place"] == place and r["precision"] == p)
                          for p in ("float32", "float64"))  # fmt: skip
        words = ["refused" if r["change"] is None else f"{r['change']:.1e}" for r in (single, double)]
        lines.append(f"| {place:g} | {2.0**-24 * place / DX:.1e} | {words[0]} | {words[1]} |")
    return "\n".join(lines)


def limits_table() -> str:
    lines = ["| | measured | stable to | silent beyond | why |", "|---|---|--:|--:|---|"]
    for k, v in LIMITS.items():
        lines.append(f"| {k} | {escaped(v.what)} | {v.stable:g} | {v.silent:g} | {escaped(v.why)} |")
    return "\n".join(lines)


def covered(data: dict) -> str:
    """How long it took, and of which matters there are no numbers."""
    missing = [m for m in MATTERS if m not in data["seconds"]]
    text = f"in {sum(data['seconds'].values()) / 60:.0f} minutes of one core"
    return text + (f"; **not measured yet:** {'; '.join(missing)}" if missing else "")


def generated(data: dict) -> str:
    """The measured part of the page."""
    cells, inner = data["cells"], [r for r in data["cells"] if r["place"] == "inside"]
    corner = [r for r in cells if r["place"] == "corner"]
    onlines = [r for r in cells if r["place"] in design.AXES]
    said = sum(r["kind"] == "error" for r in data["refusals"])
    bad = sum(r["kind"] == "silent" for r in data["refusals"]) + sum(len(r["outside"]) for r in data["contracts"])
    errors = [r for r in cells if r["verdict"] == "error"]
    cured = sum(r["cured"] in ("stable", "drift") for r in errors)
    silent = counted(cells)["silent"] + counted(data["long"])["silent"]
    return f"""Measured on {data["machine"]}, {covered(data)}.

**{silent} silent cells** among {len(cells)} of the map and {len(data["long"])} long runs; {said} of \
{len(data["refusals"])} impossible inputs refused; {bad} checks of the contract cases outside.

- on lines through the centre: {tally(onlines)}
- at corners: {tally(corner)}
- anywhere inside, {len(inner) // max(1, len({r["matter"] for r in inner}))} a matter: {tally(inner)}

Of the {len(errors)} errors of the map {cured} are gone at a third of the speed, as their remedy has it.

![Lines through the centre of the map](stability_lines.png)

![Corners of the map](stability_corners.png)

### What counts

{limits_table()}

### By matter

{by_matter(data)}

### Cells that are neither stable nor an error

{unusual(data)}

### Largest stable time step

![Largest stable time step](stability_steps.png)

{steps(data["courant"])}

### A hundred thousand substeps

{long_runs(data["long"])}

### Extreme input

{contract_table(data["contracts"])}

### Far from the origin

{far_table(data["far"])}

### Every error, and what to do

{messages(data)}
"""
