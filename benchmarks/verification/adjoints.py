"""E3, E6–E9: gradients that are known exactly: those of what is conserved, of sliding, of flow, of a vibrating bar."""

import dataclasses
import math

import torch
from torch import Tensor

from benchmarks.verification.bodies import Body, angular_momentum, at_rest, block, momentum, skew
from benchmarks.verification.case import SETTINGS, Check, Setting, at_most, case, near, within
from benchmarks.verification.laws import isolated
from benchmarks.verification.waves import AMPLITUDE, SPEED, C, L, bar
from diffuphy.mpm import Controls, HalfSpace, State, simulate

DX = 0.05


NOTHING = Controls()


def flown(
    s: Setting,
    body: Body,
    leaves: dict[str, Tensor],
    dt: float,
    steps: int,
    frames: int = 1,
    controls: Controls = NOTHING,
    **scene: object,
) -> State:
    """The last state, after ``steps`` substeps in ``frames`` frames; ``leaves`` replace tensors of the start and
    parameters of the material."""
    made = dataclasses.replace(s.scene(**scene), fps=frames / (dt * steps))
    start = at_rest(s, body, **{k: t for k, t in leaves.items() if k in ("x", "v", "C", "He")})
    material = body.field
    theta = material.theta | {k: t for k, t in leaves.items() if k in material.theta}
    material = dataclasses.replace(material, theta=theta, rho=leaves.get("rho", material.rho))
    *_, end = simulate(
        made, body.x, body.vol, material, frames=frames, dt=dt * (1 + 1e-9), state=start, grad=True, controls=controls
    )
    return end


def vibrating(n: int = 2) -> tuple[Body, dict[str, Tensor]]:
    """A small body off the grid lines, strained and moving at random; leaves of its state and of E."""
    g = torch.Generator().manual_seed(2)
    rand = lambda *k: torch.randn(*k, dtype=torch.float64, generator=g)  # noqa: E731
    body = block((n, n, n), DX, (0.113, 0.021, 0.337))
    N = len(body.x)
    leaves = {
        "x": body.x.clone(),
        "v": 0.2 * rand(N, 3),
        "C": 2.0 * rand(N, 3, 3),
        "He": 0.02 * rand(N, 3, 3),
        "E": body.field.theta["E"].clone(),
    }
    return body, {k: t.requires_grad_() for k, t in leaves.items()}


@case("E3", "Adjoints of what is conserved")
def identities(s: Setting) -> list[Check]:
    """∂(P·a)/∂v0_p = m_p a, ∂P/∂(x0, C0, F0, E) = 0, ∂(P·a)/∂g = M t a; ∂(L·a)/∂v0_p = m_p a × x0_p,
    ∂(L·a)/∂C0_p = m_p D ε·a; ∂x̄ⁿ/∂v0_p = n Δt m_p/M: over 1000 substeps, to 1e-10.

    Exact and free of differences: a lost sum, a stale grid, a wrong replay do not pass. Zero means 1e-10 of the terms
    that cancel: m c/Δx of a position, m Δx of C, m c of F, m c/E of E.
    """
    body, leaves = vibrating()
    a = torch.tensor([0.3, -0.2, 0.9], dtype=torch.float64)
    dt, n = 0.3 * DX / body.c, 1000
    m, M = body.m[:, None], float(body.m.sum())
    leaves["g"] = torch.tensor([0.0, 0.3, -9.81], dtype=torch.float64, requires_grad=True)
    end = flown(s, body, leaves, dt, n, 20, Controls(gravity=leaves["g"]), dx=DX)
    found = torch.autograd.grad(momentum(body, end) @ a, list(leaves.values()), retain_graph=True)
    P = dict(zip(leaves, found, strict=True))
    (centre,) = torch.autograd.grad((m * end.x).sum(0) @ a / M, [leaves["v"]])
    scale = float(body.m[0])
    zero = {"x": scale * body.c / DX, "C": scale * DX, "He": scale * body.c, "E": scale * body.c / body.E}
    checks = [at_most("∂(P·a)/∂v0 − m a", worst(P["v"], (m * a).expand_as(P["v"])), 1e-10)]
    checks += [at_most(f"∂(P·a)/∂{k}0", float(P[k].abs().max()) / z, 1e-10) for k, z in zero.items()]
    checks.append(at_most("∂(P·a)/∂g − M t a", worst(P["g"], M * n * dt * a), 1e-10))
    checks.append(at_most("∂(x̄·a)/∂v0 − n Δt m a/M", worst(centre, (n * dt / M * m * a).expand_as(centre)), 1e-10))
    D = s.scheme.inertia * DX * DX
    spin = angular_momentum(body, flown(s, body, leaves, dt, n, 20, dx=DX), D) @ a
    v_bar, C_bar = torch.autograd.grad(spin, [leaves["v"], leaves["C"]])
    lever = m * torch.linalg.cross(a.expand_as(body.x), body.x)
    twist = D * m[:, :, None] * skew(a)  # a_i ε_ijk C_kj, and [a]×_kj = ε_ijk a_i
    checks.append(at_most("∂(L·a)/∂v0 − m a × x0", worst(v_bar, lever), 1e-10))
    return [*checks, at_most("∂(L·a)/∂C0 − m D ε·a", worst(C_bar, twist), 1e-10)]


