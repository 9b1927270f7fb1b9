"""The force of a hand: what it holds is pulled to where it is, as hard as is stated and no harder."""

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from diffuphy.mpm import Attractor, Drag, State
from diffuphy.mpm.drive import Drive
from diffuphy.mpm.scene import GRAVITY

CAP = 30.0 * GRAVITY
"""Largest acceleration by a hand that holds little [m/s²]. The time step reckons with the 10 m/s that it makes in a
frame of 1/30 s: in rubber, with waves of 30 m/s, a third more substeps than without a hand."""

POKE = 0.1
"""How long a poke lasts [s]."""

IDLE: tuple[Drive, Drive] = (
    Attractor(center=(0.0, 0.0, 0.0), strength=0.0, radius=1.0, falloff=0.0),
    Drag(time=1.0, end=1e-9),
)
"""A hand that holds nothing; of the same kinds as one that does, so that kernels are compiled once."""


@dataclass(frozen=True)
class _Grip:
    """What the page asked for."""

    at: tuple[float, float, float]
    """Where it took hold [m]."""
    to: tuple[float, float, float]
    """Where the hand is now [m]."""
    lasts: float = math.inf
    """For how long [s]."""


class Hand:
    """Particles within ``radius`` of a point are held; a spring that saturates draws them to the hand, and they resist.

        b = A d/s (1 + |d|²/s²)^(−½) − v/τ,    d = hand − x,   A = min(α g M/m, CAP),   s = radius

    M is the mass of the body and m that of what is held, so that the force is at most α weights of the body on Earth.
    The spring of the whole body has the frequency ω = √(α g/s), and τ = m/(2 ω M) damps it critically: a body follows
    without swinging, and the hand moves it no faster than A τ = ½ √(α g s). The drag is integrated exactly, and the
    time step reckons with the speed that A makes in a frame; neither can be unstable.

    Args:
        m: masses, shape (N,) [kg].
        radius: of what is taken hold of [m].
        strength: α, in weights of the body [-].
    """

    def __init__(self, m: Tensor, radius: float, strength: float = 3.0):
        self.m, self.radius, self.strength = m.detach().double().cpu(), radius, strength
        self._grip: _Grip | None = None
        self._held: tuple[Any, tuple[int, ...], float] | None = None

    def grab(self, at: tuple[float, float, float]) -> None:
        """Take hold of what is near ``at`` [m] when the next frame begins."""
        self._grip = _Grip(at, at)

    def move(self, to: tuple[float, float, float]) -> None:
        """Pull it there [m]."""
        grip = self._grip
        if grip is not None:
            self._grip = _Grip(grip.at, to, grip.lasts)

    def release(self) -> None:
        """Let go."""
        self._grip = None

    def poke(self, at: tuple[float, float, float], direction: tuple[float, float, float]) -> None:
        """Push what is near ``at`` [m] along ``direction``, for a moment."""
        reach = 4.0 * self.radius / math.hypot(*direction)
        self._grip = _Grip(at, tuple(a + reach * d for a, d in zip(at, direction, strict=True)), POKE)

    def steer(self, state: State) -> tuple[Drive, Drive]:
        """The drives of the frame that begins with ``state``."""
        grip = self._grip
        if grip is None:
            self._held = None
            return IDLE
        if self._held is None or self._held[0] != grip.at:
            near = (state.x.detach() - state.x.new_tensor(grip.at)).norm(dim=1) <= self.radius
            self._held = grip.at, tuple(near.nonzero()[:, 0].tolist()), state.time
        _, which, since = self._held
        if not which or state.time - since >= grip.lasts:
            self._grip = None if self._grip is grip else self._grip
            return IDLE
        return self._pull(which, grip.to)

    def _pull(self, which: tuple[int, ...], to: tuple[float, float, float]) -> tuple[Drive, Drive]:
        share = float(self.m[list(which)].sum() / self.m.sum())
        strength = min(self.strength * GRAVITY / share, CAP)
        omega = math.sqrt(self.strength * GRAVITY / self.radius)
        pull = Attractor(where=which, center=to, strength=strength, radius=self.radius, falloff=0.0)
        return pull, Drag(where=which, time=share / (2.0 * omega))


def pick(
    x: Tensor, origin: tuple[float, float, float], direction: tuple[float, float, float], reach: float
) -> tuple[float, float, float] | None:
    """The first particle that a ray meets: of those no farther than ``reach`` [m] beside it, the one met first.

    Args:
        x: positions, shape (N, 3) [m].
        origin, direction: of the ray; any length but 0.
    """
    e = torch.nn.functional.normalize(x.new_tensor(direction), dim=0)
    d = x.detach() - x.new_tensor(origin)
    along = d @ e
    beside = (d - along[:, None] * e).norm(dim=1)
    along = torch.where((beside <= reach) & (along > 0.0), along, torch.inf)
    p = int(along.argmin())
    return None if not math.isfinite(float(along[p])) else tuple(x[p].tolist())


def slide(
    eye: tuple[float, float, float], through: tuple[float, float, float], point: tuple[float, float, float]
) -> tuple[float, float, float]:
    """Where the ray from ``eye`` through ``through`` is as far away as ``point`` is: a point dragged across the screen
    moves on a sphere about the eye."""
    d = [b - a for a, b in zip(eye, through, strict=True)]
    far = math.dist(eye, point) / math.hypot(*d)
    x, y, z = (a + far * b for a, b in zip(eye, d, strict=True))
    return x, y, z
