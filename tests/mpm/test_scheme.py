"""What the parts of the scheme are for: order in space and time at walls, small errors, losses that do not depend on
the time step."""

import math

import pytest
import torch
import warp as wp

from diffuphy.material import make_mixture
from diffuphy.mpm import HalfSpace, Scene, Scheme, simulate
from diffuphy.mpm.diagnostics import diagnose
from diffuphy.mpm.grid import Grid
from diffuphy.mpm.span import Span
from diffuphy.mpm.state import State, initial_state, make_matter
from tests.mpm.bodies import RHO, block, field

E, C0 = 1e5, 10.0
"""Young's modulus [Pa] and c = √(E/ρ) [m/s] of bodies of 1 m with ν = 0."""


def bar(n: int, scheme: Scheme, cfl: float = 0.4, periods: float = 2.0, amplitude: float = 1e-4):
    """A free bar of n cells, v = v̂ cos(π X/L) with its gradient in C: states at 40 frames a period T = 2 L/c, and what
    they are made of."""
    dx, T = 1 / n, 2 / C0
    x, vol = block((n, 2, 2), dx)
    scene = Scene(
        gravity=(0.0, 0.0, 0.0), dx=dx, fps=40 / T, frames=round(40 * periods), boundaries=(), lift=None, cfl=cfl,
        scheme=scheme,
    )  # fmt: skip
    f = field(len(x), E=E, nu=0.0)
    v = torch.zeros_like(x)
    v[:, 0] = amplitude * C0 * torch.cos(math.pi * x[:, 0])
    mixture = make_mixture(f.elastic, f.plastic, wp.float64)
    state = initial_state(scene, x, make_matter(f, vol, mixture.params, x.dtype), mixture, v)
    state.C[:, 0, 0] = -amplitude * C0 * math.pi * torch.sin(math.pi * x[:, 0])
    return simulate(scene, x, vol, f, state=state), x, vol, f


def bar_error(n: int, scheme: Scheme, **options: float) -> float:
    """Largest rms error of u = (v̂/ω) sin ω t cos π X in the second of two periods, relative to its amplitude."""
    states, x, *_ = bar(n, scheme, **options)
    mode, w, worst = torch.cos(math.pi * x[:, 0]), math.pi * C0, 0.0
    for i, s in enumerate(states):
        u = (s.x - x)[:, 0] / (1e-4 / math.pi)
        if i >= 40:
            worst = max(worst, float((u - math.sin(w * s.time) * mode).square().mean().sqrt()))
    return worst


def bar_loss(n: int, scheme: Scheme, cfl: float) -> float:
    """Share of the energy that is lost in a period: mean of two."""
    states, _, vol, f = bar(n, scheme, cfl)
    mixture = make_mixture(f.elastic, f.plastic, wp.float64)
    matter = make_matter(f, vol, mixture.params, torch.float64)
    first, *_, last = states

    def energy(s: State) -> float:
        d = diagnose(mixture, s, matter, 1 / n, scheme)
        return d.kinetic + d.elastic

    return 0.5 * math.log(energy(first) / energy(last))


def column_error(n: int, scheme: Scheme, case: str = "slip", cfl: float = 0.4) -> float:
    """A column of 1 m on a wall when gravity g sets in: largest rms error over two periods 4 H/c of

        u(z, t) = −(g/c²) (H z − z²/2) + Σ_k (2 g / H c² κ³) sin κ z cos κ c t,   κ = (k + ½) π / H,

    relative to g H²/2c²; c² = E/ρ with ν = 0, or between slip walls on all sides (λ + 2μ)/ρ.
    """
    g, dx, nu = 1e-3, 1 / n, 0.3 if case == "confined" else 0.0
    width = 5 if case == "confined" else 2  # cells; mirrors that face each other keep that distance
    offset = 0.3 * dx if scheme.mirror else 0.0  # plain walls need the plane on the lattice
    x, vol = block((width, width, n), dx, (0.0, 0.0, offset))
    up = -1.0 if case == "hanging" else 1.0
    place = offset + (1.0 if case == "hanging" else 0.0)
    kind = "sticky" if case == "sticky" else "slip"
    walls = [HalfSpace(kind=kind, point=(0.0, 0.0, place), normal=(0.0, 0.0, up))]
    if case == "confined":
        walls += [
            HalfSpace(kind="slip", point=(width * dx * side * (a == 0), width * dx * side * (a == 1), 0.0),
                      normal=tuple((1.0 - 2 * side) * (a == k) for k in range(3)))
            for a in (0, 1) for side in (0, 1)
        ]  # fmt: skip
    scene = Scene(
        gravity=(0.0, 0.0, -g * up), dx=dx, fps=100.0, frames=80, boundaries=tuple(walls), lift=None, cfl=cfl,
        scheme=scheme,
    )  # fmt: skip
    c2 = E / RHO * ((1 - nu) / (1 + nu) / (1 - 2 * nu))
    z = up * (x[:, 2] - place)
    kappa = (torch.arange(200, dtype=x.dtype) + 0.5) * math.pi
    modes = 2 * g / (c2 * kappa**3) * torch.sin(z[:, None] * kappa)
    worst = 0.0
    for s in simulate(scene, x, vol, field(len(x), E=E, nu=nu)):
        exact = -g / c2 * (z - z * z / 2) + modes @ torch.cos(kappa * math.sqrt(c2) * s.time)
        worst = max(worst, float((up * (s.x - x)[:, 2] - exact).square().mean().sqrt()) / (g / (2 * c2)))
    return worst