def worst(found: Tensor, exact: Tensor) -> float:
    """Largest error over the largest exact number."""
    return float((found - exact).abs().max() / exact.abs().max())


def slid(s: Setting, angle: float, friction: Tensor, v0: Tensor, T: float) -> Tensor:
    """Mean distance along an incline that a block travels in T [m]."""
    dx, g = 0.04, 9.81
    body = block((4, 4, 4), dx, E=1e6)
    v = torch.zeros_like(body.x) + v0 * body.x.new_tensor([1.0, 0.0, 0.0])
    frames, dt = 4, 0.4 * dx / body.c
    steps = frames * math.ceil(T / dt / frames)
    scene = {
        "dx": dx,
        "gravity": (g * math.sin(angle), 0.0, -g * math.cos(angle)),
        "boundaries": (HalfSpace(friction=float(friction.detach())),),
    }
    end = flown(s, body, {"v": v}, T / steps, steps, frames, Controls(friction=friction[None]), **scene)
    return (end.x - body.x)[:, 0].mean()


@case("E6", "Gradients through contact", schemes=("default", "elastic", "mls", "apic"))
def contact(s: Setting) -> list[Check]:
    """d = v0 t + g (sin θ − μ cos θ) t²/2: ∂d/∂v0 = t, ∂d/∂μ = −g cos θ t²/2; both 0 while it sticks.

    θ = 35°, μ = 0.3, t = 0.2 s, to 3 % (the body is elastic and rings on the wall). A block that sticks gives way by
    its own shear, whose gradient is a small part of that of a free one; loaded suddenly it rings on the wall for about
    two periods 4H/c, in which it may be free to slide: |∂d/∂v0| ≤ 2·4H/c.
    """
    T, angle = 0.2, math.radians(35.0)
    ring = 2 * 4 * (4 * 0.04) / block((4, 4, 4), 0.04, E=1e6).c
    leaf = lambda value: torch.tensor(value, dtype=torch.float64, requires_grad=True)  # noqa: E731
    v0, mu = leaf(0.1), leaf(0.3)
    d = slid(s, angle, mu, v0, T)
    to_v, to_mu = torch.autograd.grad(d, [v0, mu])
    way = 0.1 * T + 9.81 * (math.sin(angle) - 0.3 * math.cos(angle)) * T * T / 2
    exact = -9.81 * math.cos(angle) * T * T / 2
    v_stick, mu_stick = leaf(0.0), leaf(0.6)
    stuck = torch.autograd.grad(slid(s, math.radians(20.0), mu_stick, v_stick, T), [v_stick, mu_stick])
    return [
        within("d", float(d.detach()), 0.97 * way, 1.03 * way, way, "m"),
        within("∂d/∂v0 over t", float(to_v) / T, 0.97, 1.03, 1.0),
        within("∂d/∂μ", float(to_mu), 1.03 * exact, 0.97 * exact, exact, "m"),
        at_most("|∂d/∂v0| over t while it sticks", abs(float(stuck[0])) / T, ring / T),
        at_most("|∂d/∂μ| over that of sliding while it sticks", abs(float(stuck[1]) / exact), 0.1),
    ]


