"""B2, B3, B8: elastic waves in a bar, whose solutions are known in closed form."""

import dataclasses
import itertools
import math
from functools import lru_cache

import torch
from torch import Tensor

from benchmarks.verification.bodies import Body, at_rest, block, crossings, order, peaks, run
from benchmarks.verification.case import SETTINGS, Check, Setting, at_least, at_most, case, within
from diffuphy.mpm import HalfSpace, State

L = 1.0
C = 10.0
"""Wave speed √(E/ρ) at ν = 0 [m/s]."""
PERIOD = 2 * L / C
"""Of the first longitudinal mode of a free bar [s]."""
SPEED = 1e-5 * C
"""Velocity at its ends [m/s]: at strains of 1e-5 the second harmonic, which grows by ε/4 in a radian, stays below the
smallest error that is measured."""
AMPLITUDE = SPEED * L / (math.pi * C)


def bar(n: int, corner: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Body:
    """Length 1, n × 2 × 2 cells, ν = 0: no pressure on the sides."""
    return block((n, 2, 2), L / n, corner, nu=0.0)


def released(
    s: Setting,
    body: Body,
    cfl: float,
    halves: int,
    *,
    drift: tuple[float, float, float] = (0.0, 0.0, 0.0),
    turn: Tensor | None = None,
) -> list[State]:
    """``halves`` half periods after v = V cos(π X/L), C = ∇v; Δt ≤ cfl Δx/c, at least 20 frames in each."""
    X = body.x[:, 0] - body.x[:, 0].min() + (body.vol[0] ** (1 / 3)) / 2
    dx = 2 * float(body.vol[0]) ** (1 / 3)
    R = torch.eye(3, dtype=body.x.dtype) if turn is None else turn
    placed = dataclasses.replace(body, x=body.x @ R.T)
    steps = math.ceil(0.5 * PERIOD * C / (cfl * dx))
    per = max(1, steps // 20)
    frames = math.ceil(steps / per)
    dt = 0.5 * PERIOD / (frames * per)
    k = math.pi / L
    v, grad = torch.zeros_like(body.x), torch.zeros(len(X), 3, 3, dtype=body.x.dtype)
    v[:, 0], grad[:, 0, 0] = SPEED * torch.cos(k * X), -SPEED * k * torch.sin(k * X)
    start = at_rest(s, placed, v=(v + v.new_tensor(drift)) @ R.T, C=R @ grad @ R.T)
    return run(s, placed, dt, per, halves * frames, scene={"dx": dx}, state=start)


def mode(body: Body, states: list[State]) -> list[float]:
    """Part of the velocity in the first mode over that at the start."""
    shape = torch.cos(math.pi * body.x[:, 0] / L)
    return [float((a.v[:, 0] * shape).sum() / (shape * shape).sum()) / SPEED for a in states]


@lru_cache
def ringing(s: Setting, n: int, cfl: float, periods: int = 2) -> tuple[float, float]:
    """Relative error of the period, and energy lost in one period."""
    body = bar(n)
    states = released(s, body, cfl, 2 * periods)
    q = mode(body, states)
    t = crossings(q)
    tops = [abs(p) for p in peaks(q)]  # at T/2, T, 3T/2
    return (t[2] - t[0]) * states[1].time / PERIOD - 1.0, 1.0 - (tops[2] / tops[0]) ** 2


@lru_cache
def displacement_error(
    s: Setting,
    n: int,
    cfl: float,
    *,
    drift: tuple[float, float, float] = (0.0, 0.0, 0.0),
    corner: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> float:
    """Largest rms error of u = A cos(π X/L) sin(π c t/L) over A, in the second of two periods."""
    body = bar(n, corner)
    states = released(s, body, cfl, 4, drift=drift)
    shape = AMPLITUDE * torch.cos(math.pi * (body.x[:, 0] - corner[0]) / L)
    errors = []
    for state in states:
        if state.time < PERIOD:
            continue
        u = state.x - body.x - state.time * body.x.new_tensor(drift)
        u[:, 0] -= shape * math.sin(math.pi * C * state.time / L)
        errors.append(float((u * u).sum(1).mean().sqrt()))
    return max(errors) / AMPLITUDE


@case("B2", "Free bar")
def free_bar(s: Setting) -> list[Check]:
    """T = 2L/c. The affine field adds the inertia D |C|²/2: T grows by (π²/8)(Δx/L)² for D = Δx²/4 (1.31 measured with
    classic forces, 1.0 with MLS, by an independent code)."""
    errors = {n: ringing(s, n, 0.3) for n in (8, 16, 32)}
    checks = []
    if s.improved:
        for n in (8, 16):
            gain = displacement_error(SETTINGS["apic"], n, 0.4) / displacement_error(s, n, 0.4)
            checks.append(at_least(f"error of plain APIC over this one, {n} cells", gain, 5.0))
        losses = [ringing(s, 16, cfl)[1] for cfl in (0.74, 0.4, 0.1, 0.05)]
        checks.append(
            at_most("loss per period, largest over smallest, CFL 0.74 … 0.05", max(losses) / min(losses), 1.5)
        )
        checks.append(at_most("|period error| (L/Δx)², 32 cells", abs(errors[32][0]) * 32**2, 0.7))
    else:
        for n in (16, 32):
            checks.append(within(f"period error (L/Δx)², {n} cells", errors[n][0] * n * n, 0.7, 2.0))
        ratio = errors[16][0] / errors[32][0]
        checks.append(within("period error, 16 cells over 32", ratio, 3.6, 4.4, 4.0))
        checks.append(within("period error, 8 cells over 16", errors[8][0] / errors[16][0], 3.4, 4.6, 4.0))
    checks.append(at_most("energy lost per period, 32 cells", errors[32][1], 2e-3))
    return checks


@case("B2b", "Free bar: small time steps", tier=1)
def free_bar_small_steps(s: Setting) -> list[Check]:
    """Energy lost per period at CFL 0.74 … 0.0125: plain APIC loses per step, so that small steps lose more."""
    losses = [ringing(s, 32, cfl)[1] for cfl in (0.74, 0.4, 0.1, 0.0125)]
    texts = ("0.74", "0.4", "0.1", "0.0125")
    checks = [within(f"loss per period at CFL {c}", v, 0.0, 0.05, 0.0) for c, v in zip(texts, losses, strict=True)]
    spread = max(losses) / min(losses)
    if s.improved:
        return [*checks, at_most("largest over smallest", spread, 1.5)]
    return [*checks, at_least("largest over smallest: the known fault of the plain scheme", spread, 10.0)]


@lru_cache
def column(s: Setting, n: int) -> tuple[float, float, float]:
    """Relative errors of the period and of the lowest centre of mass of a column under sudden gravity, and the largest
    rms error of u in the first period over g H²/c²."""
    body = block((2, 2, n), L / n, nu=0.0)
    g, dx = 1e-3, L / n  # strains of 1e-5: at 1e-2 the neo-Hookean law is 1 % stiffer in compression
    fall = g * L * L / (C * C)
    frames = 60
    per = math.ceil(4 * L / C * 1.2 / frames / (0.3 * dx / C))
    dt = 4 * L / C * 1.2 / frames / per
    wall = HalfSpace(kind="slip")
    states = run(s, body, dt, per, frames, scene={"dx": dx, "gravity": (0.0, 0.0, -g), "boundaries": (wall,)})
    X = body.x[:, 2]
    # u = −g/c² (H X − X²/2) + Σ_k (g/c²) 2/(H k³) sin kX cos kct, k = (n + ½) π/H
    k = (torch.arange(400, dtype=X.dtype) + 0.5) * math.pi / L
    waves = 2 * g / (C * C * L) * torch.sin(X[:, None] * k) / k**3
    still = -g / (C * C) * (L * X - X * X / 2)
    errors = []
    for state in states[1:51]:
        exact = still + (waves * torch.cos(k * C * state.time)).sum(1)
        errors.append(float(((state.x[:, 2] - X - exact) ** 2).mean().sqrt()))
    centre = [float((a.x[:, 2] - X).mean()) for a in states]
    speed = [b - a for a, b in itertools.pairwise(centre)]  # at the middle of each frame
    low = crossings(speed)[0] + 0.5
    return 2 * low * per * dt / (4 * L / C) - 1, min(centre) / (-2 * fall / 3) - 1, max(errors) / fall


@case("B3", "Column under sudden gravity")
def sudden_gravity(s: Setting) -> list[Check]:
    """T = 4H/c, lowest centre of mass −2gH²/(3c²) (d'Alembert).

    Zeroed wall nodes soften the first cell: errors of first order, +.31 Δx/H of the period with classic forces and
    +.17 with MLS (independent code). A wall one node off makes T 33 % longer.
    """
    found = {n: column(s, n) for n in (8, 16, 32)}
    if s.improved:
        gain = column(SETTINGS["apic"], 16)[2] / found[16][2]
        return [
            at_least("order of u, 8 to 16 cells", order(found[8][2], found[16][2]), 1.8, 2.0),
            at_least("order of u, 16 to 32 cells", order(found[16][2], found[32][2]), 1.8, 2.0),
            at_least("error of plain APIC over this one, 16 cells", gain, 5.0),
            within("period error H/Δx, 16 cells", found[16][0] * 16, -0.06, 0.06, 0.0),
            within("error of the lowest centre of mass H/Δx, 16 cells", found[16][1] * 16, -0.15, 0.15, 0.0),
        ]
    checks = []
    for n in (16, 32):
        T, centre, _ = found[n]
        checks.append(within(f"period error H/Δx, {n} cells", T * n, 0.0, 0.6, 0.0))
        checks.append(within(f"error of the lowest centre of mass H/Δx, {n} cells", centre * n, 0.0, 1.5, 0.0))
    return [*checks, within("order of u, 16 to 32 cells", order(found[16][2], found[32][2]), 0.8, 1.2, 1.0)]


def returned(s: Setting, n: int) -> tuple[float, float]:
    """A bar run for a quarter of a period, stopped, and run back: what is left of u, and v over that at the start."""
    body = bar(n)
    half = released(s, body, 0.3, 1)
    there, start = half[len(half) // 2], half[0]
    back = at_rest(s, body, x=there.x, He=there.He, v=-there.v, C=-there.C)
    dx = L / n
    per = math.ceil(there.time / (0.3 * dx / C))
    end = run(s, body, there.time / per, per, 1, scene={"dx": dx}, state=back)[-1]
    u = (end.x - body.x).norm(dim=1).max() / (there.x - body.x).norm(dim=1).max()
    return float(u), float(-(end.v * start.v).sum() / (start.v * start.v).sum())


@case("B8", "Time reversal")
def reversal(s: Setting) -> list[Check]:
    """u(2t) = 0 and v(2t) = −v(0) when v and C are reversed at t = T/4.

    What is left is dissipation and, with symplectic Euler, half a step: 5.7e-2 and 2.9e-2 of the amplitude at 16 and
    32 cells, order one (independent code).
    """
    u16, v16 = returned(s, 16)
    u32, v32 = returned(s, 32)
    better = 5.0 if s.improved else 1.0
    checks = [
        at_most("u left, 16 cells", u16, 0.07 / better),
        at_most("u left, 32 cells", u32, 0.035 / better),
        within("|v| at the end over the start, 16 cells", v16, 0.99, 1.001, 1.0),
        within("|v| at the end over the start, 32 cells", v32, 0.999, 1.001, 1.0),
    ]
    return [*checks, at_least("order of u left", order(u16, u32), 0.8, 1.0)]
