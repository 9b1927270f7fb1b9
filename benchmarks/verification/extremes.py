"""D1–D5, D7, D13, D15: stiff, nearly incompressible, squeezed, fast, light and far bodies, and other units."""

import dataclasses
import math

import torch
from torch import Tensor

from benchmarks.verification.bodies import Body, block, crossings, momentum
from benchmarks.verification.case import Check, Setting, at_most, case, near, within
from benchmarks.verification.points import refused, yes
from diffuphy.mpm import HalfSpace, State, simulate
from diffuphy.mpm.report import FrameReport
from diffuphy.types import SimulationDiverged

DX = 0.05
PRECISIONS = {"float64": torch.float64, "float32": torch.float32}


def det(F: Tensor) -> Tensor:
    return torch.linalg.det(F.double())


def film(s: Setting, body: Body, fps: float, frames: int, **rest: object) -> tuple[list[State], list[FrameReport]]:
    """States and reports with the time step that the solver takes; ``rest`` goes to the scene or to ``simulate``."""
    options = {k: rest.pop(k) for k in ("velocity", "state", "dt", "grad", "diagnose") if k in rest}
    if isinstance(options.get("velocity"), tuple):
        rest["velocity"] = options.pop("velocity")
    scene = dataclasses.replace(s.scene(**({"dx": DX} | rest)), fps=fps)
    reports: list[FrameReport] = []
    states = simulate(scene, body.x, body.vol, body.field, frames=frames, report=reports, **options)  # type: ignore[arg-type]
    return list(states), reports


def column(s: Setting, E: float, g: float, dtype: torch.dtype) -> tuple[float, float, Tensor]:
    """Error of the period 4H/c of a column of eight cells under sudden gravity, Δt c, and the strains F_zz − 1 at each
    of 60 times."""
    H, n = 1.0, 8
    body = block((2, 2, n), H / n, E=E, nu=0.0).to(dtype)
    T, frames = 4 * H / math.sqrt(E / body.rho), 60
    floor = HalfSpace(kind="slip")
    fps = frames / (1.2 * T)
    states, reports = film(s, body, fps, frames, dx=H / n, gravity=(0.0, 0.0, -g), boundaries=(floor,))
    v = [float(a.v[:, 2].double().mean()) for a in states]
    low = crossings(v[1:])[0] + 1  # the first is 0
    strains = torch.stack([a.He[:, 2, 2].double() for a in states])
    return low / 60 * 1.2 / 0.5 - 1, reports[0].dt * math.sqrt(E / body.rho), strains


@case("D1", "Stiffness over ten decades", schemes=("default",))
def stiffness(s: Setting) -> list[Check]:
    """T = 4H/c for E = 1e2 … 1e11 Pa with ρ g H/E = 1e-3: the same motion in units of H and H/c, and Δt ∝ E^−½.

    In float64 only rounding differs. In float32 each of some 300 substeps rounds v and H to 6e-8 of themselves.
    """
    checks = []
    for name, dtype in PRECISIONS.items():
        decades = (1e2, 1e5, 1e8, 1e11) if dtype == torch.float32 else [10.0**k for k in range(2, 12)]
        found = [column(s, E, 1e-3 * E / 1000.0, dtype) for E in decades]
        T, dt = [a[0] for a in found], [a[1] for a in found]
        spread = 1e-9 if dtype == torch.float64 else 300 * 6e-8
        checks += [
            at_most(f"|period error|, largest, {name}", max(abs(t) for t in T), 0.02),
            at_most(f"period over decades, largest − smallest, {name}", max(T) - min(T), spread),
            at_most(f"Δt √E over decades, largest/smallest − 1, {name}", max(dt) / min(dt) - 1, 1e-6),
        ]
    return checks


