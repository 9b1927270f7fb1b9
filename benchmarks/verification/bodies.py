"""Bodies of known material, runs of exactly known steps, and what is measured on their states.

Energies and momenta are written out here in torch and not taken from the solver: a check must not share the mistake it
looks for.
"""

import dataclasses
import itertools
import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor

from benchmarks.verification.case import Setting
from diffuphy.material import ELASTIC, PLASTIC
from diffuphy.mpm import State, simulate
from diffuphy.types import MaterialField


@dataclass(frozen=True)
class Body:
    """N particles of one material."""

    x: Tensor
    """Positions at rest, shape (N, 3) [m]."""
    vol: Tensor
    """Rest volumes, shape (N,) [m³]."""
    E: float = 1e5
    """Young's modulus [Pa]."""
    nu: float = 0.3
    """Poisson's ratio [-]."""
    rho: float = 1000.0
    """Density [kg/m³]."""
    elastic: str = "neo_hookean"
    plastic: str = "identity"
    theta: dict[str, float] = field(default_factory=dict)
    """Parameters other than E and ν; the defaults of the laws where missing."""

    @property
    def field(self) -> MaterialField:
        """The material as the solver takes it."""
        one = torch.ones_like(self.vol)
        known = {p.name: p.default for law in (ELASTIC[self.elastic], PLASTIC[self.plastic]) for p in law.params}
        values = known | {"E": self.E, "nu": self.nu} | self.theta
        theta = {k: v * one for k, v in values.items()}
        weight = one[:, None].clone()
        return MaterialField((self.elastic,), (self.plastic,), weight, weight.clone(), theta, self.rho * one)

    @property
    def m(self) -> Tensor:
        """Masses, shape (N,) [kg]."""
        return self.rho * self.vol

    @property
    def lame(self) -> tuple[float, float]:
        """λ and μ [Pa]."""
        return self.E * self.nu / ((1 + self.nu) * (1 - 2 * self.nu)), self.E / (2 * (1 + self.nu))

    @property
    def c(self) -> float:
        """Speed of pressure waves √((λ + 2μ)/ρ) [m/s]."""
        lam, mu = self.lame
        return math.sqrt((lam + 2 * mu) / self.rho)

    def to(self, dtype: torch.dtype) -> "Body":
        """The same in another precision."""
        return dataclasses.replace(self, x=self.x.to(dtype), vol=self.vol.to(dtype))


def block(
    cells: tuple[float, float, float],
    dx: float,
    corner: tuple[float, float, float] = (0.0, 0.0, 0.0),
    per: int = 2,
    **material: Any,
) -> Body:
    """A box of ``cells`` grid cells with ``per`` particles along each axis of a cell, in float64."""
    h = dx / per
    axes = [
        (torch.arange(round(c * per), dtype=torch.float64) + 0.5) * h + o for c, o in zip(cells, corner, strict=True)
    ]
    x = torch.cartesian_prod(*axes)
    return Body(x, torch.full((len(x),), h**3, dtype=torch.float64), **material)


def rotation(axis: tuple[float, float, float], angle: float) -> Tensor:
    """Rotation matrix about an axis by an angle [rad]."""
    a = torch.tensor(axis, dtype=torch.float64)
    return torch.linalg.matrix_exp(skew(a / a.norm() * angle))


def skew(a: Tensor) -> Tensor:
    """[a]×, so that [a]× b = a × b."""
    z = torch.zeros_like(a[0])
    return torch.stack([z, -a[2], a[1], a[2], z, -a[0], -a[1], a[0], z]).reshape(3, 3)


def run(
    s: Setting, body: Body, dt: float, per: int, frames: int, /, *, scene: dict[str, Any] | None = None, **options: Any
) -> list[State]:
    """The states after 0, per, 2 per … substeps of exactly ``dt``."""
    made = dataclasses.replace(s.scene(**(scene or {})), fps=1.0 / (dt * per))
    return list(simulate(made, body.x, body.vol, body.field, frames=frames, dt=dt * (1 + 1e-9), **options))


