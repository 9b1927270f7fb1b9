"""What curves of error against work say: who lies on the front, what an error costs, at which order it falls."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

SAME = 0.02
"""Errors closer than this are called equal [-]."""


@dataclass(frozen=True)
class Point:
    """One run: what it cost, and how wrong it was."""

    series: str
    work: float
    """Seconds, or particle-substeps."""
    error: float


def front(points: Sequence[Point]) -> list[Point]:
    """The points that no other beats or equals in both work and error, by increasing work (Pareto)."""
    best: list[Point] = []
    for p in sorted(points, key=lambda p: (p.work, p.error)):
        if math.isfinite(p.error) and (not best or p.error < best[-1].error):
            best.append(p)
    return best


def beaten_by(point: Point, others: Sequence[Point], noise: float) -> list[Point]:
    """Those that are less wrong by more than SAME at work that is not larger by more than the noise allows, or cost
    less by more than the noise at an error that is not larger: what keeps ``point`` off the front."""
    keep = math.exp(noise)
    found = []
    for q in others:
        cheaper, finer = q.work * keep < point.work, q.error < point.error * (1 - SAME)
        if (cheaper and q.error <= point.error) or (finer and q.work <= point.work * keep):
            found.append(q)
    return sorted(found, key=lambda q: q.error * q.work)


def work_for(series: Sequence[Point], error: float) -> float | None:
    """Work at which a series reaches an error, by straight lines between its points in logarithms; None where its
    points do not enclose that error."""
    ordered = sorted((p for p in series if math.isfinite(p.error)), key=lambda p: p.work)
    for a, b in itertools.pairwise(ordered):
        if a.error >= error >= b.error and a.error > b.error:
            share = math.log(a.error / error) / math.log(a.error / b.error)
            return math.exp(math.log(a.work) + share * math.log(b.work / a.work))
    return None


def orders(cells: Sequence[float], errors: Sequence[float]) -> list[float]:
    """Observed order between neighbours: ln(e_a/e_b)/ln(n_b/n_a)."""
    pairs = zip(cells, cells[1:], errors, errors[1:], strict=False)
    return [math.log(ea / eb) / math.log(b / a) for a, b, ea, eb in pairs]


def fitted_order(cells: Sequence[float], errors: Sequence[float]) -> float:
    """Slope of ln e against −ln n by least squares."""
    if len(cells) < 2:
        raise ValueError(f"an order needs two resolutions at least, got {len(cells)}; give another one")
    x, y = [-math.log(n) for n in cells], [math.log(e) for e in errors]
    mx, my = sum(x) / len(x), sum(y) / len(y)
    return sum((a - mx) * (b - my) for a, b in zip(x, y, strict=True)) / sum((a - mx) ** 2 for a in x)
