"""Results of the study as docs/benchmarks/identify.md, with its figures."""

import json
import math
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks._draw import GREEN, INK, PALE, PAPER, RED, YELLOW, Curve, Panel, Plot, plots, table
from benchmarks.identify import takes
from benchmarks.identify.rows import rate
from benchmarks.identify.specimens import SPECIMENS
from benchmarks.identify.watch import CAMERA
from benchmarks.identify.words import (
    ELASTIC,
    INTRO,
    LAWS,
    PARAMETERS,
    PUBLISHED,
    RESOLUTION,
    SCALED,
    SEEN,
    STIFFNESS,
    WHY,
)

Row = dict[str, Any]
PARTS = ("stiffness", "parameters", "laws", "seen", "resolution", "takes")


def write(out: Path) -> None:
    """The page and its figures from all results that are in ``out``."""
    found = {}
    for part in PARTS:
        path = out / f"identify_{part}.json"
        if path.exists():
            found[part] = json.loads(path.read_text())
    sections: dict[str, Callable[[Any, Path], str]] = {
        "stiffness": stiffness, "parameters": parameters, "laws": laws, "resolution": resolution, "seen": seen,
        "takes": lambda rows, _: takes.section(found["takes"]),
    }  # fmt: skip
    machine = next(iter(found.values()))["machine"] if found else ""
    text = INTRO.format(machine=machine) + targets({k: v["rows"] for k, v in found.items()})
    for part, section in sections.items():
        if part in found:
            text += section(found[part]["rows"], out)
    (out / "identify.md").write_text(text.rstrip() + "\n" + PUBLISHED, encoding="utf-8")


# ---------------------------------------------------------------------- what was asked for
def targets(found: dict[str, list[Row]]) -> str:
    """What was to be shown, and what was found: with twice the tolerance where a finer simulation made the clip."""
    lines = []

    def line(what: str, tolerance: str, rows: Sequence[Row], right: Callable[[Row, str], bool]) -> None:
        cells = []
        for reference, key in (("same", "right"), ("fine", "within_twice")):
            those = [right(r, key) for r in rows if r["reference"] == reference]
            cells.append(rate(those) if those else "–")
        lines.append([what, tolerance, *cells])

    stage = [r for r in found.get("stiffness", ()) if r["way"] == "stage"]
    line("E, the whole stage", "0.1 dex", stage, lambda r, key: r[key])
    camera = [r for r in found.get("parameters", ()) if r["what"] == CAMERA]
    for name, at, words, tolerance in (
        ("plasticine", 0, "yield stress", "15 %"),
        ("wax", 1, "yield stress, sought with E", "15 %"),
        ("wax", 0, "E, sought with the yield stress", "0.1 dex"),
        ("sand", 0, "friction angle", "4°"),
        ("honey", 0, "viscosity", "15 %"),
        ("jelly", 0, "E, sought with ν", "0.1 dex"),
        ("jelly", 1, "ν, sought with E", "0.03"),
    ):
        rows = [r for r in camera if r["specimen"] == name]
        line(words, tolerance, rows, lambda r, key, at=at: r[key][at])
    for body, rows in grouped(camera, body_of).items():
        if SPECIMENS[rows[0]["specimen"]].halves:
            line(f"E of {body}: both", "0.15 dex", rows, lambda r, key: all(r[key]))
    line("plastic law", "the right one", found.get("laws", ()), lambda r, _: r["right"])
    head = ("sought", "tolerance", "same resolution", "finer reference, twice the tolerance")
    return "\n" + markdown(head, lines) + WHY


# ---------------------------------------------------------------------- the parts
def grouped(rows: Iterable[Row], key: Callable[[Row], Any]) -> dict[Any, list[Row]]:
    """Rows of which the same can be said, in the order in which they are found first."""
    groups: dict[Any, list[Row]] = defaultdict(list)
    for r in rows:
        groups[key(r)].append(r)
    return groups


def fields(*names: str) -> Callable[[Row], tuple]:
    return lambda row: tuple(row[name] for name in names)


def body_of(row: Row) -> str:
    """The specimen, and which of its halves is the softer one where that matters."""
    specimen, truth = SPECIMENS[row["specimen"]], row["truth"]
    if specimen.split != "z":
        return specimen.name
    return f"{specimen.name}, the {'upper' if truth[0] > truth[1] else 'lower'} one softer"


