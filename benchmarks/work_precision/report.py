"""Tables and pages from the rows: what the page says is what the files hold."""

import math
import os
import platform
import statistics
from collections.abc import Sequence
from pathlib import Path

import torch
import warp as wp

from benchmarks.work_precision.analysis import Point, beaten_by, fitted_order, orders, work_for
from benchmarks.work_precision.rows import Row


def machine() -> str:
    """Where it was measured."""
    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        named = [line for line in info.read_text(encoding="utf-8").splitlines() if line.startswith("model name")]
        model = named[0].split(":", 1)[1].strip() if named else model
    return (
        f"one thread of {os.cpu_count()} cores, {model}; Python {platform.python_version()}, "
        f"torch {torch.__version__.split('+')[0]}, Warp {wp.__version__}"
    )


def points(rows: Sequence[Row]) -> list[Point]:
    return [Point(r.series, r.seconds, r.error) for r in rows if math.isfinite(r.error)]


def series_of(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Rows by series, coarse to fine."""
    found: dict[str, list[Row]] = {}
    for r in sorted(rows, key=lambda r: r.cells):
        found.setdefault(r.series, []).append(r)
    return found


def table(rows: Sequence[Row]) -> str:
    """Each series: errors by resolution, order, cost of the default's error."""
    by = series_of(rows)
    cells = sorted({r.cells for r in rows})
    default = by["default"]
    target = default[len(default) // 2]
    head = "| settings | " + " | ".join(f"{n:g}" for n in cells) + " | order | M/s | "
    head += f"time to {target.error:.2g} |\n|---|" + "--:|" * (len(cells) + 3) + "\n"
    text = head
    for name, mine in by.items():
        errors = {r.cells: r.error for r in mine}
        row = [f"{errors[n]:.2g}" if n in errors and math.isfinite(errors[n]) else "" for n in cells]
        good = [r for r in mine if math.isfinite(r.error) and r.error > 0]
        order = f"{fitted_order([r.cells for r in good], [r.error for r in good]):.1f}" if len(good) > 1 else ""
        speed = f"{max(r.work / r.seconds for r in mine) / 1e6:.2f}"
        text += f"| {name} | {' | '.join(row)} | {order} | {speed} | {ratio(mine, target)} |\n"
    return text


def ratio(mine: Sequence[Row], target: Row) -> str:
    """Time of a series to the error of the default at its middle resolution, over that of the default."""
    if mine[0].series == target.series:
        return f"{target.seconds:.2g} s"
    work = work_for(points(mine), target.error)
    if work is not None:
        return f"{work / target.seconds:.2g} ×"
    good = [r for r in mine if math.isfinite(r.error)]
    if good and min(r.error for r in good) > target.error:
        return f"> {max(r.seconds for r in good) / target.seconds:.2g} ×"
    best = min((r.seconds for r in good), default=math.nan)
    return f"< {best / target.seconds:.2g} ×" if good else "fails"


def verdicts(rows: Sequence[Row], noise: float) -> list[tuple[Row, list[Point]]]:
    """Each point of the default, and what beats it."""
    others = [p for p in points(rows) if p.series != "default"]
    mine = series_of(rows)["default"]
    return [(r, beaten_by(Point("default", r.seconds, r.error), others, noise)) for r in mine]


def verdict(rows: Sequence[Row], noise: float) -> str:
    """In words, for the page."""
    found = verdicts(rows, noise)
    free = [r for r, by in found if not by]
    where = ", ".join(f"{r.cells:g}" for r in free)
    text = f"The default lies on the front at {len(free)} of {len(found)} resolutions{f' ({where} cells)' * bool(free)}"
    beaten = [(r, by) for r, by in found if by]
    if not beaten:
        return text + "."
    parts = []
    for r, by in beaten:
        names = dict.fromkeys(p.series for p in by)
        best = by[0]
        also = f" (also: {', '.join(list(names)[1:])})" if len(names) > 1 else ""
        share = f"{best.error / r.error:.2f} of the error in {best.work / r.seconds:.2f} of the time"
        parts.append(f"at {r.cells:g} cells {best.series} has {share}{also}")
    return f"{text}; {'; '.join(parts)}."


def observed(rows: Sequence[Row]) -> str:
    """Orders of the default between neighbouring resolutions."""
    mine = [r for r in series_of(rows)["default"] if r.error > 0]
    found = orders([r.cells for r in mine], [r.error for r in mine])
    return ", ".join(f"{p:.1f}" for p in found)


def spread(rows: Sequence[Row]) -> float:
    """Median over runs of the distance between quartiles, relative."""
    return statistics.median((r.high - r.low) / r.seconds for r in rows)
