"""D1–D9: stiff, nearly incompressible, squeezed, inverted and far bodies: a finite answer that meets its check, or an
exception that names what is wrong."""

import dataclasses
import math

import torch
from torch import Tensor

from benchmarks.verification.bodies import Body, at_rest, block, crossings
from benchmarks.verification.case import Check, Setting, at_most, case, near, within
from benchmarks.verification.points import EYE, refused
from diffuphy.material import kirchhoff
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


def yes(what: str, truth: bool) -> Check:
    """1 if true."""
    return near(f"{what} (1: yes)", float(truth), 1.0, 0.0)


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
    """ρ g H/E = 1e-3, 1e-5, 1e-7 in float32: the strains of float64, and not those of a frozen body.

    What is stored is F − I and the displacement within a frame, so that rounding is relative to strains: 6e-8 √n of
    them in n = 300 substeps, times the 8 cells over which differences of momentum are taken. F itself, or x, would
    lose all digits at 1e-7.
    """
    checks = []
    for strain in (1e-3, 1e-5, 1e-7):
        E = 1000.0 * 9.81 / strain
        (T64, _, e64), (T32, _, e32) = (column(s, E, 9.81, d) for d in PRECISIONS.values())
        error = float((e32 - e64).square().mean().sqrt() / e64.square().mean().sqrt())
        checks.append(at_most(f"rms error of the strains over themselves at {strain:g}", error, 1e-3))
        checks.append(at_most(f"|change of the period| at {strain:g}", abs(T32 - T64), 1e-3))
    return checks


def cube(dtype: torch.dtype = torch.float64, cells: int = 2, **material: float | str) -> Body:
    """A small cube off the lattice."""
    return block((cells,) * 3, DX, (0.013, 0.021, 0.337), **material).to(dtype)  # type: ignore[arg-type]


@case("D3", "Time steps that are too long", schemes=("default",))
def unstable(s: Setting) -> list[Check]:
    """A pinned Δt of 2, 10, 100 times 0.8 Δx/(c + |v|) is refused before the first step, with the largest that would do;
    that one is stable.

    Energy of a vibrating cube after 200 such steps: not more than at first, by 1 % (Δt² errors at CFL 0.8).
    """
    body = cube()
    v = 0.3 * torch.sin(30.0 * body.x)
    limit = 0.8 * DX / (body.c + float(v.norm(dim=1).max()))
    checks = []
    for factor in (2.0, 10.0, 100.0):
        long = factor * limit * 1.001
        pinned = refused(lambda t=long: film(s, body, 1 / (400 * limit), 1, velocity=v, dt=t), words=("unstable", "use"))
        checks.append(yes(f"refused at {factor:g} times", bool(pinned)))
    states, reports = film(s, body, 1 / (50 * limit * 0.999), 4, velocity=v, dt=limit, diagnose=True)
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
        checks.append(yes(f"ν = {nu} refused", bool(refused(lambda n=nu: film(s, cube(nu=n), 400.0, 1), words=("nu",)))))
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


@case("D6", "Deformations that do not exist", schemes=("default",))
def inverted(s: Setting) -> list[Check]:
    """F = diag(1, 1, −½), 0 and NaN are no states of matter: refused, with particle and det F, under every law."""
    checks = []
    for law in ("neo_hookean", "fixed_corotated", "hencky"):
        body = cube(elastic=law)
        for what, value in {"diag(1, 1, −½)": (0.0, 0.0, -1.5), "0": (-1.0,) * 3, "NaN": (math.nan,) * 3}.items():
            start = at_rest(s, body)
            He = start.He.clone()
            He[5] = torch.diag(He.new_tensor(value))
            bad = dataclasses.replace(start, He=He)
            found = refused(lambda b=bad, y=body: film(s, y, 400.0, 1, state=b), ValueError, SimulationDiverged,
                            words=("particle 5",))  # fmt: skip
            checks.append(yes(f"{law}: F = {what} refused", bool(found)))
    return checks


@case("D6b", "Ill-conditioned deformations", schemes=("default",))
def conditioned(s: Setting) -> list[Check]:
    """τ = 2μ ln S of F = diag(1e3, 1, 1e-3) (ν = 0): ln S to 1e-9 in float64, turned or not, and to 1e-4 in float32.

    Turned, F rounds at 1e3 ε beside a stretch of 1e-3: 1e-10 in float64.
    """
    exact = torch.diag(torch.tensor([1e3, 1.0, 1e-3], dtype=torch.float64))
    R = torch.linalg.matrix_exp(torch.tensor([[0, -0.3, 0.2], [0.3, 0, -0.5], [-0.2, 0.5, 0]], dtype=torch.float64))
    strain = torch.diag(exact.diagonal().log())
    params = {"E": 1.0, "nu": 0.0}  # 2μ = 1
    checks = []
    for name, dtype in PRECISIONS.items():
        error = float((kirchhoff(exact.to(dtype), "hencky", params).double() - strain).abs().max() / strain.abs().max())
        checks.append(at_most(f"error of ln S, {name}", error, 1e-9 if dtype == torch.float64 else 1e-4))
    turned = kirchhoff(R @ exact @ R, "hencky", params) - R @ strain @ R.T
    return [*checks, at_most("error of ln S, turned, float64", float(turned.abs().max() / strain.abs().max()), 1e-9)]


