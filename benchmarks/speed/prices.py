"""From timed work to prices: a unit of work costs what makes all timings come out right.

    min_p≥0 Σ_rows ((Σ_units count · p − seconds) / seconds)²

Relative residuals, so that a short timing counts as much as a long one; no price is negative.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.optimize import nnls

from diffuphy.cost.rollouts import Work

Row = tuple[Work, float]
"""Some work, and how long it took [s]."""


def fit(rows: Sequence[Row], known: Mapping[str, float] | None = None) -> dict[str, float]:
    """Prices of the units that ``known`` lacks [s].

    Args:
        rows: timed work.
        known: prices that are taken as they are.
    """
    known = known or {}
    units = sorted({u for work, _ in rows for u, n in work.items() if n and u not in known})
    A = np.zeros((len(rows), len(units)))
    b = np.zeros(len(rows))
    for i, (work, seconds) in enumerate(rows):
        b[i] = (seconds - sum(known[u] * n for u, n in work.items() if u in known)) / seconds
        for j, unit in enumerate(units):
            A[i, j] = work.get(unit, 0.0) / seconds
    scale = np.abs(A).max(0)
    prices, _ = nnls(A / scale, b)
    return {unit: float(f"{p:.4g}") for unit, p in zip(units, prices / scale, strict=True)}


def errors(rows: Iterable[Row], prices: Mapping[str, float]) -> list[float]:
    """Predicted over measured, less one, of each row."""
    return [sum(prices[u] * n for u, n in work.items() if n) / seconds - 1.0 for work, seconds in rows]


def of_stages(films: Sequence[Mapping[str, Any]], known: Mapping[str, float]) -> dict[str, float]:
    """Prices of what only stages do [s], from films whose points have been counted.

    A rollout of the last stage but one has no unit of its own, and what is left of each is fitted by itself.
    """
    prices: dict[str, float] = {}
    for stage in ("prompt", "gaussians", "particles", "clip", "material"):
        rows = [(f["stages"][stage]["work"], f["stages"][stage]["processor"]) for f in films]
        prices |= fit(rows, {**known, **prices})
    return prices


def memory(films: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Bytes of the process and of each kind of thing that stages keep."""
    rows = [(stage["sizes"] | {"process": 1.0}, stage["bytes"]) for f in films for stage in f["stages"].values()]
    return fit(rows)
