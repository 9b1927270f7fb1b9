"""How far away the product's own training may start: the scan is left out, the gradient does all of it."""

import itertools
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from benchmarks.identify.bodies import SIZE, Reference, skin_of_ball
from benchmarks.identify.recover import fitting, made_by, truth_of
from benchmarks.identify.rows import Rows, Stopwatch
from benchmarks.identify.specimens import HALVES, SPECIMENS, Specimen
from diffuphy.learning.appearance import appearance
from diffuphy.learning.case import Case, Conditions, with_columns
from diffuphy.learning.fit_material import FitMaterial
from diffuphy.learning.probe import TableClips
from diffuphy.losses.guidance.analytic import Analytic
from diffuphy.types import Motion
from diffuphy.workspace import Workspace

DISTANCES = (0.3, 0.8, 1.3, 1.9, 2.5)
"""Of the start from the truth [dex of E]."""
SIDES = (1, -1)
TRUTHS = (3.9, 6.0)
"""Range of the truths [log10 Pa]; starts go from 2.5 dex below the upper to 2.5 dex above the lower end."""
SEEDS = 5
"""Benches that references are made on, in turn."""
RANGE = (3.4, 6.5)
"""What the fit may find [log10 Pa]."""


class Watched(Workspace):
    """Remembers log10 E of each step."""

    def __init__(self) -> None:
        super().__init__(progress=False)
        self.path: list[float] = []

    def log(self, step: int, **scalars: Any) -> None:
        if "log10_E" in scalars:
            self.path.append(round(float(scalars["log10_E"]), 4))


def case_of(specimen: Specimen, truth: Tensor, reference: Reference, seed: int) -> Case:
    """The ball on the product's bench, and a prior that has a clip of the truth in mind, made elsewhere."""
    mine, theirs = fitting(specimen), made_by(specimen, reference, seed)
    clips = TableClips(theirs.bench, specimen.field(theirs.labels, truth))
    guidance = Analytic(layout="clip", s=0.0, references=clips)
    motion = Motion("falling", f"a {specimen.name} ball falling", {"": "rubber"}, SIZE)
    middle = torch.stack(specimen.box()).mean(0)
    table = with_columns(specimen.field(mine.labels, middle), (specimen.elastic,), (specimen.plastic,))
    labels = mine.labels * int(specimen.halves)
    points = appearance(skin_of_ball(split=specimen.seam), mine.bench.draft)
    names = HALVES[specimen.split] if specimen.halves else ("ball",)
    return Case(mine.bench, Conditions(guidance, motion, mine.bench), table, points, labels, names, labels)


def start_and_truth(distance: float, side: int, number: int) -> tuple[float, float]:
    """A truth of which a start at the distance on the side still lies in the range, drawn evenly."""
    lo, hi = TRUTHS
    lo, hi = (lo, min(hi, 6.4 - distance)) if side > 0 else (max(lo, 3.5 + distance), hi)
    u = torch.rand((), generator=torch.Generator().manual_seed(1000 * number + round(10 * distance) + (side > 0)))
    truth = lo + (hi - lo) * float(u)
    return truth + side * distance, truth


def train(specimen: Specimen, truth: Tensor, reference: Reference, seed: int, **settings: Any) -> dict[str, Any]:
    """Found log10 E of each region and what it took, by the material stage with these settings."""
    case, watch, work = case_of(specimen, truth, reference, seed), Stopwatch(), Watched()
    case.cond.target()  # the reference is not part of the fit
    watch = Stopwatch()
    stage = FitMaterial(guidance=case.cond.guidance, probe=case.bench.probe, stiffness=RANGE, scan_frames=8, **settings)
    model = stage.fit(case, work)
    with torch.no_grad():
        E = model().theta["E"].log10()
    found = [float(E[case.labels == r].mean()) for r in range(int(case.labels.max()) + 1)]
    return {"found": found, "path": work.path, "seconds": watch.seconds}


def open_rows(out: Path) -> Rows:
    return Rows(out / "identify_stiffness.json", ("way", "reference", "distance", "side", "number"))


def stages(rows: Rows, runs: int, steps: int) -> None:
    """The whole stage, scan and training, as the product runs it; the first quarter of the runs against the same
    resolution as well."""
    rubber = SPECIMENS["rubber"]
    for number in range(runs):
        references: tuple[Reference, ...] = ("fine", "same") if number < (runs + 3) // 4 else ("fine",)
        for reference in references:
            key = {"way": "stage", "reference": reference, "distance": 0.0, "side": 0, "number": number}
            if not rows.has(**key):
                truth = truth_of(rubber, number)
                _add(rows, key, float(truth[0]), train(rubber, truth, reference, 1 + number % SEEDS, steps=steps))


def descents(
    rows: Rows,
    runs: int,
    steps: int,
    references: tuple[Reference, ...] = ("fine",),
    distances: tuple[float, ...] = DISTANCES,
) -> None:
    """Training alone from all distances and sides, ``runs`` of each."""
    rubber = SPECIMENS["rubber"]
    for number, reference, distance, side in itertools.product(range(runs), references, distances, SIDES):
        key = {"way": "descent", "reference": reference, "distance": distance, "side": side, "number": number}
        if rows.has(**key):
            continue
        start, truth = start_and_truth(distance, side, number)
        at = torch.tensor([truth], dtype=torch.float64)
        _add(
            rows, key, truth,
            train(rubber, at, reference, 1 + number % SEEDS, stiffness_steps=0, start=start, steps=steps),
        )  # fmt: skip


def _add(rows: Rows, key: dict[str, Any], truth: float, run: dict[str, Any]) -> None:
    error = run["found"][0] - truth
    near = [i for i, e in enumerate(run["path"]) if abs(e - truth) > 0.1]
    rows.add(
        **key, truth=truth, error=error, right=abs(error) <= 0.1, within_twice=abs(error) <= 0.2,
        hit=near[-1] + 1 if near else 0, steps=len(run["path"]), seconds=run["seconds"],
    )  # fmt: skip
