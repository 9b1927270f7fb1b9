"""From timed work to prices: a unit of work costs what makes all timings come out right.

    min_p≥0 Σ_rows ((Σ_units count · p − seconds) / seconds)²

Relative residuals, so that a short timing counts as much as a long one; no price is negative.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.optimize import lsq_linear, nnls

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
    """Prices of what only stages do [s], from films whose points and rounds have been counted; one stage after the
    other, since some share a unit."""
    prices: dict[str, float] = {}
    for stage in ("prompt", "gaussians", "particles", "clip", "material", "trajectory"):
        rows = [(f["stages"][stage]["work"], f["stages"][stage]["processor"]) for f in films]
        prices |= fit(rows, {**known, **prices})
    return prices


FACTOR = 1.0, 4.0
"""Bounds of how many times over something is in memory at a stage's peak: what is kept, is kept once; a list that is
stacked and a result that is saved are there twice and more."""


def memory(films: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Bytes of the process, more of it with the code and the libraries of each stage, and how many times over each kind
    of thing is in memory."""
    rows = [(name, stage["sizes"], stage["bytes"]) for f in films for name, stage in f["stages"].items()]
    kinds = sorted({k for _, sizes, _ in rows for k in sizes})
    stages = list(dict.fromkeys(name for name, *_ in rows))
    base = min(size for *_, size in rows)
    A = np.zeros((len(rows), len(stages) + len(kinds)))
    for i, (name, sizes, _) in enumerate(rows):
        A[i, stages.index(name)] = base
        A[i, len(stages) :] = [sizes.get(kind, 0.0) for kind in kinds]
    lowest = np.array([0.0] * len(stages) + [FACTOR[0]] * len(kinds))
    highest = np.array([1.0] * len(stages) + [FACTOR[1]] * len(kinds))
    scale = base / np.abs(A).max(0)
    found = lsq_linear(A * scale / base, [(r[2] - base) / base for r in rows], (lowest / scale, highest / scale))
    values = (found.x * scale).tolist()
    own = {f"stage.{name}": round(base * value) for name, value in zip(stages, values, strict=False)}
    return {
        "process": round(base),
        **own,
        **{k: round(v, 3) for k, v in zip(kinds, values[len(stages) :], strict=True)},
    }
