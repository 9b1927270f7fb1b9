"""A number with its error bar, and all those of one film."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Self

from torch import Tensor

from diffuphy.types import Result

Better = Literal["higher", "lower", ""]


@dataclass(frozen=True)
class Score:
    """One number."""

    name: str
    """What it is called; the paper's name where the paper has it."""
    value: float
    """The mean, if there are several."""
    error: float = math.nan
    """Standard error of the mean; NaN for a single number."""
    count: int = 1
    """How many numbers the mean is of."""
    better: Better = ""
    """Which way is better; empty for what describes and does not judge."""
    unit: str = ""
    note: str = ""
    """What it says, in a few words."""

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        error = f" ± {self.error:.2g}" if math.isfinite(self.error) else ""
        return f"{self.value:.4g}{error}{unit}"


def estimate(name: str, values: Sequence[float], **told: Any) -> Score:
    """Mean of independent values and its standard error, s/√n with the sample deviation s.

    Raises:
        ValueError: no value.
    """
    n = len(values)
    if not n:
        raise ValueError(f"{name} needs at least one value")
    mean = math.fsum(values) / n
    error = math.sqrt(math.fsum((v - mean) ** 2 for v in values) / (n - 1) / n) if n > 1 else math.nan
    return Score(name, mean, error, n, **told)


@dataclass(frozen=True)
class Scores(Result):
    """The numbers of one film, and why others are not there."""

    scores: tuple[Score, ...]
    absent: dict[str, str] = field(default_factory=dict)
    """Why a metric was left out, by its name."""
    curves: dict[str, Tensor] = field(default_factory=dict)
    """Values by frame, each of shape (T,)."""
    fps: float = 30.0
    """Frames per second of the curves [1/s]."""

    @classmethod
    def _from_data(cls, data: dict[str, Any]) -> Self:
        return cls(**data | {"scores": tuple(Score(**s) for s in data["scores"])})

    def __getitem__(self, name: str) -> Score:
        """The score of that name.

        Raises:
            KeyError: it was not taken; the message says why.
        """
        for score in self.scores:
            if score.name == name:
                return score
        raise KeyError(f"no score {name!r}: {self.absent.get(name, 'there is no metric of that name')}")


def across(runs: Sequence[Scores]) -> Scores:
    """Mean and standard error over runs that differ by their seed, of the scores that all of them have."""
    if not runs:
        raise ValueError("across needs at least one run")
    shared = [s for s in runs[0].scores if all(any(s.name == o.name for o in run.scores) for run in runs)]
    means = tuple(
        estimate(s.name, [run[s.name].value for run in runs], better=s.better, unit=s.unit, note=s.note) for s in shared
    )
    return Scores(means, {name: why for run in runs for name, why in run.absent.items()}, fps=runs[0].fps)