@case("E6b", "Gradient through a bounce", tier=1)
def bounced(s: Setting) -> list[Check]:
    """∂v_out/∂v_in ≈ −e of a ball that leaves the floor, the gradient against the ratio of speeds.

    e changes slowly with speed, so that the derivative is −e within some per cent.
    """
    dx, speed = 0.025, 1.0
    box = block((8, 8, 8), dx, E=1e6)
    inside = (box.x - 0.1).norm(dim=1) < 0.1
    body = Body(box.x[inside] + box.x.new_tensor([0.0, 0.0, 1.5 * dx]), box.vol[inside], E=1e6)
    v = torch.tensor(-speed, dtype=torch.float64, requires_grad=True)
    dt = 0.3 * dx / body.c
    start = {"v": torch.zeros_like(body.x) + v * body.x.new_tensor([0.0, 0.0, 1.0])}
    end = flown(s, body, start, dt, 600, 8, dx=dx, boundaries=(HalfSpace(),))
    out = momentum(body, end)[2] / body.m.sum()
    (slope,) = torch.autograd.grad(out, [v])
    e = float(out.detach()) / speed
    return [
        within("coefficient of restitution", e, 0.85, 1.0),
        near("∂v_out/∂v_in", float(slope), -e, 0.1),
    ]


@case("E7", "Gradients through plastic flow", schemes=("default",))
def plastic(s: Setting) -> list[Check]:
    """On the yield surface |dev τ| = √(2/3) σ_Y: in pure shear τ12 = σ_Y/√3 and ∂τ12/∂σ_Y = 1/√3; below it exactly 0.
    Bingham, one implicit step from the trial s: s' = s − y μΔt/(μΔt + η), ∂s'/∂η = y μΔt/(μΔt + η)².

    Seen through particles alone (A7). A shear of 1 % turns the principal frame by half of that: 1e-4 of the stress.
    """
    plain, gamma, dt = SETTINGS["mls"], 0.01, 1e-3
    F = torch.eye(3, dtype=torch.float64).repeat(4, 1, 1)
    F[:, 0, 1] = gamma
    He = F - torch.eye(3, dtype=torch.float64)
    checks = []
    for what, yields, exact in (("flowing", 100.0, 1 / math.sqrt(3)), ("elastic", 1e4, 0.0)):
        body = isolated(4, elastic="hencky", plastic="von_mises", theta={"yield_stress": yields})  # type: ignore[arg-type]
        slope = _sheared(plain, body, He, "yield_stress")
        checks.append(near(f"∂τ12/∂σ_Y, {what}", slope, exact, 1e-3 * exact))
    eta, sigma = 20.0, 100.0
    theta = {"yield_stress": sigma, "viscosity": eta}
    body = isolated(4, elastic="hencky", plastic="viscoplastic", theta=theta)  # type: ignore[arg-type]
    mu = body.lame[1]
    y = mu * gamma - sigma / math.sqrt(3)  # overstress of τ12
    share = mu * dt / (mu * dt + eta)
    checks.append(
        near(
            "∂τ12/∂η",
            _sheared(plain, body, He, "viscosity"),
            y * share / (mu * dt + eta),
            1e-3 * y * share / (mu * dt + eta),
        )
    )
    exact = share / math.sqrt(3)
    return [*checks, near("∂τ12/∂σ_Y, viscous", _sheared(plain, body, He, "yield_stress"), exact, 1e-3 * exact)]


def _sheared(s: Setting, body: Body, He: Tensor, name: str) -> float:
    """∂τ12/∂(a parameter) of one particle alone."""
    dt = 1e-3
    leaf = body.field.theta[name].clone().requires_grad_()
    material = dataclasses.replace(body.field, theta=body.field.theta | {name: leaf})
    start = at_rest(s, body, He=He, H=He.clone())
    scene = dataclasses.replace(s.scene(dx=1.0), fps=1.0 / dt)
    *_, end = simulate(scene, body.x, body.vol, material, frames=1, dt=dt * (1 + 1e-9), state=start, grad=True)
    tau = -end.C * body.rho / (4.0 * dt)
    (bar_,) = torch.autograd.grad(tau[0, 0, 1], [leaf])
    return float(bar_[0])


