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


def silent(data: dict) -> list[dict]:
    """Runs that were wrong without a word, less those of which the page says so."""
    return [r for r in [*data["cells"], *data["long"]] if r["verdict"] == "silent" and r["place"] != "small"]


def worst(rows: list[dict], name: str) -> float:
    """The largest finite value; NaN where there is none."""
    return max((r[name] for r in rows if math.isfinite(r[name])), default=math.nan)


def by_law(data: dict) -> str:
    """What a reader looks for first: largest steps, energy, and what float32 changes."""
    head = "| matter | stable to c Δt/Δx, body | particle alone | largest gain of energy | in 10⁵ substeps |"
    lines = [head + " float32 from float64 |", "|---|" + "--:|" * 5]
    for matter in dict.fromkeys(r["matter"] for r in data["cells"]):
        its, long = ([r for r in rows if r["matter"] == matter] for rows in (data["cells"], ordinary(data)))
        least = [
            min(r["largest"] for r in data["courant"] if r["matter"] == matter and r["alone"] == a) for a in (0, 1)
        ]
        numbers = [largest(v) for v in least] + [f"{worst(rows, 'gain'):.0e}" for rows in (its, long)]
        lines.append(f"| {matter} | " + " | ".join([*numbers, f"{worst(its, 'apart'):.0e}"]) + " |")
    return "\n".join(lines)


def ordinary(data: dict) -> list[dict]:
    """Long runs of the body of the map."""
    return [r for r in data["long"] if r["place"] == "long"]


def by_matter(data: dict) -> str:
    """Verdicts and worst numbers of every matter."""
    head = "| matter | cells | stable | drift | error | silent | largest gain | largest loss at 0.1 c | deepest [Δx] |"
    lines = [head + " 1/J, J | float32 from float64 |", "|---|" + "--:|" * 10]
    for matter in dict.fromkeys(r["matter"] for r in data["cells"]):
        rows = [r for r in data["cells"] if r["matter"] == matter]
        kinds = " | ".join(str(n) for n in counted(rows).values())
        lost = worst([r for r in rows if r["place"] == "E"], "lost")
        numbers = f"{worst(rows, 'gain'):.1e} | {lost:.0%} | {worst(rows, 'sunk'):.2f} | {worst(rows, 'shrunk'):.2g}"
        lines.append(f"| {matter} | {len(rows)} | {kinds} | {numbers} | {worst(rows, 'apart'):.1e} |")
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
        last = max(rows, key=lambda r: r[by] if math.isfinite(r[by]) else math.inf)
        spans = [f"{min(r[k] for r in rows):.2g} … {max(r[k] for r in rows):.4g}" for k in ("speed", "nu")]
        numbers = f"{spans[0]} c | {spans[1]} | {last[by]:.3g}"
        lines.append(f"| {kind} | {by} | {len(rows)} | {numbers} | {last['matter']} |")
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
    """Runs of a hundred thousand substeps; of the small ones the size and the floor as well."""
    small = rows and rows[0]["place"] == "small"
    names = ("matter", "cells", "floor", "precision") if small else ("matter", "precision")
    head = "| substeps | verdict | largest gain | momentum, in roundings | 1/J, J | deepest [Δx] | energy left |"
    lines = [f"| {' | '.join(names)} {head}", "|" + "---|" * len(names) + "--:|---|" + "--:|" * 5]
    for r in rows:
        who = (r["matter"], f"{r['side']}³", r["contact"], r["precision"]) if small else (r["matter"], r["precision"])
        verdict = r["verdict"] if r["verdict"] == "stable" else f"{r['verdict']}: {r['why'].split(';')[0]}"
        numbers = f"{r['gain']:.0e} | {r['momentum']:.1g} | {r['shrunk']:.3g} | {r['sunk']:.2f} | {1 - r['lost']:.0e}"
        lines.append(f"| {' | '.join(who)} | {r['substeps']} | {verdict} | {numbers} |")
    return "\n".join(lines)


def largest(number: float) -> str:
    """A Courant number as it was found."""
    return f"> {number:g}" if number >= courant.HIGH else f"{number:.2f}"


def steps(rows: list[dict]) -> str:
    """Largest stable steps and margins."""
    columns = list(dict.fromkeys((r["alone"], r["nu"]) for r in rows))
    names = [f"{'alone' if alone else 'body'}, ν = {nu:g}" for alone, nu in columns]
    lines = ["| matter | " + " | ".join(names) + " | least, over what the clock takes |"]
    lines.append("|---|" + "--:|" * (len(columns) + 1))
    for matter in dict.fromkeys(r["matter"] for r in rows):
        found = [r["largest"] for r in rows if r["matter"] == matter]
        words = [largest(v) for v in found]
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