def at_rest(s: Setting, body: Body, **tensors: Tensor) -> State:
    """The body as it lies, F = I, with some of its tensors replaced."""
    (first,) = run(s, body, 1.0, 1, 0)
    return dataclasses.replace(first, **tensors)


def momentum(body: Body, state: State) -> Tensor:
    """Σ m v, shape (3,) [kg m/s]."""
    return (body.m[:, None] * state.v).sum(0)


def angular_momentum(body: Body, state: State, inertia: float) -> Tensor:
    """Σ m (x × v + D ε:C) about the origin, shape (3,) [kg m²/s] (Jiang et al. 2015, §5.3); D in m²."""
    C = state.C
    spin = torch.stack([C[:, 2, 1] - C[:, 1, 2], C[:, 0, 2] - C[:, 2, 0], C[:, 1, 0] - C[:, 0, 1]], 1)
    return (body.m[:, None] * (torch.linalg.cross(state.x, state.v) + inertia * spin)).sum(0)


def kinetic(body: Body, v: Tensor, C: Tensor, inertia: float) -> float:
    """Σ m (|v|² + D |C|²)/2 [J]."""
    return float(0.5 * (body.m * ((v * v).sum(1) + inertia * (C * C).sum((1, 2)))).sum())


def stored(body: Body, F: Tensor) -> Tensor:
    """Energy ψ per rest volume of each particle [Pa]: the textbook formulas, in singular values.

    neo-Hookean  μ/2 (|F|² − 3) − μ ln J + λ/2 (ln J)²      fixed corotated  μ |F − R|² + λ/2 (J − 1)²
    Hencky       μ |ln S|² + λ/2 (ln J)²
    """
    lam, mu = body.lame
    s = torch.linalg.svdvals(F)
    J = torch.linalg.det(F)
    if body.elastic == "neo_hookean":
        return mu / 2 * ((F * F).sum((-2, -1)) - 3) - mu * J.log() + lam / 2 * J.log() ** 2
    if body.elastic == "fixed_corotated":
        return mu * ((s - 1) ** 2).sum(-1) + lam / 2 * (J - 1) ** 2
    if body.elastic == "hencky":
        return mu * (s.log() ** 2).sum(-1) + lam / 2 * J.log() ** 2
    raise ValueError(f"no formula for {body.elastic!r} here; known: neo_hookean, fixed_corotated, hencky")


def energy(s: Setting, body: Body, state: State, dt: float, dx: float) -> float:
    """Kinetic and stored energy at one time [J].

    With symplectic Euler velocities lag positions by Δt/2, which alone would make the sum swing by ω Δt; they are then
    averaged with those one substep later.
    """
    v, C = state.v, state.C
    if not s.scheme.half_kick:
        *_, later = run(s, body, dt, 1, 1, scene={"dx": dx}, state=state)
        v, C = 0.5 * (v + later.v), 0.5 * (C + later.C)
    return kinetic(body, v, C, s.scheme.inertia * dx * dx) + float((body.vol * stored(body, state.F)).sum())


def crossings(q: list[float]) -> list[float]:
    """Where samples at 0, 1, 2 … pass zero, by the cubic through the four samples around; at frequency ω per sample its
    error is about ω⁴/100 samples."""
    out = []
    for i, (a, b) in enumerate(itertools.pairwise(q)):
        if not (a > 0 >= b or a < 0 <= b):
            continue
        k = min(max(i - 1, 0), len(q) - 4)
        roots = np.roots(np.polyfit(np.arange(4.0), q[k : k + 4], 3)) + k
        real = roots[np.abs(roots.imag) < 1e-9].real
        out.append(float(real[np.argmin(np.abs(real - (i + a / (a - b))))]))
    return out


def peaks(q: list[float]) -> list[float]:
    """Values of the local extremes inside, by the parabola through three samples; relative error about ω⁴/400."""
    out = []
    for a, b, c in zip(q, q[1:], q[2:], strict=False):
        if (b - a) * (c - b) <= 0 and b != a:
            d = 0.5 * (c - a)
            out.append(b - d * d / (2 * (a - 2 * b + c)))
    return out


def order(coarse: float, fine: float) -> float:
    """Observed order log₂(e_h/e_{h/2})."""
    return math.log2(coarse / fine)
