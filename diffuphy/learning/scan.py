"""The forward scan: every combination of plastic expert × stiffness is simulated, filmed and scored.

Gradient descent finds the bottom of a basin and no more: a mixture of experts has several, and a bounce seen at the
wrong phase points the wrong way. A scan of a few dozen short clips takes seconds and names the basin.
"""

import itertools
import logging
import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import torch
from torch import Tensor

from diffuphy.learning.case import Case, with_columns
from diffuphy.losses.sds import Weight
from diffuphy.losses.takes import Take
from diffuphy.material.field import Hypothesis, prune, warm_start
from diffuphy.mpm import rollout_batch
from diffuphy.types import MaterialField, SimulationDiverged, Trajectory
from diffuphy.workspace import Workspace

log = logging.getLogger(__name__)
THREADS = 2
"""Clips simulated at once on the CPU; the scores do not depend on it."""
FINE = 0.15
"""The search between the values of the grid ends at steps no larger than this [dex]: a right law that is farther from
its best stiffness can score worse than a wrong one at its best (docs/benchmarks/two_regions.md)."""
FEW = 6
"""Choices of laws whose stiffness is sought more finely than the grid."""

Pair = tuple[tuple[str, float], ...]
"""Plastic law and log10 E [Pa] of each region."""


def scan(
    case: Case,
    grid: Sequence[float],
    *,
    frames: int,
    weight: Weight,
    work: Workspace,
    known: Sequence[float] = (),
    few: int = FEW,
    batched: bool = False,
) -> list[list[dict[str, Any]]]:
    """All combinations of ``table.plastic`` × ``grid`` over the regions, simulated, filmed and scored.

    Regions are scanned jointly, so that one material for the whole object is among the hypotheses as well.

    Args:
        case: experiment, prior and regions; parameters other than E, and the elastic law, are those of its table.
        grid: values of log10 E [Pa].
        frames: length of the clips.
        known: scores of the first hypotheses, from a checkpoint.
        few: choices of laws whose stiffness is sought more finely than the grid, see ``compass``.
        batched: simulate hypotheses of one time step together (``mpm.rollout_batch``), in a kernel of all their laws;
            scores differ by rounding and the length of the steps. For GPUs, see docs/learning.md.

    Returns:
        For each of the best ``few`` choices of laws its best stiffness, as one hypothesis for each region; the best
        choice first. A descent moves stiffness and hardly ever laws, so these are the basins it may start in.

    Raises:
        SimulationDiverged: none of them can be simulated; what can is compared, and the log tells how many cannot.
    """
    guesses, scores = _Guesses(case, frames, weight), list(known)
    pairs = sorted(
        itertools.product(itertools.product(case.table.plastic, grid), repeat=len(guesses.regions)), key=guesses.speed
    )
    left = pairs[len(scores) :]
    groups = [list(g) for _, g in itertools.groupby(left, guesses.speed)] if batched else [[p] for p in left]
    case.cond.prepare(Take.whole(frames))
    with work.bar(len(pairs), "material: scan", initial=len(scores)) as bar, ThreadPoolExecutor(THREADS) as pool:
        for group, values in zip(groups, pool.map(guesses.scores, groups), strict=True):
            for pair, value in zip(group, values, strict=True):
                scores.append(value)
                bar.update()
                seen = {"scan": value} if math.isfinite(value) else {"scan_failed": 1}
                work.log(len(scores), **seen, hypothesis=_words(pair))
            if work.due():
                work.save({"scores": scores})
    best, failed = _of_each_choice(pairs, scores)[:few], guesses.failed
    if not best:
        raise failed[0] if failed else SimulationDiverged(f"none of {len(pairs)} hypotheses can be simulated")
    if failed:
        log.warning("material: %d of %d hypotheses cannot be simulated: %s", len(failed), len(pairs), failed[0])
    halvings = math.ceil(math.log2(max(2.0, _step(grid) / FINE)))
    with ThreadPoolExecutor(THREADS) as pool:
        found = list(pool.map(lambda i: compass(guesses.score, pairs[i], scores[i], grid, halvings), best))
    found.sort(key=lambda f: f[1])
    log.info("material: scanned %d hypotheses; %s", len(pairs), "; ".join(f"{_words(p)}: {v:.3g}" for p, v in found))
    return [guesses.hypotheses(pair) for pair, _ in found]