@case("D2", "Stiff bodies in float32", schemes=("default",))
def unfrozen(s: Setting) -> list[Check]:
    """ρ g H/E = 1e-3, 1e-5, 1e-7 in float32: strains to 2⁻²⁴, the period as in float64.

    F − I and the displacement within a frame are stored, so that increments of any size add up: a body whose F or x is
    stored freezes at 1e-7. The stress is that of F = I + (F − I), which rounds to 2⁻²⁴: noise in the strains of that
    size, whatever they are, and ten times less of it in the mean over 256 particles.
    """
    checks = []
    for strain in (1e-3, 1e-5, 1e-7):
        E = 1000.0 * 9.81 / strain
        (T64, _, e64), (T32, _, e32) = (column(s, E, 9.81, d) for d in PRECISIONS.values())
        checks.append(
            at_most(f"rms error of the strains at {strain:g}", float((e32 - e64).square().mean().sqrt()), 2**-24)
        )
        limit = max(0.1 * 2**-24 / strain, 1e-4)
        checks.append(at_most(f"|change of the period| over itself at {strain:g}", abs(T32 - T64), limit))
    return checks


def cube(dtype: torch.dtype = torch.float64, cells: int = 2, **material: float | str) -> Body:
    """A small cube off the lattice."""
    return block((cells,) * 3, DX, (0.013, 0.021, 0.337), **material).to(dtype)  # type: ignore[arg-type]


@case("D3", "Time steps that are too long", schemes=("default",))
def unstable(s: Setting) -> list[Check]:
    """A pinned Δt of 2, 10, 100 times 0.75 Δx/(c + |v|) is refused before the first step, with the largest that would
    do; that one is stable.

    Energy of a vibrating cube after 200 such steps: not more than at first, by 1 % (Δt² errors at CFL 0.75).
    """
    body = cube()
    v = 0.3 * torch.sin(30.0 * body.x)
    limit = 0.75 * DX / (body.c + float(v.norm(dim=1).max()))
    checks = []
    for factor in (2.0, 10.0, 100.0):
        long = factor * limit * 1.001
        pinned = refused(
            lambda t=long: film(s, body, 1 / (400 * limit), 1, velocity=v, dt=t), words=("unstable", "use")
        )
        checks.append(yes(f"refused at {factor:g} times", pinned))
    _, reports = film(s, body, 1 / (50 * limit * 0.999), 4, velocity=v, dt=limit, diagnose=True)
    first = 0.5 * float((body.m[:, None] * v * v).sum())
    last = reports[-1].balance.end  # type: ignore[union-attr]
    return [*checks, within("energy after 200 of the largest steps", (last.kinetic + last.elastic) / first, 0.5, 1.01)]


@case("D4", "Nearly incompressible bodies", schemes=("default",))
def incompressible(s: Setting) -> list[Check]:
    """ν = 0.45 … 0.4999: Δt ∝ 1/c, c² = E (1 − ν)/((1 + ν)(1 − 2ν) ρ); the volume of a sheared cube stays to 1 %;
    ν = 0.5, 0.7, −1 have no moduli and are refused; the gradient in ν is finite.
    """
    checks = []
    for nu in (0.45, 0.49, 0.499, 0.4999):
        body = cube(nu=nu)
        v = torch.zeros_like(body.x)
        v[:, 0] = torch.sin(30.0 * (body.x[:, 2] - 0.387))  # divergence-free
        states, reports = film(s, body, 400.0, 1, velocity=v)
        J = float((det(states[-1].F) * body.vol).sum() / body.vol.sum())
        M = 1e5 * (1 - nu) / ((1 + nu) * (1 - 2 * nu))
        checks.append(at_most(f"|volume after/before − 1|, ν = {nu}", abs(J - 1), 1e-2))
        checks.append(near(f"c/√(M/ρ), ν = {nu}", reports[0].wave / math.sqrt(M / 1000.0), 1.0, 1e-9))
    for nu in (0.5, 0.7, -1.0):
        checks.append(yes(f"ν = {nu} refused", refused(lambda n=nu: film(s, cube(nu=n), 400.0, 1), words=("nu",))))
    body = cube(nu=0.4999)
    leaf = body.field.theta["nu"].clone().requires_grad_()
    field = dataclasses.replace(body.field, theta=body.field.theta | {"nu": leaf})
    scene = dataclasses.replace(s.scene(dx=DX), fps=2000.0)
    *_, end = simulate(scene, body.x, body.vol, field, frames=1, grad=True, velocity=0.3 * torch.sin(9.0 * body.x))
    (bar_,) = torch.autograd.grad(end.x.square().sum(), leaf)
    return [*checks, yes("gradient in ν finite at 0.4999", bool(torch.isfinite(bar_).all()))]