@case("D6c", "Equal stretches", schemes=("default",))
def repeated(s: Setting) -> list[Check]:
    """F = I, R, 0.9 R, diag(1.1, 1.1, 0.9): τ is that of the principal stretches, and its derivative along random
    directions that of central differences.

    Step h = 1e-5: h² of the third derivative and ε/h of rounding, 1e-10 of E.
    """
    g = torch.Generator().manual_seed(1)
    R = torch.linalg.matrix_exp(torch.tensor([[0, -0.7, 0.2], [0.7, 0, -0.4], [-0.2, 0.4, 0]], dtype=torch.float64))
    Fs = {"I": EYE, "R": R, "0.9 R": 0.9 * R, "diag(1.1, 1.1, 0.9)": torch.diag(EYE.new_tensor([1.1, 1.1, 0.9]))}
    params = {"E": 1.0, "nu": 0.3}
    mu, lam = 1 / 2.6, 0.3 / (1.3 * 0.4)
    A, D = (torch.randn(3, 3, dtype=torch.float64, generator=g) for _ in range(2))
    checks = []
    for what, F in Fs.items():
        worst_value = worst_slope = 0.0
        for law in ("neo_hookean", "fixed_corotated", "hencky"):
            stretch = torch.linalg.svdvals(F)  # F = S R or diagonal: τ is diagonal in the axes of F Fᵀ
            J = stretch.prod()
            e = stretch.log()
            T = {
                "neo_hookean": mu * (stretch**2 - 1) + lam * J.log(),
                "fixed_corotated": 2 * mu * stretch * (stretch - 1) + lam * J * (J - 1),
                "hencky": 2 * mu * e + lam * J.log(),
            }[law]
            leaf = F.clone().requires_grad_()
            tau = kirchhoff(leaf, law, params)
            worst_value = max(worst_value, float((tau.detach() - torch.diag(T)).abs().max()))
            (bar_,) = torch.autograd.grad((tau * A).sum(), [leaf])
            h = 1e-5
            up, down = (float((kirchhoff(F + k * h * D, law, params) * A).sum()) for k in (1, -1))
            worst_slope = max(worst_slope, abs(float((bar_ * D).sum()) - (up - down) / (2 * h)))
        checks.append(at_most(f"F = {what}: |τ − exact|/E", worst_value, 1e-14))
        checks.append(at_most(f"F = {what}: |dτ − differences|/E", worst_slope, 1e-8))
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


@case("D8", "Particles that leave", schemes=("default",))
def leaving(s: Setting) -> list[Check]:
    """Out of the bounds: an exception that names the particle; or frozen, the mass unchanged; or removed, the mass
    announced. Places below 0 are places like others: ⌊x⌋, not the part before the point."""
    body = cube(cells=1)
    bounds = ((-1.0, -1.0, -1.0), (1.0, 1.0, 0.4))
    flight = {"velocity": (0.0, 0.0, 1.0), "bounds": bounds}
    named = refused(lambda: film(s, body, 50.0, 8, **flight), SimulationDiverged, words=("particle",))
    checks = [yes("an exception names the particle", bool(named))]
    for policy in ("freeze", "remove"):
        states, reports = film(s, body, 50.0, 8, leaving=policy, **flight)
        last = reports[-1]
        checks.append(near(f"{policy}: particles gone", last.gone, len(body.x), 0.0))
        exact = float(body.m.sum()) if policy == "remove" else 0.0
        checks.append(near(f"{policy}: mass announced", last.removed, exact, 1e-12 * float(body.m.sum()), "kg"))
    kick = 0.3 * torch.sin(9.0 * body.x)
    ends = []
    for place in (0.0, -8.0):
        there = dataclasses.replace(body, x=body.x + place * DX)
        ends.append(film(s, there, 50.0, 2, velocity=kick)[0][-1].v)
    return [*checks, at_most("|change of v| 8 Δx below 0", float((ends[1] - ends[0]).abs().max()), 2000 * 2.0**-52)]


@case("D9", "One particle, two in one place, none", schemes=("default",))
def few(s: Setting) -> list[Check]:
    """x = x0 + v0 t + g t²/2 of one particle, and of two in one place, which move as one; none is refused.

    Thirty substeps of sums of 27 weights: 200 ε.
    """
    g, v0, checks = (0.0, 0.0, -9.81), (0.3, -0.2, 0.5), []
    for copies in (1, 2):
        x = torch.tensor([[0.113, -0.021, 0.337]], dtype=torch.float64).repeat(copies, 1)
        body = Body(x, torch.full((copies,), 1e-5, dtype=torch.float64))
        end = film(s, body, 50.0, 2, gravity=g, velocity=v0)[0][-1]
        exact = x[0] + 0.04 * x.new_tensor(v0) + 0.5 * 0.04**2 * x.new_tensor(g)
        checks.append(at_most(f"|x − exact|, {copies}", float((end.x - exact).abs().max()), 200 * 2.0**-52, "m"))
        checks.append(yes(f"all at one place, {copies}", torch.equal(end.x[0], end.x[-1])))
    none = Body(torch.zeros(0, 3, dtype=torch.float64), torch.zeros(0, dtype=torch.float64))
    return [*checks, yes("none refused", bool(refused(lambda: film(s, none, 50.0, 1), words=("N > 0",))))]
