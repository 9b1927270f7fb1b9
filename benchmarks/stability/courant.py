"""The largest stable time step of every law, found by halving, and that which the clock would take.

A cube off the lattice vibrates in free space at 1e-3 c in all directions at random, so that every wave the grid knows
is there; and a particle alone, which only its own affine field answers: Δt² max_i Σ_j |∂T_i/∂e_j| ≤ 4 D ρ = Δx² ρ, at
rest c Δt/Δx ≤ √((λ + 2μ)/(3λ + 2μ)), 0.58 in a liquid, less what sharpening takes. A step is stable if after 300 of
them the energy is at most ten times that at first: near the limit that of a leapfrog swings by 1/(1 − (ωΔt)²/4), and
beyond it grows by a factor every substep.
"""

import dataclasses
import math
from dataclasses import dataclass

import torch

from benchmarks.stability.cells import CELLS, DX, MATTERS, Cell, field, wave
from benchmarks.verification.bodies import block
from diffuphy.material import make_mixture
from diffuphy.mpm import Grid, Scene, Scheme, Solver, Span
from diffuphy.mpm.diagnostics import diagnose
from diffuphy.mpm.scene import STABLE
from diffuphy.mpm.state import REAL, initial_state, make_matter

NUS = (0.0, 0.3, 0.49)
LOW, HIGH, STEPS = 0.25, 4.0, 7
"""Courant numbers between which is looked, and how often the interval is halved in its logarithm: to 2 %."""
ROUNDS, GROWTH = 300, 10.0
CHOSEN = Scene().cfl
"""Courant number at which the clock works."""


@dataclass(frozen=True)
class Courant:
    """The largest stable step of one material."""

    matter: str
    nu: float
    alone: bool
    """Whether of one particle, else of a body."""
    largest: float
    """c Δt/Δx; ``HIGH`` where that is stable too."""

    @property
    def margin(self) -> float:
        """Over what the clock takes."""
        return self.largest / CHOSEN

    @property
    def holds(self) -> bool:
        """Whether the step beyond which the clock refuses a pinned one is stable."""
        return self.largest >= STABLE


def stable(matter: str, nu: float, courant: float, scheme: Scheme, alone: bool = False) -> bool:
    """Whether steps of ``courant`` Δx/c are, of a body or of a particle alone."""
    body = block((0.5,) * 3 if alone else (CELLS,) * 3, DX, (0.013, 0.021, 0.337))
    elastic, plastic, branches = MATTERS[matter]
    mixture = make_mixture(elastic, plastic, REAL[torch.float64], branches)
    material = field(matter, len(body.x), 1e5, nu, 1e-2, torch.float64)
    made = make_matter(material, body.vol, mixture.params, torch.float64, False)
    scene = Scene(gravity=(0.0, 0.0, 0.0), dx=DX, boundaries=(), lift=None, scheme=scheme)
    c = wave(Cell(matter, nu=nu))
    generator = torch.Generator().manual_seed(0)
    shake = 1e-3 * c * torch.randn(body.x.shape, dtype=torch.float64, generator=generator)
    state = initial_state(scene, body.x, made, mixture, None if alone else shake)
    if alone:
        state = dataclasses.replace(
            state, C=1e-3 * c / DX * torch.randn(1, 3, 3, dtype=torch.float64, generator=generator)
        )
    solver = Solver(
        mixture, (), scene.gravity, torch.float64, "cpu", particles=len(body.x), dx=DX, scheme=scheme, grad=False
    )
    low, high = ((body.x.amin(0) - 4 * DX).tolist(), (body.x.amax(0) + 4 * DX).tolist())
    span = Span(
        Grid.around(low, high, DX, scheme.order), 0.0, courant * DX / c, ROUNDS, c, scheme.retain, scheme.half_kick
    )
    end, status, _ = solver.advance(state, made, span)
    if any(status):
        return False
    before, after = (diagnose(mixture, s, made, DX, scheme) for s in (state, end))
    energy = after.kinetic + after.elastic
    return math.isfinite(energy) and energy <= GROWTH * (before.kinetic + before.elastic)


def largest(matter: str, nu: float, alone: bool = False) -> Courant:
    """By halving the logarithm of the interval."""
    scheme = Scheme()
    low, high = LOW, HIGH
    if not stable(matter, nu, low, scheme, alone):
        return Courant(matter, nu, alone, 0.0)
    if stable(matter, nu, high, scheme, alone):
        return Courant(matter, nu, alone, high)
    for _ in range(STEPS):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if stable(matter, nu, middle, scheme, alone) else (low, middle)
    return Courant(matter, nu, alone, low)
