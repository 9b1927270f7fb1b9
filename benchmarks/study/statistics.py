"""Means with error bars over people and prompts, strengths from pairs, agreement, and corrected tests. NumPy alone."""

from collections.abc import Sequence
from typing import Literal

import numpy as np

BOOTSTRAPS = 4000
PERMUTATIONS = 20_000


def pigeonhole(table: np.ndarray, *, seed: int = 0, draws: int = BOOTSTRAPS) -> np.ndarray:
    """Bootstrapped means over people and prompts, shape (draws, ...), of ``table`` (people, prompts, ...).

    People and prompts are drawn with replacement independently of each other: the claim is about other people *and*
    other prompts. NaN is absent. Owen (2007), The pigeonhole bootstrap: somewhat too wide, never too narrow.
    """
    draw = np.random.default_rng(seed)
    people, prompts = table.shape[:2]
    means = np.empty((draws, *table.shape[2:]))
    for k in range(draws):
        chosen = table[draw.integers(people, size=people)][:, draw.integers(prompts, size=prompts)]
        means[k] = np.nanmean(chosen, axis=(0, 1))
    return means


def interval(draws: np.ndarray, level: float = 0.95) -> tuple[np.ndarray, np.ndarray]:
    """Percentiles (1 ∓ level) / 2 over the first axis."""
    lo, hi = np.nanquantile(draws, [(1 - level) / 2, (1 + level) / 2], axis=0)
    return lo, hi


def sign_flip(differences: np.ndarray, *, seed: int = 0) -> float:
    """Two-sided p of the mean of one difference per person: under the null hypothesis each sign is a coin.

    p = (1 + #{|mean of flipped| ≥ |mean|}) / (1 + flips), over all 2^n flips if there are few people.
    """
    d = np.asarray(differences, dtype=float)
    n = len(d)
    if 2**n <= PERMUTATIONS:
        signs = 1 - 2 * ((np.arange(2**n)[:, None] >> np.arange(n)) & 1)
        means = np.abs(signs @ d)
        return float(np.mean(means >= abs(d.sum()) * (1 - 1e-12)))
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], size=(PERMUTATIONS, n))
    return float((1 + np.sum(np.abs(signs @ d) >= abs(d.sum()) * (1 - 1e-12))) / (1 + PERMUTATIONS))


def holm(p: Sequence[float]) -> list[float]:
    """p corrected for their number, in the order given: max over k ≤ j of (m − k) p_(k). Holm (1979)."""
    order = np.argsort(p)
    corrected, highest = [0.0] * len(p), 0.0
    for k, i in enumerate(order):
        highest = max(highest, min(1.0, (len(p) - k) * p[i]))
        corrected[i] = highest
    return corrected


def bradley_terry(wins: np.ndarray, *, prior: float = 0.5, tolerance: float = 1e-10) -> np.ndarray:
    """Strengths s_i, Σ s_i = 0, with P(i better than j) = 1 / (1 + exp(s_j − s_i)).

    A tie is half a win for both. Each two methods that were compared also count ``prior`` wins each, without which a
    method that never lost would be infinitely strong. Minorise–maximise: Hunter (2004), eq. 3.

    Args:
        wins: w_ij, how often i was better than j, shape (M, M).

    Raises:
        ValueError: the methods fall apart into groups that were never compared.
    """
    w = np.asarray(wins, dtype=float)
    shown = (w + w.T > 0) & ~np.eye(len(w), dtype=bool)
    reach = np.linalg.matrix_power(np.eye(len(w)) + shown, len(w)) > 0
    if not reach.all():
        raise ValueError("some methods were never compared, not even through others; their strengths mean nothing")
    w = w + prior * shown
    games, total = w + w.T, w.sum(1)
    strength = np.ones(len(w))
    while True:
        new = total / (games / (strength[:, None] + strength)).sum(1)
        new /= np.exp(np.log(new).mean())
        if np.abs(np.log(new / strength)).max() < tolerance:
            return np.log(new)
        strength = new


def krippendorff(table: np.ndarray, level: Literal["nominal", "ordinal", "interval"] = "ordinal") -> float:
    """Agreement α = 1 − D_observed / D_expected of raters; 1 is perfect, 0 is chance. Krippendorff (2011).

    Args:
        table: values, one row a rater and one column a thing; NaN is absent.
    """
    values = np.unique(table[~np.isnan(table)])
    k = len(values)
    coincidence = np.zeros((k, k))
    for column in table.T:
        seen = np.searchsorted(values, column[~np.isnan(column)])
        if len(seen) > 1:
            counts = np.bincount(seen, minlength=k).astype(float)
            coincidence += (np.outer(counts, counts) - np.diag(counts)) / (len(seen) - 1)
    n = coincidence.sum(1)
    if level == "nominal":
        distance = 1.0 - np.eye(k)
    elif level == "interval":
        distance = (values[:, None] - values) ** 2
    else:
        below = np.cumsum(n) - n / 2  # rank of the middle of each class
        distance = (below[:, None] - below) ** 2
    expected = (np.outer(n, n) * distance).sum() / (n.sum() - 1)
    return float(1 - (coincidence * distance).sum() / expected) if expected > 0 else float("nan")
