"""docs/numerics/accuracy.md: the cases, their figures, and what the rows say about the default."""

from collections.abc import Sequence
from dataclasses import dataclass

from benchmarks.work_precision.references import kept
from benchmarks.work_precision.report import observed, spread, table, verdict, verdicts
from benchmarks.work_precision.rows import Row

HEAD = """# Accuracy

How wrong a simulation is, and what it would cost to halve that. Written by `python -m benchmarks work_precision`; every
number is from the files beside the figures.

Each case is swept over the grid spacing with the default settings, then with one of them changed at a time, and run by
other codes where the interpreter given has them. Seconds are processor time of one thread from the state at the start
to that at the end, compilation apart: medians over repeats that take turns there and back (ABBA). *A/A* is the largest
difference between two sets of repeats of the same run: smaller differences mean nothing.

A point lies on the front if nothing else is less wrong (by more than 2 %) and not slower, or faster (by more than A/A)
and not more wrong. `order` is the slope of the error over resolution, `M/s` the best throughput [million
particle-substeps a second]. `time to e` is what it takes to be as good as the default at its middle resolution, over
the time of the default, read off between points; `>` and `<` where a sweep does not get there.
"""

REASONS = {
    "CFL": "a substep of 0.4 leaves a factor two for stiffening while a body is squeezed, when sound is faster than at "
    "rest; scenes that do not squeeze may have larger ones (`cfl` of a scene)",
    "order": "cubic splines reach 64 nodes instead of 27 and feel walls and bodies from half a cell farther away; they "
    "pay where smooth motion is wanted more accurate than a film shows (`order` of a scheme)",
    "force": "forces from the gradient of the weights cost more a substep, and elsewhere gain nothing (`force` of a "
    "scheme)",
    "precision": "float64 takes twice the memory, and on most GPUs many times as long; displacements and strains are "
    "stored instead of positions, so that float32 is as accurate until errors are far below what is seen",
    "particles": "fewer particles leave holes in matter that is stretched, more cost more at the same Δx; eight a cell "
    "keep the error of quadrature below that of the grid when it is (`particles_per_cell`)",
    "transfer": "the plain schemes lose energy with every substep and have walls of first order, as the other cases "
    "show",
    "contact": "elastic contact is what films are made with: bodies touch before they turn; rigid contact is the "
    "default of scenes since it holds thin layers better",
    "part": "each part of the transfer pays in other cases: sharpening in waves, retention at small steps, the half "
    "kick and mirrors at walls",
    "checkpoints": "keeping more states takes more memory, as the second panel shows; by default the backward pass "
    "keeps as many as fit its budget",
    "alpha_min": "1/255 is one step of an 8-bit image, and less is not seen",
    "T_min": "what lies behind 99.99 % of coverage changes a pixel by less than a tenth of a step of an 8-bit image",
    "tile": "tiles of 32 pixels fit the first-level cache; which is fastest depends on machine and picture",
    "driver": "the driver is chosen by device: tiles on a CPU, a thread a pixel on a GPU",
    "peer": "it is another code",
}
"""Why a setting that beats the default somewhere is not the default, by what it varies."""


@dataclass(frozen=True)
class Section:
    """A case on the page."""

    id: str
    title: str
    norm: str
    unit: str
    """What resolutions count."""
    about: str
    """The problem, in words."""
    rows: list[Row]
    noise: float
    """A/A: relative difference of equal runs."""


def why(section: Section) -> str:
    """Reasons for all that beats the default, each once."""
    axes = {r.series: r.axis for r in section.rows}
    found = dict.fromkeys(axes[p.series] for _, by in verdicts(section.rows, section.noise) for p in by)
    return "".join(f"\n- {axis}: {REASONS[axis]}." for axis in found)


def body(s: Section) -> str:
    """Markdown of one case."""
    figure = f"![Error of {s.title} against time](../benchmarks/work_precision/{s.id}.svg)"
    text = f"\n## {s.id}: {s.title}\n\n{s.about}\n\n{figure}\n\nError: {s.norm}; resolution: {s.unit}."
    known = kept().get(s.id)
    if known:
        orders = ", ".join(f"{name} {p}" for name, p in known["orders"].items())
        cells = ", ".join(map(str, known["cells"]))
        text += f" Reference: Richardson's limit of {cells} cells with the default (orders observed: {orders});"
        text += f" that of plain APIC is {known['uncertainty']:.1g} away, and errors below that say how fast a scheme"
        text += " comes to its own limit, not which limit is right."
    text += f" A/A {100 * s.noise:.1f} %, quartiles {100 * spread(s.rows):.1f} % apart."
    if len({r.cells for r in s.rows if r.series == "default"}) > 1:
        text += f" Orders of the default between neighbours: {observed(s.rows)}."
    return f"{text}\n\n{verdict(s.rows, s.noise)}\n{why(s)}\n\n{table(s.rows)}"


def summary(sections: Sequence[Section]) -> str:
    """A line a case: where the default is on the front."""
    text = "\n| case | default on the front | beaten somewhere by |\n|---|--:|---|\n"
    for s in sections:
        found = verdicts(s.rows, s.noise)
        names = ", ".join(dict.fromkeys(p.series for _, by in found for p in by)) or "nothing"
        text += f"| [{s.id}](#{anchor(s)}) {s.title} | {sum(not by for _, by in found)} of {len(found)} | {names} |\n"
    return text


def anchor(s: Section) -> str:
    """What a link to the heading of a case says."""
    return f"{s.id}: {s.title}".lower().replace(":", "").replace(" ", "-")


def compiling(sections: Sequence[Section]) -> str:
    """How long first runs took more than later ones."""
    own = [(r, s.id) for s in sections for r in s.rows if r.compiling is not None and r.axis != "peer"]
    if not own:
        return ""
    most, where = max(own, key=lambda f: f[0].compiling or 0.0)
    total = sum(r.compiling or 0.0 for r, _ in own)
    text = f"\nThe first run of each of {len(own)} settings took {total:.0f} s more than the later ones in all, for "
    text += "kernels that were compiled or loaded from Warp's cache; the longest "
    return text + f"{most.compiling:.1f} s ({most.series}, {where}). No time here holds it.\n"


def page(machine: str, sections: Sequence[Section], missing: Sequence[str]) -> str:
    """The whole page."""
    text = f"{HEAD}\nMeasured on {machine}.\n{summary(sections)}"
    text += "".join(f"\n{line}.\n" for line in missing)
    return text + compiling(sections) + "".join(body(s) for s in sections)