def rate_of(rows: Sequence[Row], key: str, at: int | None = None) -> str:
    return rate([r[key] if at is None else r[key][at] for r in rows])


def stiffness(rows: Sequence[Row], out: Path) -> str:
    lines, worst = [], defaultdict(list)
    groups = grouped(rows, fields("way", "distance", "side", "reference"))
    for (way, distance, side, reference), its in sorted(groups.items(), reverse=True):
        start = "whole stage" if way == "stage" else f"training alone, {distance:g} dex too {SIDE[side]}"
        errors, hits = [abs(r["error"]) for r in its], [r["hit"] for r in its if r["right"]]
        if reference == "fine":
            worst[way, side].append((distance, max(errors)))
        lines.append([
            start, reference, rate_of(its, "right"), rate_of(its, "within_twice"),
            f"{median(errors):.3f}, {max(errors):.3f}", f"{median(hits):.0f}" if hits else "–",
            f"{median(r['seconds'] for r in its):.0f}",
        ])  # fmt: skip
    head = ("", "reference", "within 0.1 dex", "within 0.2 dex", "median, worst [dex]", "steps to 0.1 dex", "seconds")
    curves = [
        Curve(f"training alone, too {SIDE[side]}", sorted(points), int(side < 0))
        for (way, side), points in worst.items()
        if way == "descent"
    ]
    for ((_, error),) in (points for (way, _), points in worst.items() if way == "stage"):
        curves.append(Curve("whole stage", [(0.3, error), (2.5, error)], 2, True))
    plot = Plot("E of a ball, finer reference", "start: distance from the truth [dex]", "worst error [dex]", curves)
    return (
        STIFFNESS
        + markdown(head, lines)
        + picture(out, "identify_stiffness", lambda path: plots(path, "From how far away E is found", [plot], 1))
    )


def parameters(rows: Sequence[Row], out: Path) -> str:
    lines, names = [], []
    cells: dict[str, dict] = {"fine": {}, "same": {}}
    order = list(SPECIMENS)
    for body, those in grouped(sorted(rows, key=lambda r: order.index(r["specimen"])), body_of).items():
        for at, (word, unit) in enumerate(SPECIMENS[those[0]["specimen"]].sought):
            names.append(f"{body}: {word}")
            for (reference, what), its in grouped(those, fields("reference", "what")).items():
                errors = [abs(r["errors"][at]) for r in its]
                key = "right" if reference == "same" else "within_twice"
                cells[reference][names[-1], SHORT[what]] = cell([r[key][at] for r in its])
                lines.append([
                    body, word, reference, what, rate_of(its, "right", at), rate_of(its, "within_twice", at),
                    f"{in_unit(median(errors), unit)}, {in_unit(max(errors), unit)}",
                    f"{median(r['clips'] for r in its):.0f}", f"{median(r['seconds'] for r in its):.1f}",
                ])  # fmt: skip
    panels = [
        Panel(title, list(SHORT.values()), cells[reference])
        for reference, title in (("same", "same resolution: within"), ("fine", "finer reference: within twice"))
    ]
    legend = [(GREEN, "all"), (YELLOW, "most"), (RED, "half or less"), (PALE, "not run")]
    head = ("specimen", "parameter", "reference", "seen", "within", "within twice", "median, worst", "clips", "seconds")
    title = "Parameters found, by what is seen"
    return (
        PARAMETERS
        + markdown(head, lines)
        + picture(out, "identify_parameters", lambda path: table(path, title, names, panels, legend))
    )


def cell(right: Sequence[bool]) -> tuple[str, str, str]:
    """Colour of a rate, the rate, and the colour of its letters."""
    share = sum(right) / len(right)
    color = GREEN if share == 1 else YELLOW if share > 0.5 else RED
    return color, f"{sum(right)}/{len(right)}", INK if color == YELLOW else PAPER


