"""Least squares in a few parameters: Levenberg–Marquardt with differences.

For studies of what a clip holds, apart from how the product finds it: a run takes some ten times P + 1 clips.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import torch
from torch import Tensor

from diffuphy.learning.identifiability import STEP
from diffuphy.types import SimulationDiverged


@dataclass
class Found:
    """Where a run ended."""

    q: Tensor
    """Coordinates of the best, shape (P,)."""
    cost: float
    """Half the sum of squares there."""
    clips: int
    """Clips that were simulated."""
    path: list[list[float]] = field(default_factory=list)
    """Accepted coordinates."""


def least_squares(
    residual: Callable[[Tensor], Tensor], q: Tensor, *, lo: Tensor, hi: Tensor, iterations: int = 15, tol: float = 5e-3
) -> Found:
    """Minimise ½ |r(q)|² inside a box.

        (JᵀJ + λ diag JᵀJ) δ = −Jᵀ r,   λ: a third after a success, four times after a failure

    Levenberg (1944), Marquardt (1963); J by one-sided differences. A step is at most 0.7 in any coordinate. Ends when
    a step is shorter than ``tol``.

    Raises:
        SimulationDiverged: the start cannot be simulated.
    """
    found = Found(q, math.inf, 0)

    def cost_of(at: Tensor) -> tuple[Tensor, float]:
        found.clips += 1
        r = residual(at).flatten().double()
        return r, 0.5 * float(r @ r)

    r, found.cost = cost_of(q)
    found.path.append(q.tolist())
    damping = 1e-2
    for _ in range(iterations):
        J = torch.stack([(cost_of(_beside(found.q, a, hi))[0] - r) / _width(found.q, a, hi) for a in range(len(q))], 1)
        g, H = J.T @ r, J.T @ J
        held = ((found.q <= lo) & (g > 0)) | ((found.q >= hi) & (g < 0))  # it would leave the box
        g, H = torch.where(held, 0.0, g), torch.where(held[:, None] | held, 0.0, H)
        while True:
            step = -torch.linalg.lstsq(H + damping * torch.diag(H.diagonal()), g[:, None], driver="gelsd").solution[
                :, 0
            ]
            step = step * min(1.0, 0.7 / max(float(step.abs().max()), 1e-12))
            there = (found.q + step).clamp(lo, hi)
            try:
                r_there, cost = cost_of(there)
            except SimulationDiverged:
                cost = math.inf
            if cost < found.cost:
                damping = max(damping / 3, 1e-6)
                break
            if float(step.abs().max()) < tol:
                return found
            damping *= 4
        moved = float((there - found.q).abs().max())
        found.q, found.cost, r = there, cost, r_there
        found.path.append(there.tolist())
        if moved < tol:
            return found
    return found


def _width(q: Tensor, a: int, hi: Tensor) -> float:
    """The difference goes inwards at the upper end."""
    return STEP if float(q[a]) + STEP <= float(hi[a]) else -STEP


def _beside(q: Tensor, a: int, hi: Tensor) -> Tensor:
    return q + _width(q, a, hi) * torch.eye(len(q), dtype=q.dtype)[a]
