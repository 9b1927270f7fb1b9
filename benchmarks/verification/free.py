"""A1–A5, A8, A12: bodies that nothing touches. What they must keep, they keep to rounding."""

import math

import torch
from torch import Tensor

from benchmarks.verification.bodies import (
    Body,
    angular_momentum,
    at_rest,
    block,
    energy,
    kinetic,
    momentum,
    rotation,
    run,
    skew,
)
from benchmarks.verification.case import Check, Setting, at_least, at_most, case, near, within
from diffuphy.material import PLASTIC

DX = 0.04
DT = 2e-4
SPIN = (2.0, -1.0, 3.0)


def brick(turned: float = 0.4) -> Body:
    """12 × 7 × 16 particles, turned about z and off the grid lines on purpose."""
    body = block((6, 3.5, 8), DX)
    x = (body.x - body.x.mean(0)) @ rotation((0.0, 0.0, 1.0), turned).T
    return Body(x + x.new_tensor([0.5113, 0.4927, 0.5031]), body.vol)


def spinning(s: Setting, body: Body, frames: int = 10, per: int = 100):
    """The brick in flight, ω = (2, −1, 3) rad/s."""
    return run(s, body, DT, per, frames, scene={"dx": DX, "velocity": (0.11, -0.07, 0.05), "spin": SPIN})