def laws(rows: Sequence[Row], out: Path) -> str:
    groups = grouped(rows, fields("law", "reference"))
    groups |= {("all", k): v for k, v in grouped(rows, lambda r: r["reference"]).items()}
    lines = []
    for (law, reference), its in groups.items():
        wrong = Counter(r["found"] for r in its if not r["right"])
        taken = ", ".join(f"{name} ({count})" for name, count in wrong.items()) or "–"
        second = rate([r["place"] <= 2 for r in its])
        lines.append([law, reference, rate_of(its, "right"), second, taken if law != "all" else ""])
    return LAWS + markdown(("law of the clip", "reference", "right", "among the best two", "taken for"), lines)


def seen(rows: Sequence[Row], out: Path) -> str:
    lines = []
    for r in (r for r in rows if r["what"] == "fisher"):
        other = " (" + r["other"].strip("{}").replace("'", "") + ")" if r["other"] != "{}" else ""
        errors, alone = (", ".join(map(short, r[k])) for k in ("errors", "alone"))
        said = "; ".join(r["remarks"]) or "–"
        lines.append([r["specimen"] + other, ", ".join(r["names"]), errors, alone, short(r["condition"]), said])
    head = ("body", "sought together", "least standard errors", "each, the others known", "condition", "said")
    text = SEEN + markdown(head, lines)
    scaled = [f"{short(r['largest'])} ({r['specimen']})" for r in rows if r["what"] == "scaled"]
    if scaled:
        text += SCALED.format(differences=", ".join(scaled))
    compared = [r for r in rows if r["what"] == "laws"]
    if compared:
        names = list(compared[0]["differ"])
        cells = [
            [
                r["sought"],
                f"{r['flattened']:.0%}",
                *(f"{r['differ'][n]:.3f}" for n in names),
                f"{r['another_draw']:.3f}",
            ]
            for r in compared
        ]
        text += ELASTIC + markdown(("log₁₀ E", "flattened by", *names, "another draw of particles"), cells)
    return text


def resolution(rows: Sequence[Row], out: Path) -> str:
    lines, curves = [], defaultdict(list)
    for (name, scheme, particles), its in sorted(grouped(rows, fields("specimen", "scheme", "particles")).items()):
        units = [unit for _, unit in SPECIMENS[name].sought]
        bias = ["; ".join(signed(v, u) for v, u in zip(r["bias"], units, strict=True)) for r in its]
        seconds = median(r["seconds"] for r in its)
        lines.append([name, str(particles), scheme, " / ".join(bias), f"{seconds:.2f}"])
        if scheme == ("elastic, neither" if name == "sand" else "elastic"):
            allowed = next(iter(SPECIMENS[name].tolerance.values()))[0]
            curves[name].append((seconds, max(abs(v) for r in its for v in r["bias"]) / allowed))
    plot = Plot(
        "Error against run time", "seconds a clip", "worst error over tolerance",
        [Curve(n, sorted(c), k) for k, (n, c) in enumerate(curves.items())],
    )  # fmt: skip
    head = ("body", "particles", "contact, scheme", "error, against each reference", "seconds a clip")
    title = "What discretisation does to an estimate"
    return (
        RESOLUTION
        + markdown(head, lines)
        + picture(out, "identify_resolution", lambda path: plots(path, title, [plot], 1))
    )


# ---------------------------------------------------------------------- how it is written
SHORT = {"particles": "points", "1 camera": "1 cam", "4 cameras": "4 cam", "1 camera, noise": "noisy"}
SIDE = {1: "stiff", -1: "soft"}


def markdown(head: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    rows = [head, ["---"] * len(head), *lines]
    return "\n".join("| " + " | ".join(row) + " |" for row in rows) + "\n"


def in_unit(value: float, unit: str) -> str:
    return {"%": f"{100 * value:.0f} %", "dex": f"{value:.3f} dex", "deg": f"{value:.1f}°", "-": f"{value:.3f}"}[unit]


def signed(value: float, unit: str) -> str:
    return ("−" if value < 0 else "+") + in_unit(abs(value), unit)


def short(value: float) -> str:
    if math.isinf(value):
        return "∞"
    return f"{value:.0e}" if value > 1e4 else f"{value:.2g}"


def picture(out: Path, name: str, draw: Callable[[Path], None]) -> str:
    draw(out / f"{name}.png")
    return f"\n![{name.replace('_', ' ')}]({name}.png)\n"
