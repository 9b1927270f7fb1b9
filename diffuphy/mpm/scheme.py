"""How particles and grid exchange momentum, and how time is stepped: every part a switch.

The default is MLS-APIC with four additions, each of which can be turned off:

    half kick     velocities are advanced half a step first and last in a frame (kick–drift–kick): second order in Δt
    mirror walls  slip and sticky walls on a plane of nodes reflect mass and momentum: second order in Δx at the wall
    sharpening    a* = a + S a / m on the grid takes out the inertia m D |C|²/2 that the affine field adds to a mode
    retention     v' = V + α (v − V⁰), α = 1 − Δt/τ: what the grid cannot see dies with a time, not with a step

``Scheme.mls()`` and ``Scheme.apic()`` are the plain schemes (Hu et al. 2018; Jiang et al. 2015) for comparison.
"""

from dataclasses import dataclass
from typing import Literal

Force = Literal["mls", "classic"]
Contact = Literal["elastic", "rigid"]

SHARPENING = {("mls", 2): 0.20, ("classic", 2): 0.25, ("mls", 3): 0.30, ("classic", 3): 1 / 3}
"""Coefficient of the sharpening [Δx²]: the inertia D of the affine field, less what the force of the moving least
squares already gives back."""


@dataclass(frozen=True)
class Scheme:
    """Transfer between particles and grid, walls and time integration."""

    order: int = 2
    """Degree of the B-spline: 2 reaches 27 nodes, 3 reaches 64 and costs twice as much."""
    force: Force = "mls"
    """"mls" takes forces and ∇v from the affine moments, "classic" from the gradient of the weights."""
    half_kick: bool = True
    """Kick–drift–kick within a frame instead of symplectic Euler; one more force evaluation a frame."""
    mirror: bool = True
    """Reflect at slip and sticky walls that lie on a plane of nodes; else their nodes are set."""
    sharpen: bool = True
    """Sharpen the acceleration on the grid; conserves momentum and angular momentum."""
    contact: Contact = "rigid"
    """"rigid": walls that separate take the velocity of their nodes, which feel matter from 1½ cells away; "elastic":
    they push on matter that lies too deep, see ``boundary.kernels_elastic``: bodies touch before they turn, but thin
    layers creep and what is seeded on a slanted wall is pushed off. Films are made with it."""
    retain: float = 1.0
    """Time constant τ of retention [Δx/c]: 0 keeps nothing (APIC), larger is less dissipative and noisier."""

    def __post_init__(self) -> None:
        if self.order not in (2, 3):
            raise ValueError(f"order must be 2 (quadratic) or 3 (cubic), got {self.order}")
        if self.force not in ("mls", "classic"):
            raise ValueError(f"force must be 'mls' or 'classic', got {self.force!r}")
        if self.contact not in ("elastic", "rigid"):
            raise ValueError(f"contact must be 'elastic' or 'rigid', got {self.contact!r}")
        if not 0.0 <= self.retain < float("inf"):
            raise ValueError(f"retain must be finite and not negative, got {self.retain}; 0 turns it off")

    @classmethod
    def mls(cls, order: int = 2) -> "Scheme":
        """Plain MLS-MPM: affine transfer, symplectic Euler, wall nodes set."""
        return cls(order=order, half_kick=False, mirror=False, sharpen=False, retain=0.0)

    @classmethod
    def apic(cls, order: int = 2) -> "Scheme":
        """Plain APIC: forces from the gradient of the weights, symplectic Euler, wall nodes set."""
        return cls(order=order, force="classic", half_kick=False, mirror=False, sharpen=False, retain=0.0)

    @property
    def inertia(self) -> float:
        """D of the affine transfer [Δx²]: ¼ for quadratic, ⅓ for cubic splines."""
        return 0.25 if self.order == 2 else 1.0 / 3.0

    @property
    def sharpening(self) -> float:
        """Coefficient of S [-], 0 when off."""
        return SHARPENING[self.force, self.order] if self.sharpen else 0.0

    @property
    def keeps(self) -> bool:
        """Whether particles keep something of their velocity, so that they need that of the nodes before the step."""
        return self.half_kick or self.retain > 0.0
