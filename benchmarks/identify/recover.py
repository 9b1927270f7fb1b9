"""How well parameters can be found at all: a scan, then least squares, by what is seen and by what made the clip."""

import itertools
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import torch
from torch import Tensor

from benchmarks.identify.bodies import Reference
from benchmarks.identify.newton import least_squares
from benchmarks.identify.rows import Rows, Stopwatch
from benchmarks.identify.specimens import SPECIMENS, Specimen, contrast
from benchmarks.identify.watch import WHAT, Watch, What
from diffuphy.types import SimulationDiverged, Trajectory

SCAN = {1: 8, 2: 6}
"""Values along each coordinate of the scan, by how many coordinates there are."""
BEYOND = 0.3
"""How far outside the range of the truths a run may go [dex or ranges]."""


@cache
def fitting() -> Watch:
    """The bench of the fit."""
    return Watch.make(seed=0)


@cache
def made_by(reference: Reference, seed: int) -> Watch:
    """The bench that made the clip: another draw of particles and another place on the grid, and for "fine" half the
    grid spacing and half the Courant number."""
    return Watch.make(seed=seed, finer=2.0 if reference == "fine" else 1.0)


@cache
def scanned(specimen: Specimen) -> list[tuple[Tensor, Trajectory | None]]:
    """Coordinates of the scan and their drops, None for what cannot be simulated."""
    lo, hi = specimen.box()
    ends = [torch.linspace(float(a), float(b), SCAN[len(lo)]).tolist() for a, b in zip(lo, hi, strict=True)]
    found: list[tuple[Tensor, Trajectory | None]] = []
    for point in itertools.product(*ends):
        q = torch.tensor(point, dtype=torch.float64)
        try:
            found.append((q, fitting().drop(specimen, q)))
        except SimulationDiverged:
            found.append((q, None))
    return found


@cache
def views(specimen: Specimen, what: What) -> list[tuple[Tensor, Tensor]]:
    """What is seen of each drop of the scan."""
    return [(q, fitting().see(drop, what)) for q, drop in scanned(specimen) if drop is not None]


def best_of_scan(specimen: Specimen, what: What, target: Tensor) -> Tensor:
    """Coordinates of the drop of the scan that looks most like the target."""
    return min(views(specimen, what), key=lambda seen: float((seen[1] - target).square().sum()))[0]


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
    theirs, mine = made_by(reference, 1 + number), fitting()
    drop = theirs.drop(specimen, truth)
    lo, hi = specimen.box(BEYOND)
    for what in whats:
        target = theirs.see(drop, what, seed=number)
        start, watch = best_of_scan(specimen, what, target), Stopwatch()
        found = least_squares(
            lambda q, what=what, target=target: mine.see(mine.drop(specimen, q), what) - target, start, lo=lo, hi=hi
        )
        errors = specimen.errors(found.q, truth)
        rows.add(
            **key, what=what, truth=specimen.values(truth), found=specimen.values(found.q), errors=errors,
            right=specimen.right(errors), within_twice=specimen.right(errors, 2.0),
            rms=(2 * found.cost / target.numel()) ** 0.5, clips=found.clips, seconds=watch.seconds,
        )  # fmt: skip


def open_rows(out: Path) -> Rows:
    return Rows(out / "identify_parameters.json", ("specimen", "number", "reference", "what"))


def study(out: Path, names: Sequence[str], truths: int) -> Rows:
    """All specimens and truths: fine references seen in every way, three truths long, the others in two."""
    rows = open_rows(out)
    for number in range(truths):
        for name in names or [n for n in SPECIMENS if n != "rubber"]:  # rubber is what the stage itself is tried on
            recover(rows, SPECIMENS[name], number, "fine", WHAT if number < 3 else WHAT[:2])
            recover(rows, SPECIMENS[name], number, "same", WHAT[:2])
    return rows