@pytest.fixture(scope="module")
def classic() -> dict[tuple[str, int], float]:
    """Errors of plain APIC: the bar, and the column on a slip wall, of 8 and 16 cells."""
    return {("bar", n): bar_error(n, Scheme.apic()) for n in (8, 16)} | {
        ("column", n): column_error(n, Scheme.apic()) for n in (8, 16)
    }


def test_a_bar_vibrates_with_order_two_and_a_fifth_of_the_error(classic):
    """|u − u_exact| falls as Δx² at fixed CFL; plain APIC has the same order and a larger constant, since the inertia
    of its affine field makes the period (π²/8)(Δx/L)² too long."""
    coarse, fine = (bar_error(n, Scheme()) for n in (8, 16))
    assert math.log2(coarse / fine) > 1.8
    assert coarse < classic["bar", 8] / 5 and fine < classic["bar", 16] / 5


@pytest.mark.parametrize("case", ["slip", "sticky", "hanging", "confined"])
def test_a_column_under_sudden_gravity_has_order_two_at_its_wall(case, classic):
    """A mirror is second order in Δx and half a kick is second order in Δt, whichever side of the body the wall is on
    and with walls all around; nodes that are set, and a whole first kick, are first order."""
    coarse, fine = (column_error(n, Scheme(), case) for n in (8, 16))
    assert math.log2(coarse / fine) > 1.8
    assert coarse < classic["column", 8] / 5 and fine < classic["column", 16] / 5
    assert math.log2(classic["column", 8] / classic["column", 16]) < 1.3  # the case does tell orders apart


@pytest.mark.parametrize("n", [16, 32])
def test_losses_do_not_depend_on_the_time_step(n):
    """α = 1 − Δt/τ: what the grid cannot see dies with a time, so that energy is lost per second and not per step.
    exp(−Δt/τ) would lose (1 − e^−0.75)/0.75 = 0.70 of it at CFL 0.75, 1.6 times less than at small steps, 32 cells."""
    losses = [bar_loss(n, Scheme(), cfl) for cfl in (0.75, 0.1, 0.0125)]
    assert min(losses) > 0 and max(losses) < 1.5 * min(losses)


def test_plain_apic_loses_ten_times_as_much_with_small_steps():
    """The transfer filters once a step: with Δt 64 times smaller the same second is filtered 64 times as often."""
    plain = [bar_loss(16, Scheme.apic(), cfl) for cfl in (0.75, 0.1, 0.0125)]
    assert max(plain) > 10 * min(plain)


def test_nothing_is_retained_in_a_time_constant_shorter_than_a_substep():
    """α = max(0, 1 − Δt c/(τ Δx)): 0.6 for τ = Δx/c at c Δt = 0.4 Δx, 0 for a quarter of that τ; ∂α/∂c = −Δt/(τ Δx)
    or 0."""
    grid = Grid.around([0.0] * 3, [1.0] * 3, 0.1, 2, (0.0, 0.0, 0.0))
    long, short = (Span(grid, 0.0, 0.004, 1, wave=10.0, retain=tau) for tau in (1.0, 0.25))
    assert long.alpha == pytest.approx(0.6, rel=1e-14) and long.wave_bar(1.0, 0.0) == pytest.approx(-0.04, rel=1e-14)
    assert short.alpha == 0.0 and short.wave_bar(1.0, 0.0) == 0.0
