"""Honest seconds on a machine that others use too: taking turns there and back, and what two equal runs differ by."""

import gc
import math
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from benchmarks.work_precision.problem import Sample

MOST, LEAST = 7, 2
"""Repeats of a short run and of a long one; LEAST is one there and one back."""


@dataclass(frozen=True)
class Timed:
    """Samples of one runner, the first one apart."""

    first: Sample
    """The run that may compile."""
    samples: tuple[Sample, ...]
    """The others, in the order of time."""

    @property
    def seconds(self) -> float:
        """Median processor time [s]."""
        return statistics.median(s.seconds for s in self.samples)

    @property
    def quartiles(self) -> tuple[float, float]:
        """Lower and upper quartile of processor time [s]."""
        ordered = sorted(s.seconds for s in self.samples)
        return between(ordered, 0.25), between(ordered, 0.75)

    @property
    def compile(self) -> float:
        """What the first run took more than the others [s]."""
        return max(0.0, self.first.wall - statistics.median(s.wall for s in self.samples))


def between(ordered: Sequence[float], share: float) -> float:
    """Quantile by linear interpolation of ordered values."""
    place = share * (len(ordered) - 1)
    low = math.floor(place)
    return ordered[low] + (place - low) * (ordered[min(low + 1, len(ordered) - 1)] - ordered[low])


def repeats_of(seconds: float, budget: float, most: int = MOST) -> int:
    """How often a run of so many seconds is repeated within a budget [s]."""
    return max(LEAST, min(most, math.floor(budget / max(seconds, 1e-6))))


def turns(repeats: Sequence[int]) -> list[int]:
    """In which order runners take turns: in each round those that have turns left, there and back (ABBA), so that a
    machine that slows down or speeds up steadily favours none."""
    order = []
    for r in range(max(repeats, default=0)):
        round_ = [i for i, n in enumerate(repeats) if n > r]
        order += round_ if r % 2 == 0 else round_[::-1]
    return order


def interleaved(runs: Sequence[Callable[[], Sample]], firsts: Sequence[Sample], budget: float) -> list[Timed]:
    """Repeat runs that have been run once, taking turns, without the garbage collector.

    Args:
        firsts: what the runs that compiled took; the next ones decide how often each is repeated.
        budget: for the repeats of one run [s].
    """
    samples = [[run()] for run in runs]
    repeats = [repeats_of(s[0].seconds, budget) for s in samples]
    enabled = gc.isenabled()
    gc.disable()
    try:
        for i in turns(repeats)[len(runs) :]:
            samples[i].append(runs[i]())
    finally:
        if enabled:
            gc.enable()
    return [Timed(first, tuple(s)) for first, s in zip(firsts, samples, strict=True)]


def noise(pairs: Sequence[tuple[float, float]]) -> float:
    """A/A: the largest |ln t/t'| of runs of one and the same thing, a relative difference."""
    return max((abs(math.log(a / b)) for a, b in pairs), default=0.0)