@case("E8", "Stiffness from the motion of a bar")
def inversion(s: Setting) -> list[Check]:
    """u = (V/ω) sin ωt, ω = π c/L: d ln u/d ln E = (w cos w − sin w)/(2 sin w) with w = ωt; −0.1790 at w = 1.
    d ln u/d ln V = 1.

    An independent code is 1.3 % off with MLS at 16 cells, and 0.5 % with the improved transfer.
    """
    body = bar(16)
    dx, w = L / 16, 1.0
    T = w * L / (math.pi * C)
    steps = math.ceil(T / (0.4 * dx / C))
    shape = torch.cos(math.pi * body.x[:, 0] / L)
    log_V = torch.zeros((), dtype=torch.float64, requires_grad=True)
    E = body.field.theta["E"].clone().requires_grad_()
    v, grad = torch.zeros_like(body.x), torch.zeros(len(shape), 3, 3, dtype=body.x.dtype)
    v[:, 0], grad[:, 0, 0] = SPEED * shape, -SPEED * math.pi / L * torch.sin(math.pi * body.x[:, 0] / L)
    end = flown(s, body, {"v": log_V.exp() * v, "C": log_V.exp() * grad, "E": E}, T / steps, steps, dx=dx)
    u = ((end.x - body.x)[:, 0] * shape).sum() / (shape * shape).sum()
    E_bar, V_bar = torch.autograd.grad(u.log(), [E, log_V])
    exact = (w * math.cos(w) - math.sin(w)) / (2 * math.sin(w))
    off = 0.01 if s.improved else 0.03
    return [
        near("d ln u/d ln E", float((E_bar * E.detach()).sum()), exact, off * abs(exact)),
        near("d ln u/d ln V", float(V_bar), 1.0, 1e-6),
        near("u/(V/ω sin w)", float(u.detach()) / (AMPLITUDE * math.sin(w)), 1.0, 0.05),
    ]


def horizon(s: Setting, counts: tuple[int, ...]) -> list[float]:
    """|∂(a·x^N)/∂v0| for a random direction a, after N substeps of a vibrating cube in fall."""
    body, leaves = vibrating()
    a = torch.randn(len(body.x), 3, dtype=torch.float64, generator=torch.Generator().manual_seed(9))
    dt = 0.3 * DX / body.c
    found = []
    for n in counts:
        end = flown(s, body, leaves, dt, n, math.ceil(n / 50), dx=DX, gravity=(0.0, 0.0, -1.0))
        (bar_,) = torch.autograd.grad((a * end.x).sum(), [leaves["v"]])
        found.append(float(bar_.norm()) / dt)
    return found


@case("E9", "Gradients over a long horizon")
def long_horizon(s: Setting) -> list[Check]:
    """|∂x^N/∂v0| grows like N before contact, no faster: free flight gives N Δt, vibrations are bounded."""
    counts = (1, 10, 100, 1000)
    norms = horizon(s, counts)
    slope = math.log(norms[-1] / norms[-2]) / math.log(10.0)
    return [
        within("exponent of N between 100 and 1000 substeps", slope, 0.5, 1.2, 1.0),
        at_most(
            "|∂x^N/∂v0|/(N |∂x¹/∂v0|), largest", max(g / n for g, n in zip(norms, counts, strict=True)) / norms[0], 1.1
        ),
    ]


@case("E9b", "Gradients over 5000 substeps", tier=1)
def longest_horizon(s: Setting) -> list[Check]:
    """The same to N = 5000, through checkpoints of √N substeps."""
    norms = horizon(s, (1000, 5000))
    return [
        within(
            "exponent of N between 1000 and 5000 substeps", math.log(norms[1] / norms[0]) / math.log(5.0), 0.5, 1.2, 1.0
        )
    ]
