"""Which particles a drive acts on, and where."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from diffuphy.mpm.boundary.motion import Vec, direction, vector


@dataclass(frozen=True, kw_only=True)
class InBox:
    """low ≤ x ≤ high along every axis."""

    low: Vec
    """Lowest corner [m]."""
    high: Vec
    """Highest corner [m]."""

    def __post_init__(self) -> None:
        for name in ("low", "high"):
            object.__setattr__(self, name, vector(name, getattr(self, name)))
        if not all(a < b for a, b in zip(self.low, self.high, strict=True)):
            raise ValueError(f"low must be below high along every axis, got low = {self.low}, high = {self.high} m")

    def contains(self, x: Tensor) -> Tensor:
        """Mask of the points inside, shape (N, 3) → (N,)."""
        return ((x >= x.new_tensor(self.low)) & (x <= x.new_tensor(self.high))).all(1)

    def numbers(self, low: np.ndarray) -> np.ndarray:
        """The six numbers of a row, from the lowest node ``low`` [m]."""
        return np.concatenate([np.asarray(self.low) - low, np.asarray(self.high) - low])


@dataclass(frozen=True, kw_only=True)
class InBall:
    """|x − center| ≤ radius."""

    center: Vec
    """Centre [m]."""
    radius: float
    """Radius [m]."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "center", vector("center", self.center))
        _positive("radius", self.radius)

    def contains(self, x: Tensor) -> Tensor:
        """Mask of the points inside, shape (N, 3) → (N,)."""
        return (x - x.new_tensor(self.center)).norm(dim=1) <= self.radius

    def numbers(self, low: np.ndarray) -> np.ndarray:
        """The six numbers of a row, from the lowest node ``low`` [m]."""
        return np.array([*(np.asarray(self.center) - low), self.radius, 0.0, 0.0])


@dataclass(frozen=True, kw_only=True)
class InCylinder:
    """Within ``radius`` of an axis, and within height/2 of the centre along it."""

    center: Vec
    """Centre [m]."""
    axis: Vec = (0.0, 0.0, 1.0)
    """Direction of the axis; any length but 0."""
    radius: float
    """Radius [m]."""
    height: float
    """Length along the axis [m]."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "center", vector("center", self.center))
        object.__setattr__(self, "axis", direction("axis", self.axis))
        for name in ("radius", "height"):
            _positive(name, getattr(self, name))

    def contains(self, x: Tensor) -> Tensor:
        """Mask of the points inside, shape (N, 3) → (N,)."""
        e, a = x - x.new_tensor(self.center), x.new_tensor(self.axis)
        h = e @ a
        return (h.abs() <= self.height / 2) & ((e - h[:, None] * a).norm(dim=1) <= self.radius)


Where = InBox | InBall | InCylinder | tuple[int, ...] | Tensor | None
"""A region of initial positions; indices of particles; a mask; or None for all of them."""


def _positive(name: str, value: float) -> None:
    if not 0.0 < value < float("inf"):
        raise ValueError(f"{name} must be positive and finite, got {value} m")


def as_where(where: Any) -> InBox | InBall | InCylinder | tuple[int, ...] | None:
    """A selection as something frozen: a mask or a tensor of indices becomes a tuple of indices.

    Raises:
        ValueError: what selects nothing.
    """
    if where is None or isinstance(where, InBox | InBall | InCylinder):
        return where
    if isinstance(where, Tensor | np.ndarray):
        t = torch.as_tensor(where).detach().cpu()
        if t.ndim != 1 or t.dtype.is_floating_point or t.dtype.is_complex:
            raise ValueError(f"where must be a mask or indices of shape (N,), got {t.dtype} of shape {tuple(t.shape)}")
        where = (t.nonzero()[:, 0] if t.dtype == torch.bool else t).tolist()
    if not isinstance(where, Sequence) or isinstance(where, str) or not all(type(i) is int for i in where):
        raise ValueError(f"where must be InBox, InBall, InCylinder, indices, a mask or None, got {where!r}")
    if not where or min(where) < 0:
        raise ValueError(f"where must name at least one particle, from 0, got {tuple(where[:8])}")
    return tuple(where)


def chosen(where: Any, x: Tensor) -> Tensor:
    """Mask of the particles at ``x`` (N, 3) [m] that ``where`` selects, shape (N,).

    Raises:
        ValueError: an index beyond the particles.
    """
    if where is None:
        return torch.ones(len(x), dtype=torch.bool, device=x.device)
    if not isinstance(where, tuple):
        return where.contains(x)
    if max(where) >= len(x):
        raise ValueError(f"where names particle {max(where)}, there are {len(x)}, 0 … {len(x) - 1}")
    mask = torch.zeros(len(x), dtype=torch.bool, device=x.device)
    mask[torch.tensor(where, device=x.device)] = True
    return mask


def attached(held: Tensor, x: Tensor, reach: float) -> Tensor:
    """Mask of the particles with another one that is held nearer than ``reach``, shape (N,).

    Args:
        held: mask, shape (N,).
        x: positions, shape (N, 3) [m].
        reach: distance [m].
    """
    from scipy.spatial import KDTree

    places, mask = x.double().cpu().numpy(), held.cpu().numpy()
    if not mask.any():
        return torch.zeros_like(held)
    apart, _ = KDTree(places[mask]).query(places, k=2, distance_upper_bound=reach)
    nearest = np.where(mask, apart[:, 1], apart[:, 0])  # of what is held the first is itself
    return torch.from_numpy(np.isfinite(nearest)).to(held.device)