def falling(s: Setting, body: Body, n: int) -> tuple[float, float, float]:
    """Largest errors of x [m], v [m/s] and F [-] after n substeps of free flight in five frames."""
    g, v0, dt = body.x.new_tensor([0.0, -9.81, 0.5]), body.x.new_tensor([0.3, 1.1, -0.2]), 1e-4
    fields = {"dx": DX, "gravity": tuple(g.tolist()), "velocity": tuple(v0.tolist())}
    end = run(s, body, dt, n // 5, 5, scene=fields)[-1]
    t = n * dt
    late = 0.0 if s.scheme.half_kick else 0.5 * t * dt  # symplectic Euler: Σ k Δt² = t²/2 + t Δt/2
    x = body.x + t * v0 + (0.5 * t * t + late) * g
    errors = (end.x - x, end.v - (v0 + t * g), end.F - torch.eye(3, dtype=x.dtype))
    return tuple(float(e.abs().max()) for e in errors)  # type: ignore[return-value]


@case("A1", "Free flight")
def flight(s: Setting) -> list[Check]:
    """x = x0 + v0 t + g t²/2 (symplectic Euler: + g t Δt/2), v = v0 + g t, F = I.

    Weights sum to one and reproduce affine fields, so nothing but rounding is left: 500 substeps of sums of 27 terms
    near 1 m, in float32 √500 roundings of 6e-8.
    """
    checks = []
    body = Body(block((6, 4.5, 5.5), DX, (0.31, 0.42, 0.36)).x, torch.full((1188,), (DX / 2) ** 3, dtype=torch.float64))
    for what, error in zip("xvF", falling(s, body, 500), strict=True):
        checks.append(at_most(f"largest error of {what}, float64", error, 1e-12))
    for plastic in ("von_mises", "drucker_prager"):
        dust = Body(body.x, body.vol, elastic="hencky", plastic=plastic)
        checks.append(at_most(f"largest error of x, {plastic}", falling(s, dust, 100)[0], 1e-12, "m"))
    single = falling(s, body.to(torch.float32), 500)
    checks.append(at_most("largest error of x, float32", single[0], 2e-6 * math.sqrt(500), "m"))
    return checks


@case("A1b", "Free flight of every law", tier=1)
def flight_of_all(s: Setting) -> list[Check]:
    """x = x0 + v0 t + g t²/2 and F = I whatever flows: no law acts where there is no strain."""
    x = block((3, 2, 3), DX, (0.31, 0.42, 0.36))
    checks = []
    for plastic in PLASTIC:
        body = Body(x.x, x.vol, elastic="hencky", plastic=plastic)
        for what, error in zip("xvF", falling(s, body, 100), strict=True):
            checks.append(at_most(f"largest error of {what}, {plastic}", error, 1e-12))
    cubic = zip("xvF", falling(s.cubic(), x, 100), strict=True)
    return [*checks, *(at_most(f"largest error of {what}, cubic", error, 1e-12) for what, error in cubic)]


@case("A2", "Mass on the grid")
def mass(s: Setting) -> list[Check]:
    """Σ_i m_i = Σ_p m_p, seen as the impulse of gravity: Δ Σ m v = g t Σ_i m_i.

    Particles on nodes, half way between nodes, at negative coordinates and anywhere: a clamped or misplaced index
    loses mass.
    """
    generator = torch.Generator().manual_seed(0)
    checks = []
    for dtype, limit in ((torch.float64, 1e-13), (torch.float32, 2e-6)):
        anywhere = 0.6 * torch.rand(200, 3, generator=generator, dtype=torch.float64) - 0.4
        lattice = torch.cartesian_prod(*[torch.arange(-4.0, 4.0, dtype=torch.float64) * DX / 2] * 3)
        x = torch.cat([anywhere, lattice])
        body = Body(x.to(dtype), torch.rand(len(x), generator=generator, dtype=torch.float64).to(dtype) + 0.5)
        end = run(s, body, 1e-4, 5, 1, scene={"dx": DX, "gravity": (0.0, 0.0, -10.0)})[-1]
        seen = float(momentum(body, end).double()[2]) / (-10.0 * 5e-4)
        total = float(body.m.double().sum())
        checks.append(at_most(f"|Σ_i m_i/Σ_p m_p − 1|, {name(dtype)}", abs(seen / total - 1), limit))
    return checks


def name(dtype: torch.dtype) -> str:
    return str(dtype).removeprefix("torch.")


def drifts(s: Setting, body: Body) -> tuple[float, float, Tensor]:
    """Relative drift of momentum and of angular momentum over 1000 substeps, and the latter at the start."""
    first, *_, last = spinning(s, body)
    D = s.scheme.inertia * DX * DX
    P, L = momentum(body, first), angular_momentum(body, first, D)
    dP, dL = momentum(body, last) - P, angular_momentum(body, last, D) - L
    return float(dP.norm() / P.norm()), float(dL.norm() / L.norm()), L


@case("A3", "Linear momentum")
def linear(s: Setting) -> list[Check]:
    """Σ m v of a spinning, vibrating brick does not change in 1000 substeps: Σ_i ∇w_ip = 0, forces sum to zero."""
    return [
        at_most("relative drift, float64", drifts(s, brick())[0], 1e-12),
        at_most("relative drift, float32", drifts(s, brick().to(torch.float32))[0], 2e-5),
    ]


@case("A4", "Angular momentum")
def angular(s: Setting) -> list[Check]:
    """Σ m (x × v + D ε:C), D = Δx²/4, of a spinning brick does not change in 1000 substeps.

    Jiang et al. (2015), §5.3: exact for any symmetric τ. The value at the start is that of an independent code.
    """
    _, dL, L = drifts(s, brick())
    start = float((L - L.new_tensor([0.9004611, 0.14964548, -0.73638298])).norm() / L.norm())
    return [
        at_most("relative drift, float64", dL, 1e-11),
        at_most("relative drift, float32", drifts(s, brick().to(torch.float32))[1], 2e-5),
        at_most("at the start, against an independent code", start, 1e-7),
    ]


@case("A4b", "Momenta with cubic splines and with flow", tier=1)
def momenta_of_others(s: Setting) -> list[Check]:
    """Σ m v and Σ m (x × v + D ε:C) are kept by any symmetric stress: with D = Δx²/3 by cubic splines, by flowing
    matter."""
    plain = brick()
    checks = []
    for plastic in ("von_mises", "viscoplastic"):
        soft = Body(plain.x, plain.vol, elastic="hencky", plastic=plastic, theta={"yield_stress": 50.0})
        dP, dL, _ = drifts(s, soft)
        checks += [at_most(f"drift of P, {plastic}", dP, 1e-12), at_most(f"drift of L, {plastic}", dL, 1e-11)]
    dP, dL, L = drifts(s.cubic(), plain)
    start = float((L - L.new_tensor([0.9061955, 0.14677828, -0.72778138])).norm() / L.norm())
    checks += [at_most("drift of P, cubic", dP, 1e-12), at_most("drift of L, cubic", dL, 1e-11)]
    return [*checks, at_most("L at the start, cubic, against an independent code", start, 1e-7)]


@case("A5", "One revolution", tier=1)
def revolution(s: Setting) -> list[Check]:
    """A free brick with ω = 2π/s turns by 360° in a second, keeps its size, its energy and F = R.

    Angle from the polar decomposition of Σ m r r0ᵀ. A growing size betrays F ← F (I + Δt L), a shrinking spin PIC.
    """
    body = brick(turned=0.0)
    body = Body(body.x, body.vol, E=1e6)
    steps = math.ceil(1.0 / (0.3 * DX / body.c))
    first, *_, last = run(s, body, 1.0 / steps, steps, 1, scene={"dx": DX, "spin": (0.0, 0.0, 2 * math.pi)})
    r0, r = (a.x - a.x.mean(0) for a in (first, last))
    U, _, Vh = torch.linalg.svd(r.T @ r0)
    R = U @ Vh
    angle = math.degrees(math.atan2(float(R[1, 0] - R[0, 1]), float(R[0, 0] + R[1, 1])))
    D = s.scheme.inertia * DX * DX
    ratio = kinetic(body, last.v, last.C, D) / kinetic(body, first.v, first.C, D)
    return [
        within("angle − 360°", angle, -0.3, 0.3, 0.0, "°"),
        within("size after/before − 1", float(r.norm() / r0.norm()) - 1, -1e-4, 1e-4, 0.0),
        within("kinetic energy after/before", ratio, 0.999, 1.001, 1.0),
        at_most("max |F − R|", float((last.F - R).abs().max()), 1e-3),
    ]


@case("A8", "Energy of a vibrating body")
def vibration(s: Setting) -> list[Check]:
    """Kinetic plus stored energy of a free body never grows: E(t) ≤ E(0) (1 + 1e-3) at CFL 0.4.

    A stress that is not the derivative of the energy, or F and τ of different times, drive it.
    """
    dx = 0.05
    body = block((4, 3, 5), dx, (0.013, 0.021, 0.037))
    dt = 0.4 * dx / body.c
    turning = skew(body.x.new_tensor(SPIN))
    v = 0.3 * torch.sin(9.0 * body.x) + (body.x - body.x.mean(0)) @ turning.T
    C = torch.diag_embed(2.7 * torch.cos(9.0 * body.x)) + turning
    states = run(s, body, dt, 6, 30, scene={"dx": dx}, state=at_rest(s, body, v=v, C=C))
    E = [energy(s, body, a, dt, dx) for a in states]
    rise = max(b - min(E[: i + 1]) for i, b in enumerate(E)) / E[0]
    return [
        at_most("largest rise above any earlier energy over E(0)", rise, 1e-3),
        at_least("energy left after 180 substeps", E[-1] / E[0], 0.5, 1.0),
    ]


@case("A12", "Determinism")
def determinism(s: Setting) -> list[Check]:
    """The same run twice gives the same bits, on one thread of a processor."""
    body = brick()
    one, two = (spinning(s, body, frames=1)[-1] for _ in range(2))
    same = all(torch.equal(a, b) for a, b in ((one.x, two.x), (one.v, two.v), (one.C, two.C), (one.He, two.He)))
    return [near("states equal to the last bit (1: yes)", float(same), 1.0, 0.0)]
