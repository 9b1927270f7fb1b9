"""C1–C3: Coulomb friction on a plane, walls that move what touches them, and one that is moved by it."""

import dataclasses
import math
from functools import lru_cache

import torch
from torch import Tensor

from benchmarks.verification.bodies import Body, block, momentum, run
from benchmarks.verification.case import Check, Setting, at_most, case, near, within
from diffuphy.mpm import Box, HalfSpace, Sphere, State
from diffuphy.mpm.report import FrameReport

DX, G = 0.04, 9.81
STIFF = 1e6


Cells = tuple[float, float, float]
SLAB = (8, 3, 2)
"""Cells of what slides, L/H = 4: the whole of its underside is pressed where tan θ < L/3H (a cube lifts its heel, and
rocks)."""


def slab(cells: Cells) -> Body:
    return block(cells, DX, E=STIFF)


def step_of(body: Body, T: float, frames: int) -> tuple[float, int]:
    """Δt at CFL 0.4 and substeps a frame, so that they fill ``frames`` frames in T."""
    per = math.ceil(T / frames / (0.4 * DX / body.c))
    return T / frames / per, per


def tilted(angle: float) -> tuple[float, float, float]:
    """Gravity as seen from a plane inclined by ``angle`` [rad]."""
    return (G * math.sin(angle), 0.0, -G * math.cos(angle))


@lru_cache
def settled(s: Setting, cells: Cells, angle: float) -> State:
    """A body that has come to rest on the incline, held by friction: forty periods 4H/c after being put there."""
    body = slab(cells)
    T = 40 * 4 * cells[2] * DX / body.c
    dt, per = step_of(body, T, 1)
    wall = HalfSpace(friction=4.0)
    end = run(s, body, dt, per, 1, scene={"dx": DX, "gravity": tilted(angle), "boundaries": (wall,)})[-1]
    return dataclasses.replace(end, time=0.0)


def slide(s: Setting, cells: Cells, angle: float, wall: HalfSpace, T: float, v0: float = 0.0) -> list[Tensor]:
    """Mean displacement along the plane [m] and mean velocity [m/s] at 8 times up to T, after having settled."""
    body = slab(cells)
    start = settled(s, cells, angle)
    start = dataclasses.replace(start, v=start.v + start.v.new_tensor([v0, 0.0, 0.0]))
    dt, per = step_of(body, T, 8)
    scene = {"dx": DX, "gravity": tilted(angle), "boundaries": (wall,)}
    states = run(s, body, dt, per, 8, scene=scene, state=start)
    return [torch.stack([f(a)[0] for a in states]) for f in (lambda a: (a.x - start.x).mean(0), lambda a: a.v.mean(0))]


@case("C1", "Coulomb friction on an incline", schemes=("default", "elastic", "mls", "apic"))
def incline(s: Setting) -> list[Check]:
    """a = g (sin θ − μ cos θ) if tan θ > μ, else 0: d = a t²/2. The kink is at μ = tan θ.

    θ = 35°, t = 0.4 s, from rest on the incline; d to 1.5 % of that without friction, and to 0.02 in μ near the kink,
    where nodes that are pressed less than others slide first. On the flat a body of v0 stops after v0²/(2 μ g). What
    sticks creeps less than 3 mm (0.08 Δx) and is slower than 5 mm/s.
    """
    angle, T = math.radians(35.0), 0.4
    tan, way = math.tan(angle), G * math.cos(angle) * T * T / 2
    checks, slides = [], {}
    for mu, off in ((0.0, 0.015 * tan), (0.3, 0.015 * tan), (0.6, 0.015 * tan), (tan - 0.05, 0.02)):
        slides[mu] = float(slide(s, SLAB, angle, HalfSpace(friction=mu), T)[0][-1])
        checks.append(near(f"d at μ = {mu:.3g}", slides[mu], (tan - mu) * way, off * way, "m"))
    kink = 0.6 + slides[0.6] * 0.3 / (slides[0.3] - slides[0.6])
    checks.append(near("μ at which d vanishes, from μ = 0.3 and 0.6", kink, tan, 0.02))
    for mu in (
        (tan + 0.05, 1.0) if s.scheme.contact == "elastic" else (1.0,)
    ):  # rigid contact rattles, and slips when it does
        d, v = (abs(float(a[-1])) for a in slide(s, SLAB, angle, HalfSpace(friction=mu), T))
        checks += [at_most(f"|d| at μ = {mu:.3g}", d, 3e-3, "m"), at_most(f"|v| at μ = {mu:.3g}", v, 5e-3, "m/s")]
    stop = 1.0 / (2 * 0.4 * G)
    d, v = (float(a[-1]) for a in slide(s, SLAB, 0.0, HalfSpace(friction=0.4), 0.4, v0=1.0))
    checks.append(near("way to rest from 1 m/s at μ = 0.4", d, stop, 0.015 * stop, "m"))
    return [*checks, at_most("|v| then", abs(v), 5e-3, "m/s")]


