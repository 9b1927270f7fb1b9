"""The forward scan: every combination of plastic expert × stiffness is simulated, filmed and scored.

Gradient descent finds the bottom of a basin and no more: a mixture of experts has several, and a bounce seen at the
wrong phase points the wrong way. A scan of a few dozen short clips takes seconds and names the basin.
"""

import dataclasses
import itertools
import logging
import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import torch
from torch import Tensor

from diffuphy.losses.sds import Weight
from diffuphy.losses.takes import Take
from diffuphy.losses.video import video_sds
from diffuphy.material import ELASTIC, PLASTIC, Param
from diffuphy.material.field import Hypothesis, prune, warm_start
from diffuphy.probe import Bench, TableClips
from diffuphy.types import MaterialField, Motion, SimulationDiverged, Trajectory
from diffuphy.workspace import Workspace

log = logging.getLogger(__name__)
THREADS = 2
"""Clips simulated at once on the CPU; the scores do not depend on it."""


class Conditions:
    """What the video prior is asked about takes of the probe."""

    def __init__(self, guidance: Any, motion: Motion, bench: Bench):
        self.guidance, self.motion, self.bench = guidance, motion, bench
        self._made: tuple[Take | None, Any] = (None, None)

    def prepare(self, take: Take) -> Any:
        """The prior's condition for a take; that of the last one is remembered."""
        if self._made[0] != take:
            guidance, references = self.guidance, getattr(self.guidance, "references", None)
            if isinstance(references, TableClips):
                guidance = dataclasses.replace(guidance, references=partial(references, take=take))
            camera = self.bench.camera_of(take)[[0] * len(take.frames)]
            background, generator = self.bench.background_of(take), torch.Generator().manual_seed(0)
            made = guidance.condition(self.motion, camera, background, generator=generator)
            self._made = (take, made)
        return self._made[1]

    def score(self, trajectory: Trajectory, weight: Weight) -> float:
        """The loss of the whole clip at t = ½ with the same noise for every clip of one length: hypotheses are
        compared, not luck."""
        take, generator = Take.whole(len(trajectory.x) - 1), torch.Generator().manual_seed(1)
        return float(self.distil(trajectory, take, t=0.5, generator=generator, weight=weight))

    def distil(self, trajectory: Trajectory, take: Take, *, t: float, **settings: Any) -> Tensor:
        """Score distillation of a take, frame by frame; its gradient is per pixel, so lengths compare.

        Args:
            t: diffusion time in (0, 1).
            settings: of ``video_sds``: noise or generator, weight, estimator.
        """
        frames, draw = list(take.frames), self.bench.drawing(take)
        operands, times = (trajectory.x[frames], trajectory.F[frames]), torch.tensor([t], device=trajectory.x.device)
        value = video_sds(self.guidance, draw, operands, self.prepare(take), t=times, **settings)
        return value.detach() + (value - value.detach()) / (3 * len(frames) * self.bench.probe.image**2)


def scan(
    bench: Bench,
    cond: Conditions,
    table: MaterialField,
    labels: Tensor,
    grid: Sequence[float],
    *,
    frames: int,
    weight: Weight,
    work: Workspace,
) -> list[dict[str, Any]]:
    """The best hypothesis for each region, out of all combinations of ``table.plastic`` × ``grid`` over the regions.

    Args:
        table: candidate experts (columns); parameters other than E and the elastic law are those of the table.
        labels: region of each draft particle, shape (N,).
        grid: values of log10 E [Pa].
        frames: length of the clips.

    Raises:
        SimulationDiverged: none of them can be simulated; what can is compared, and the log tells how many cannot.
    """
    regions = region_values(table, labels)
    pairs = list(itertools.product(itertools.product(table.plastic, grid), repeat=len(regions)))

    def hypotheses(pair: tuple) -> list[dict[str, Any]]:
        return [
            {"elastic": r["elastic"], "plastic": plastic, "theta": r["theta"] | {"E": 10**log_E}, "rho": r["rho"]}
            for (plastic, log_E), r in zip(pair, regions, strict=True)
        ]

    def score(pair: tuple) -> float:
        guess = warm_start(table.elastic, table.plastic, labels, [Hypothesis(**h) for h in hypotheses(pair)])
        with torch.no_grad():
            try:
                return cond.score(bench.simulate(prune(guess).field, frames), weight)
            except SimulationDiverged as trouble:  # so soft that the drop tears it apart: not what the clip shows
                failed.append(trouble)
                return math.inf

    scores: list[float] = []
    failed: list[SimulationDiverged] = []
    cond.prepare(Take.whole(frames))
    with work.bar(len(pairs), "material: scan") as bar, ThreadPoolExecutor(THREADS) as pool:
        for pair, value in zip(pairs, pool.map(score, pairs), strict=True):
            scores.append(value)
            bar.update()
            seen = {"scan": value} if math.isfinite(value) else {"scan_failed": 1}
            work.log(len(scores), **seen, hypothesis=", ".join(f"{p} E=1e{e:.2f}" for p, e in pair))
    if len(failed) == len(pairs):
        raise failed[0]
    if failed:
        log.warning("material: %d of %d hypotheses cannot be simulated: %s", len(failed), len(pairs), failed[0])
    best = min(range(len(pairs)), key=scores.__getitem__)
    words = ", ".join(f"{p} with E = 1e{e:.2f} Pa" for p, e in pairs[best])
    log.info("material: scanned %d hypotheses, the best is %s", len(pairs), words)
    return hypotheses(pairs[best])


def region_values(table: MaterialField, labels: Tensor) -> list[dict[str, Any]]:
    """Of each region: its commonest elastic law, and the means of its parameters and density."""
    regions = []
    for r in range(int(labels.max()) + 1):
        where = labels == r
        law = table.elastic[int(table.w_e[where].mean(0).argmax())]
        theta = {k: float(v[where].mean()) for k, v in table.theta.items()}
        regions.append({"elastic": law, "theta": theta, "rho": float(table.rho[where].mean())})
    return regions


def with_columns(table: MaterialField, elastic: Sequence[str], plastic: Sequence[str]) -> MaterialField:
    """The same field with one column for each of these experts and every parameter they read.

    Raises:
        ValueError: an expert that the field uses is not among them.
    """

    def columns(names: Sequence[str], have: Sequence[str], w: Tensor) -> Tensor:
        missing = [n for n in have if n not in names and bool((w[:, have.index(n)] > 0).any())]
        if missing:
            raise ValueError(f"the table needs expert {missing[0]!r}, which is not among the candidates {tuple(names)}")
        zero = torch.zeros_like(w[:, 0])
        return torch.stack([w[:, have.index(n)] if n in have else zero for n in names], 1)

    theta = dict(table.theta)
    for p in parameters(elastic, plastic):
        theta.setdefault(p.name, torch.full_like(table.rho, p.default))
    w_e, w_p = columns(elastic, table.elastic, table.w_e), columns(plastic, table.plastic, table.w_p)
    return MaterialField(tuple(elastic), tuple(plastic), w_e, w_p, theta, table.rho)


def parameters(elastic: Sequence[str], plastic: Sequence[str]) -> list[Param]:
    """Parameters of these experts, each name once."""
    found = {p.name: p for law in (*(ELASTIC[n] for n in elastic), *(PLASTIC[n] for n in plastic)) for p in law.params}
    return list(found.values())