def short(data: dict) -> str:
    """What the page says first."""
    cells, long, small = data["cells"], ordinary(data), [r for r in data["long"] if r["place"] == "small"]
    every = [*cells, *data["long"], *(r | {"verdict": r["kind"]} for r in data["refusals"])]
    said = {template(r["why"]) for r in every if r["verdict"] == "error"}
    drifts = [r for r in cells if r["verdict"] == "drift"]
    names = ", ".join(sorted({f"`{r['why'].split(' ')[0]}`" for r in drifts}))
    where = f", all at {min(r['speed'] for r in drifts):.2g} c or faster, by {names}" if drifts else ""
    single = [r for r in data["far"] if r["precision"] == "float32"]
    place, change = max((r["place"], r["change"]) for r in single if r["change"] is not None)
    refused = min(r["place"] for r in single if r["change"] is None)
    bad = counted(small)["silent"]
    body, alone = (min(r["largest"] for r in data["courant"] if r["alone"] == a) for a in (False, True))
    return f"""**{len(silent(data))} silent cells:** of {len(cells)} in the map {tally(cells)}; of {len(long)} runs of \
a hundred thousand substeps {tally(long)}.

- *Drift:* {len(drifts)} cells{where}; the deepest particle was {worst(cells, "sunk"):.2f} Δx below the floor.
- *Energy:* the largest gain in the map is {worst(cells, "gain"):.0e} of what was put in, in the long runs \
{worst(long, "gain"):.0e}.
- *Steps:* bodies are stable to c Δt/Δx = {body:.2f} at least, a particle alone to {alone:.2f}; the clock takes \
{courant.CHOSEN} and refuses a pinned step beyond {courant.STABLE}.
- *float32* ends within {worst(cells, "apart"):.0e} of the side of the body from float64 in every cell that ends well. \
It is refused where it does not tell places apart: with cells of {DX:g} m it is right to {change:.0e} at {place:g} m \
from the origin, and refused at {refused:g} m.
- *Errors:* {len(said)} different messages, each quoted [below](#every-error-and-what-to-do) with its remedy.
- *Small bodies at rest:* {bad} of {len(small)} long runs of bodies of one and two cells do not stay at rest, on \
elastic floors; a warning says so when such a run begins, see [below](#small-bodies-at-rest).

{by_law(data)}

*Gain* is the largest rise of the energy over all that was put in; steps are the least of ν = \
{", ".join(f"{nu:g}" for nu in dict.fromkeys(r["nu"] for r in data["courant"]))}.
"""


def generated(data: dict) -> str:
    """The measured part of the page."""
    cells, inner = data["cells"], [r for r in data["cells"] if r["place"] == "inside"]
    corner = [r for r in cells if r["place"] == "corner"]
    onlines = [r for r in cells if r["place"] in design.AXES]
    said = sum(r["kind"] == "error" for r in data["refusals"])
    bad = sum(r["kind"] == "silent" for r in data["refusals"]) + sum(len(r["outside"]) for r in data["contracts"])
    errors = [r for r in cells if r["verdict"] == "error"]
    cured = sum(r["cured"] in ("stable", "drift") for r in errors)
    gone = (
        f"Of the {len(errors)} errors of the map {cured} are gone at a third of the speed, as their remedy has it.\n\n"
    )
    return f"""Measured on {data["machine"]}, {covered(data)}. {said} of {len(data["refusals"])} impossible inputs \
were refused; {bad} checks of the contract cases are outside.

- on lines through the centre: {tally(onlines)}
- at corners: {tally(corner)}
- anywhere inside, {len(inner) // max(1, len({r["matter"] for r in inner}))} a matter: {tally(inner)}

{gone if errors else ""}![Lines through the centre of the map](stability_lines.png)

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

Bodies fly freely here: what bears no tension falls apart and carries no wave that could grow.

### A hundred thousand substeps

{long_runs(ordinary(data))}

### Small bodies at rest

{long_runs([r for r in data["long"] if r["place"] == "small"])}

### Extreme input

{contract_table(data["contracts"])}

### Far from the origin

{far_table(data["far"])}

### Every error, and what to do

{messages(data)}
"""