class _Guesses:
    """What a pair stands for, and how well it does."""

    def __init__(self, case: Case, frames: int, weight: Weight):
        self.case, self.frames, self.weight = case, frames, weight
        self.regions = region_values(case.table, case.labels)
        self.failed: list[SimulationDiverged] = []
        """Why some cannot be simulated."""

    def hypotheses(self, pair: Pair) -> list[dict[str, Any]]:
        return [
            {"elastic": r["elastic"], "plastic": plastic, "theta": r["theta"] | {"E": 10**log_E}, "rho": r["rho"]}
            for (plastic, log_E), r in zip(pair, self.regions, strict=True)
        ]

    def speed(self, pair: Pair) -> float:
        """max_r E_r/ρ_r [m²/s²]: hypotheses that share it share the time step of their stiffest region."""
        return max(10**log_E / r["rho"] for (_, log_E), r in zip(pair, self.regions, strict=True))

    def score(self, pair: Pair) -> float:
        return self.scores([pair])[0]

    def scores(self, pairs: list[Pair]) -> list[float]:
        """Of hypotheses that are simulated together; infinite for one that cannot be simulated alone."""
        with torch.no_grad():
            try:
                drops = self._drops([self._field(pair) for pair in pairs])
            except SimulationDiverged as trouble:  # so soft that the drop tears it apart: not what the clip shows
                if len(pairs) > 1:
                    return [self.score(pair) for pair in pairs]
                self.failed.append(trouble)
                return [math.inf]
            return [self.case.cond.score(drop, self.weight) for drop in drops]

    def _field(self, pair: Pair) -> MaterialField:
        table, guess = self.case.table, [Hypothesis(**h) for h in self.hypotheses(pair)]
        return prune(warm_start(table.elastic, table.plastic, self.case.labels, guess)).field

    def _drops(self, fields: list[MaterialField]) -> list[Trajectory]:
        """Several in one launch, each with the laws of all, those of the others without weight."""
        bench, table = self.case.bench, self.case.table
        if len(fields) == 1:
            return [bench.simulate(fields[0], self.frames)]
        elastic = [n for n in table.elastic if any(n in f.elastic for f in fields)]
        plastic = [n for n in table.plastic if any(n in f.plastic for f in fields)]
        fields = [with_columns(f, elastic, plastic) for f in fields]
        return rollout_batch(bench.scene, bench.draft.x, bench.draft.vol, fields, frames=self.frames)


def compass(
    score: Callable[[Pair], float], pair: Pair, value: float, grid: Sequence[float], halvings: int
) -> tuple[Pair, float]:
    """The best stiffness of each region near those of ``pair``, and its score, by looking both ways in halved steps.

    Compass search (Kolda, Lewis & Torczon 2003): forward only, and a bounce seen at the wrong phase does not mislead
    it as it does a gradient. Ends within grid step / 2^halvings of a local minimum if there is one.
    """
    step = _step(grid)
    for _ in range(halvings):
        step /= 2
        for region, (law, log_E) in enumerate(pair):
            for other in (log_E - step, log_E + step):
                if not grid[0] <= other <= grid[-1]:
                    continue
                trial = (*pair[:region], (law, other), *pair[region + 1 :])
                if (found := score(trial)) < value:
                    pair, value = trial, found
                    break
    return pair, value


def _step(grid: Sequence[float]) -> float:
    return (grid[-1] - grid[0]) / max(1, len(grid) - 1)


def _of_each_choice(pairs: Sequence[Pair], scores: Sequence[float]) -> list[int]:
    """The best hypothesis of each choice of laws that has one, by their scores."""
    best: dict[tuple[str, ...], int] = {}
    for i in sorted(range(len(pairs)), key=scores.__getitem__):
        if math.isfinite(scores[i]):
            best.setdefault(tuple(plastic for plastic, _ in pairs[i]), i)
    return list(best.values())


def _words(pair: Pair) -> str:
    return ", ".join(f"{plastic} with E = 1e{log_E:.2f} Pa" for plastic, log_E in pair)


def region_values(table: MaterialField, labels: Tensor) -> list[dict[str, Any]]:
    """Of each region: its commonest elastic law, and the means of its parameters and density."""
    regions = []
    for r in range(int(labels.max()) + 1):
        where = labels == r
        law = table.elastic[int(table.w_e[where].mean(0).argmax())]
        theta = {k: float(v[where].mean()) for k, v in table.theta.items()}
        regions.append({"elastic": law, "theta": theta, "rho": float(table.rho[where].mean())})
    return regions