@case("C1b", "Coulomb friction of a larger block", tier=1)
def incline_of_five(s: Setting) -> list[Check]:
    """The same of a block of 0.4 × 0.2 × 0.12 m for half a second: d = g (sin 35° − 0.3 cos 35°) t²/2 = 0.402 m."""
    angle, T = math.radians(35.0), 0.5
    exact = G * (math.sin(angle) - 0.3 * math.cos(angle)) * T * T / 2
    d = float(slide(s, (10, 5, 3), angle, HalfSpace(friction=0.3), T)[0][-1])
    creep = float(slide(s, (10, 5, 3), math.radians(20.0), HalfSpace(friction=0.5), T)[0][-1])
    return [
        near("d, θ = 35°, μ = 0.3", d, exact, 0.015 * exact, "m"),
        at_most("|d|, θ = 20°, μ = 0.5", abs(creep), 3e-3, "m"),
    ]


def books(s: Setting, body: Body, T: float, frames: int, **scene: object) -> tuple[list[State], float]:
    """The states, and the largest |Σ m Δv − M g t − impulse of the walls| of a frame over the largest momentum."""
    dt, per = step_of(body, T, frames)
    reports: list[FrameReport] = []
    fields = {"dx": DX} | scene
    states = run(s, body, dt, per, frames, scene=fields, report=reports, gather=("impulse",))
    p = [momentum(body, a) for a in states]
    fall = body.m.sum() * p[0].new_tensor(fields.get("gravity", (0.0, 0.0, 0.0))) * per * dt
    left = [q1 - q0 - fall - r.impulse for q0, q1, r in zip(p, p[1:], reports, strict=False)]
    return states, max(float(e.norm()) for e in left) / max(float(q.norm()) for q in p)


@case("C2", "Walls that move")
def movers(s: Setting) -> list[Check]:
    """A plate of friction μ and speed V drags: v = min(μ g t, V). Σ m Δv = M g t + the impulse that walls record.

    Loaded suddenly the cube rings; over whole periods its pressure is its weight. μ = 0.3, V = 0.5 m/s: 2 % of V. A
    sticky box from t = 0.05 to 0.15 s around a body moves it by V (0.15 − 0.05) s, to a substep.
    """
    body, plate = slab((4, 4, 4)), HalfSpace(friction=0.3, velocity=(0.5, 0.0, 0.0))
    states, lost = books(s, body, 0.3, 6, gravity=(0.0, 0.0, -G), boundaries=(plate,))
    v = [float(a.v[:, 0].mean()) for a in states]
    checks = [
        near("v after 0.1 s on the plate", v[2], 0.3 * G * 0.1, 0.01, "m/s"),
        near("v after 0.3 s on the plate", v[6], 0.5, 0.01, "m/s"),
        at_most("|Σ m Δv − M g t − impulse| over Σ m v, plate", lost, 1e-10),
    ]
    middle = (2 * DX,) * 3
    box = Box(center=middle, size=(15 * DX,) * 3, kind="sticky", velocity=(0.5, 0.0, 0.0), start=0.05, end=0.15)
    states, lost = books(s, body, 0.2, 4, boundaries=(dataclasses.replace(box, reset=0.025),))
    dt, _ = step_of(body, 0.2, 4)
    way = (states[-1].x - body.x)[:, 0]
    carried = (states[2].v - states[2].v.new_tensor([0.5, 0.0, 0.0])).norm(dim=1)
    return [
        *checks,
        within("way in the box, least", float(way.min()), 0.05 - 0.5 * dt, 0.05 + 0.5 * dt, 0.05, "m"),
        within("way in the box, most", float(way.max()), 0.05 - 0.5 * dt, 0.05 + 0.5 * dt, 0.05, "m"),
        at_most("|v − V| of every particle in the box", float(carried.max()), 1e-12, "m/s"),
        at_most("|Σ m Δv − impulse| over Σ m v, box", lost, 1e-10),
    ]


