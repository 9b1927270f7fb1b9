"""How fast drives may make a particle: what a time step must reckon with."""

import math
from collections.abc import Sequence

import numpy as np
from torch import Tensor

from diffuphy.mpm.boundary.motion import pose
from diffuphy.mpm.drive.drives import Acceleration, Drag, Drive, Held, Impulse, Release
from diffuphy.mpm.drive.layout import mass_of


def speed_bound(
    drives: Sequence[Drive],
    m: Tensor,
    tags: Tensor,
    low: Sequence[float],
    high: Sequence[float],
    start: float,
    end: float,
) -> float:
    """Bound on what the drives add to the largest speed of particles between two times [m/s].

        Σ over drives of max |b| × the time it acts;  |V| of a medium, and |V| + |ω| |x − c| of held particles

    Args:
        m: masses, shape (N,) [kg].
        tags: from ``layout.tags``.
        low, high: corners of the box that the particles are in meanwhile [m].
        start, end: the two times [s].
    """
    return sum(_bound(d, k, m, tags, low, high, start, end) for k, d in enumerate(drives))


def _bound(
    d: Drive, k: int, m: Tensor, tags: Tensor, low: Sequence[float], high: Sequence[float], start: float, end: float
) -> float:
    if isinstance(d, Release):
        return 0.0
    if isinstance(d, Impulse):
        active = max(0.0, min(end, d.start + d.duration) - max(start, d.start))
        return math.hypot(*d.impulse) / mass_of(k, m, tags) * active / d.duration
    active = max(0.0, min(end, d.end) - max(start, d.start))
    if active == 0.0:
        return 0.0
    if isinstance(d, Acceleration):
        return math.hypot(*d.acceleration) * active
    if isinstance(d, Drag):
        return math.hypot(*d.velocity)
    if isinstance(d, Held):
        V, w = (math.hypot(*d.velocity), math.hypot(*d.angular_velocity)) if d.schedule is None else d.schedule.rates
        at = pose(d.center, d.velocity, d.angular_velocity, d.schedule, d.start, np.array([start, end])).place
        return V + w * max(_farthest(c, low, high) for c in at)
    return abs(d.strength) * _peak(_farthest(d.center, low, high) / d.radius, d.falloff) * active


def _farthest(c: Sequence[float] | np.ndarray, low: Sequence[float], high: Sequence[float]) -> float:
    """Largest distance of a point of the box from c [m]."""
    return math.hypot(*(max(abs(a - e), abs(b - e)) for a, b, e in zip(low, high, c, strict=True)))


def _peak(t: float, p: float) -> float:
    """Largest s (1 + s²)^(−(p+1)/2) for 0 ≤ s ≤ t: it grows up to s = 1/√p, and for ever if p ≤ 0."""
    s = t if p <= 0.0 else min(t, 1.0 / math.sqrt(p))
    return s * (1.0 + s * s) ** (-0.5 * (p + 1.0))