@case("D5", "Bodies thrown at their centre", schemes=("default",))
def squeezed(s: Setting) -> list[Check]:
    """v = −40 (x − x_m)/s, a kinetic energy of about E V: −ln J is a barrier, J > 0 with neo-Hookean and Hencky laws in
    as many substeps as it takes; fixed corotated has none, and then stays upright or is refused with the particle
    named."""
    checks = []
    for law in ("neo_hookean", "hencky", "fixed_corotated"):
        body = cube(E=1e4, elastic=law)
        v = -40.0 * (body.x - body.x.mean(0))
        try:
            J = torch.stack([det(a.F) for a in film(s, body, 400.0, 6, velocity=v)[0]])
        except SimulationDiverged as error:
            checks.append(yes(f"{law}: refused, particle named", law == "fixed_corotated" and "particle" in str(error)))
            continue
        checks.append(within(f"{law}: smallest J", float(J.min()), 1e-6, 0.75))
    return checks


UNITS = {"length 2⁻¹⁰": (2**-10, 1, 1), "length 2⁷": (2**7, 1, 1), "mass 2²⁰": (1, 2**20, 1), "time 2⁻⁶": (1, 1, 2**-6)}


def in_units(s: Setting, body: Body, L: float, M: float, T: float, wall: bool) -> State:
    """A cube in other units, after some 40 substeps."""
    theta = {"yield_stress": 200.0 * M / (L * T * T)} if body.plastic == "von_mises" else {}
    made = dataclasses.replace(
        body, x=body.x * L, vol=body.vol * L**3, E=body.E * M / (L * T * T), rho=body.rho * M / L**3, theta=theta
    )
    walls = (HalfSpace(point=(0.0, 0.0, 0.33 * L), friction=0.3),) if wall else ()
    v = 0.3 * torch.sin(9.0 * body.x) * (L / T)
    options = {"dx": DX * L, "gravity": (0.0, 0.0, -8.0 * L / T**2), "boundaries": walls, "velocity": v}
    return film(s, made, 64.0 / T, 2, **options)[0][-1]


@case("D7", "Units", schemes=("default",))
def units(s: Setting) -> list[Check]:
    """Lengths, masses and times in other units, by powers of two: x/L, v T/L and F are the same to the last bit. An
    absolute ε in a mass, a norm or a stretch is seen.

    [E] = M/(L T²), [ρ] = M/L³, [g] = L/T².
    """
    bodies = {
        "float64, elastic, wall": (cube(), True),
        "float32, elastic": (cube(torch.float32), False),
        "float64, von Mises": (cube(elastic="hencky", plastic="von_mises"), False),
    }
    checks = []
    for name, (body, wall) in bodies.items():
        one = in_units(s, body, 1, 1, 1, wall)
        for what, (L, M, T) in UNITS.items():
            other = in_units(s, body, L, M, T, wall)
            same = torch.equal(other.x / L, one.x) and torch.equal(other.v * T / L, one.v)
            checks.append(yes(f"{what}, {name}: the same bits", same and torch.equal(other.F, one.F)))
    return checks


@case("D7b", "Light beside heavy", schemes=("default",))
def contrast(s: Setting) -> list[Check]:
    """1 : 1000 in density: Σ m v stays, and a light cube hit at v by a heavy one flies off with at most 2 v."""
    one = block((2, 2, 2), DX)
    x = torch.cat([one.x, one.x + one.x.new_tensor([3.5 * DX, 0.0, 0.0])])
    body, n = Body(x, torch.cat([one.vol, one.vol])), len(one.x)
    light = torch.where(torch.arange(2 * n) < n, 1.0, 1e-3).double()
    field = body.field
    field = dataclasses.replace(field, rho=field.rho * light, theta=field.theta | {"E": field.theta["E"] * light})
    v = torch.zeros_like(x)
    v[:n, 0] = 2.0
    scene = dataclasses.replace(s.scene(dx=DX), fps=50.0)
    states = list(simulate(scene, x, body.vol, field, frames=3, velocity=v))
    m = (field.rho * body.vol)[:, None]
    P = [(m * a.v).sum(0) for a in states]
    fast = float(states[-1].v[n:].mean(0)[0])
    return [
        at_most("|ΔΣ m v|/|Σ m v|", float((P[-1] - P[0]).norm() / P[0].norm()), 1e-10),
        within("speed of the light cube over v", fast / 2.0, 0.5, 2.0),
    ]


