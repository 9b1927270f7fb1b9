"""How well parameters can be found at all: a scan, then least squares, by what is seen and by what made the clip."""

import itertools
import math
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import torch
from torch import Tensor

from benchmarks.identify.bodies import Reference
from benchmarks.identify.newton import least_squares
from benchmarks.identify.rows import Rows, Stopwatch
from benchmarks.identify.specimens import SPECIMENS, Specimen, contrast
from benchmarks.identify.watch import CAMERA, WHAT, Watch, What
from diffuphy.types import SimulationDiverged, Trajectory

SCAN = {1: 8, 2: 6}
"""Values along each coordinate of the scan, by how many coordinates there are."""
STARTS = 3
"""Most minima of the scan that are descended from."""
RACE = 3
"""Iterations after which the best of these descents goes on alone."""
BEYOND = 0.3
"""How far outside the range of the truths a run may go [dex or ranges]."""


def fitting(specimen: Specimen) -> Watch:
    """The bench of the fit."""
    return made(0, 1.0, specimen.probe, specimen.seam)


def made_by(specimen: Specimen, reference: Reference, seed: int) -> Watch:
    """The bench that made the clip: another draw of particles and another place on the grid, and for "fine" half the
    grid spacing and half the Courant number."""
    return made(seed, 2.0 if reference == "fine" else 1.0, specimen.probe, specimen.seam)


made = cache(Watch.make)


@cache
def scanned(specimen: Specimen) -> list[tuple[Tensor, Trajectory | None]]:
    """Coordinates of the scan and their drops, None for what cannot be simulated."""
    lo, hi = specimen.box()
    ends = [torch.linspace(float(a), float(b), SCAN[len(lo)]).tolist() for a, b in zip(lo, hi, strict=True)]
    found: list[tuple[Tensor, Trajectory | None]] = []
    for point in itertools.product(*ends):
        q = torch.tensor(point, dtype=torch.float64)
        try:
            found.append((q, fitting(specimen).drop(specimen, q)))
        except SimulationDiverged:
            found.append((q, None))
    return found


@cache
def views(specimen: Specimen, what: What) -> list[Tensor | None]:
    """What is seen of each drop of the scan."""
    return [None if drop is None else fitting(specimen).see(drop, what) for _, drop in scanned(specimen)]


def starts(specimen: Specimen, what: What, target: Tensor) -> list[Tensor]:
    """Coordinates of the minima of the scan, the best first: a least squares from the best of all alone stays in a
    basin that the spacing of the scan may have preferred."""
    costs = [math.inf if seen is None else float((seen - target).square().sum()) for seen in views(specimen, what)]
    n = len(specimen.box()[0])
    at = minima(torch.tensor(costs).reshape((SCAN[n],) * n))
    return [scanned(specimen)[i][0] for i in at[:STARTS]]


def minima(costs: Tensor) -> list[int]:
    """Places of a grid, counted in row-major order, that cost no more than any neighbour, diagonal ones included;
    the cheapest first."""
    pool = torch.nn.functional.max_pool1d if costs.ndim == 1 else torch.nn.functional.max_pool2d
    least = -pool(-costs[None], 3, 1, 1)[0]
    at = (costs.isfinite() & (costs == least)).flatten().nonzero()[:, 0].tolist()
    return sorted(at, key=costs.flatten().tolist().__getitem__)


def truth_of(specimen: Specimen, number: int) -> Tensor:
    generator = torch.Generator().manual_seed(100 + number)
    return contrast(generator, number) if specimen.halves else specimen.draw(generator)


def recover(rows: Rows, specimen: Specimen, number: int, reference: Reference, whats: Sequence[What] = WHAT) -> None:
    """Find one truth from what is seen of it; a row for each way of seeing."""
    truth = truth_of(specimen, number)
    key = {"specimen": specimen.name, "number": number, "reference": reference}
    whats = [what for what in whats if not rows.has(**key, what=what)]
    if not whats:
        return
    theirs, mine = made_by(specimen, reference, 1 + number), fitting(specimen)
    drop = theirs.drop(specimen, truth)
    lo, hi = specimen.box(BEYOND)
    for what in whats:
        target = theirs.see(drop, what, seed=number)
        begins, watch = starts(specimen, what, target), Stopwatch()

        def residual(q: Tensor, what: What = what, target: Tensor = target) -> Tensor:
            return mine.see(mine.drop(specimen, q), what) - target

        raced = [least_squares(residual, q, lo=lo, hi=hi, iterations=RACE) for q in begins] if len(begins) > 1 else []
        start = min(raced, key=lambda end: end.cost).q if raced else begins[0]
        found = least_squares(residual, start, lo=lo, hi=hi)
        errors = specimen.errors(found.q, truth)
        rows.add(
            **key, what=what, truth=specimen.values(truth), found=specimen.values(found.q), errors=errors,
            right=specimen.right(errors), within_twice=specimen.right(errors, 2.0),
            rms=(2 * found.cost / target.numel()) ** 0.5, clips=sum(end.clips for end in (*raced, found)),
            seconds=watch.seconds,
        )  # fmt: skip


def open_rows(out: Path) -> Rows:
    return Rows(out / "identify_parameters.json", ("specimen", "number", "reference", "what"))


def study(out: Path, names: Sequence[str], truths: int) -> Rows:
    """All specimens and truths, seen by one camera; three truths of one unknown and one of two also as particles, and
    the fine reference of the first truth of one unknown in every way."""
    rows = open_rows(out)
    for number in range(truths):
        for name in names or [n for n in SPECIMENS if n != "rubber"]:  # rubber is what the stage itself is tried on
            specimen = SPECIMENS[name]
            one = len(specimen.sought) == 1
            both = WHAT[:2] if number < (3 if one else 1) else (CAMERA,)
            recover(rows, specimen, number, "fine", WHAT if one and number == 0 else both)
            recover(rows, specimen, number, "same", both)
    return rows