@case("C2b", "A sticky box drags a block", tier=1)
def dragged(s: Setting) -> list[Check]:
    """The lower half of a block is in a sticky box of 0.5 m/s: its mean velocity over periods comes to 0.5 m/s.

    The upper half rings as a cantilever: 2 % for a mean that ends within a period.
    """
    body = block((4, 4, 6), DX, E=1e5)
    box = Box(center=(2 * DX, 2 * DX, DX), size=(10 * DX, 10 * DX, 4 * DX), kind="sticky", velocity=(0.5, 0.0, 0.0))
    states, lost = books(s, body, 0.6, 48, boundaries=(box,))
    v = torch.stack([a.v[:, 0].mean() for a in states[16:]])
    return [
        near("mean velocity over the last 0.4 s", float(v.mean()), 0.5, 0.01, "m/s"),
        at_most("|Σ m Δv − impulse| over Σ m v", lost, 1e-10),
    ]


@lru_cache
def struck(s: Setting, share: float) -> tuple[float, float, float]:
    """A cube at 1 m/s against a ball at rest that weighs ``share`` of it: relative drift of the momentum of both,
    momentum aside over that ahead, and restitution.

    The ball is a wall whose velocity is that of a free body: after each frame of one substep it takes the opposite of
    the impulse that walls record.
    """
    body, radius, v0 = block((4, 4, 4), DX, E=1e5), 3 * DX, 1.0
    m = float(body.m.sum())
    M = share * m
    ball = Sphere(center=(-radius - 1.25 * DX, 2 * DX, 2 * DX), radius=radius)
    dt = 0.4 * DX / (body.c + 2 * v0)
    given, V = torch.zeros(3, dtype=body.x.dtype), (0.0, 0.0, 0.0)
    (state,) = run(s, body, dt, 1, 0, scene={"dx": DX, "velocity": (-v0, 0.0, 0.0)})
    first, worst = momentum(body, state), 0.0
    for _ in range(round(12 * 4 * DX / body.c / dt)):  # six times the way of a wave there and back
        reports: list[FrameReport] = []
        scene = {"dx": DX, "boundaries": (dataclasses.replace(ball, velocity=V),)}
        state = run(s, body, dt, 1, 1, scene=scene, state=state, report=reports, gather=("impulse",))[-1]
        state = dataclasses.replace(state, time=0.0)
        ball = dataclasses.replace(ball, center=tuple(c + dt * u for c, u in zip(ball.center, V, strict=True)))
        given = given - reports[0].impulse  # type: ignore[operator]
        V = tuple((given / M).tolist())
        worst = max(worst, float((momentum(body, state) + given - first).norm() / first.norm()))
    v = float(momentum(body, state)[0]) / m
    return worst, float(given[1:].norm() / given.norm()), (v - V[0]) / v0


@case("C3", "A rigid ball that is struck")
def two_way(s: Setting) -> list[Check]:
    """Σ m v + M V stays, of a body and a rigid ball that takes the impulse which its wall records.

    The solver has no rigid bodies of its own: this is how one is coupled from outside, a substep a frame. The ball sits
    on the axis of the cube, so nothing is passed aside. More speed after than before would be energy from nothing; what
    is missing vibrates in the cube, at v/c = 0.09.
    """
    checks = []
    for share in (0.5, 4.0):
        lost, aside, e = struck(s, share)
        what = f"M = {share:g} m"
        checks += [
            at_most(f"{what}: drift of Σ m v + M V over m v", lost, 1e-10),
            at_most(f"{what}: momentum aside over that ahead", aside, 1e-10),
            within(f"{what}: restitution", e, 0.4, 1.0, 1.0),
        ]
    return checks