@case("D7c", "Far from the origin", schemes=("default",))
def far(s: Setting) -> list[Check]:
    """At x = 1e3 and 1e4 m in float32 places round to ε|x|/2: so do weights, in Δx, and nothing else.

    Eight such errors: stress is a difference of weights.
    """
    body = cube(torch.float32)
    kick = 0.3 * torch.sin(9.0 * body.x)
    checks = []
    ends = {}
    for place in (0.0, 1e3, 1e4):
        there = dataclasses.replace(body, x=body.x + body.x.new_tensor([place, 0.0, 0.0]))
        ends[place] = film(s, there, 50.0, 2, velocity=kick)[0][-1].v
    for place in (1e3, 1e4):
        change = float((ends[place] - ends[0.0]).norm() / ends[0.0].norm())
        checks.append(at_most(f"relative change of v at {place:g} m", change, 8 * 2.0**-24 * place / DX))
    return checks


@case("D13", "Impacts near the speed of sound", schemes=("default",))
def impacts(s: Setting) -> list[Check]:
    """A cube of v = 0.9 c against a wall, two cubes of ±0.45 c head on: J > 0, energy does not grow, restitution below
    1, Σ m v as before.

    The scheme keeps energy to second order in Δt: a per cent through a shock at CFL 0.4.
    """
    body = cube(E=1e4)
    wall = HalfSpace(point=(0.0, 0.0, 0.32), friction=0.3)
    v = 0.9 * body.c
    states, reports = film(s, body, 200.0, 12, boundaries=(wall,), velocity=(0.0, 0.0, -v), diagnose=True)
    first = 0.5 * float(body.m.sum()) * v * v
    most = max(r.balance.end.kinetic + r.balance.end.elastic for r in reports)  # type: ignore[union-attr]
    checks = [
        within("wall: smallest J", min(float(det(a.F).min()) for a in states), 1e-6, 0.95),
        at_most("wall: largest energy over that at first", most / first, 1.01),
        within("wall: restitution", float(states[-1].v[:, 2].mean()) / v, 0.0, 1.0),
        at_most("wall: largest CFL number", max(r.balance.courant for r in reports), 1.0),  # type: ignore[union-attr]
    ]
    one = block((2, 2, 2), DX)
    pair = Body(torch.cat([one.x, one.x + one.x.new_tensor([3.5 * DX, 0.0, 0.0])]), torch.cat([one.vol, one.vol]))
    way = torch.zeros_like(pair.x)
    way[:, 0] = torch.where(torch.arange(len(way)) < len(one.x), 0.45, -0.45) * pair.c
    states, _ = film(s, pair, 400.0, 4, velocity=way)
    scale = float(pair.m.sum()) * 0.45 * pair.c
    return [
        *checks,
        within("cubes: smallest J", min(float(det(a.F).min()) for a in states), 1e-6, 0.95),
        at_most("cubes: |Σ m v| over Σ m |v|", float(momentum(pair, states[-1]).norm()) / scale, 1e-10),
    ]


@case("D15", "A hundred thousand substeps", schemes=("default",), tier=1)
def endurance(s: Setting) -> list[Check]:
    """A vibrating cube in free flight over S = 1e5 substeps: Σ m v to 27 √S roundings, time to 1e-12.

    Each round sums over 27 nodes. Time is counted in double precision and not summed in that of the body.
    """
    checks = []
    for name, dtype in PRECISIONS.items():
        body = cube(dtype, cells=1)
        v = 1e-3 * torch.sin(9.0 * body.x) + body.x.new_tensor([1e-2, 0.0, 0.0])
        states, reports = film(s, body, 1.0, 90, velocity=v, dt=9e-4)
        P = [(body.m.double()[:, None] * a.v.double()).sum(0) for a in (states[0], states[-1])]
        S = sum(r.n_sub for r in reports)
        drift = float((P[1] - P[0]).norm() / P[0].norm())
        checks.append(at_most(f"|ΔΣ m v|/|Σ m v|, {name}", drift, 27 * math.sqrt(S) * torch.finfo(dtype).eps))
        checks.append(near(f"time after {S} substeps, {name}", states[-1].time, 90.0, 90e-12, "s"))
    return checks
