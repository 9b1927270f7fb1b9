"""C4–C6, C9: the laws of flow at a point, whose answers are closed forms, and mixtures of them."""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from benchmarks.verification.bodies import Body, at_rest, run
from benchmarks.verification.case import SETTINGS, Check, Setting, at_least, at_most, case, near, within
from benchmarks.verification.laws import deformations, isolated, random_rotations, relative, stress
from benchmarks.verification.waves import bar, mode, released
from diffuphy.material import energy, kirchhoff, rate_gate, remember, return_map
from diffuphy.material.plastic.drucker_prager import LATCH
from diffuphy.types import MaterialField, SimulationDiverged

E, NU = 1e5, 0.3
MU = E / (2 * (1 + NU))
SOLID = {"E": E, "nu": NU}
BOTH = (torch.float64, torch.float32)
EYE = torch.eye(3, dtype=torch.float64)


def norm(a: Tensor) -> Tensor:
    """|a| of matrices."""
    return a.norm(dim=(-2, -1))


def dev(a: Tensor) -> Tensor:
    return a - a.diagonal(dim1=-2, dim2=-1).mean(-1)[..., None, None] * torch.eye(3, dtype=a.dtype)


def refused(what: Callable[[], object], words: tuple[str, ...]) -> bool:
    """Whether ``what`` raises ``ValueError`` or ``SimulationDiverged`` with all ``words`` in its message."""
    try:
        what()
    except (ValueError, SimulationDiverged) as error:
        return all(w in str(error) for w in words)
    return False


def yes(what: str, truth: bool) -> Check:
    """1 if true."""
    return near(f"{what} (1: yes)", float(truth), 1.0, 0.0)


def sheared(
    law: str, theta: dict[str, float], rate: float, dt: float, steps: int
) -> tuple[Tensor, Tensor, list[float]]:
    """τ [Pa] and Fe after steady simple shear, F ← (I + Δt L) F, L12 = ``rate`` [1/s], and the energy that each step
    sheds by flow [Pa]."""
    params = SOLID | theta
    step = EYE.clone()
    step[0, 1] = rate * dt
    Fe, shed = EYE[None], []
    for _ in range(steps):
        trial = step @ Fe
        Fe = return_map(trial, law, params, dt)
        shed.append(float(energy(trial, "hencky", SOLID) - energy(Fe, "hencky", SOLID)))
    return kirchhoff(Fe, "hencky", SOLID)[0], Fe[0], shed


def pulled(law: str, theta: dict[str, float], strain: float, steps: int, dtype: torch.dtype) -> float:
    """τ11 − τ22 [Pa] after F = diag(a, a^−½, a^−½), ln a = ``strain``, in equal steps."""
    e = strain / steps
    step = torch.diag(torch.tensor([math.exp(e), math.exp(-e / 2), math.exp(-e / 2)], dtype=dtype))
    F = torch.eye(3, dtype=dtype)[None]
    memory: dict[str, Tensor] = {}
    for _ in range(steps):
        trial = step @ F
        F = return_map(trial, law, SOLID | theta, memory=memory)
        memory = remember(trial, law, SOLID | theta, memory=memory)
    tau = kirchhoff(F, "hencky", SOLID)[0]
    return float(tau[0, 0] - tau[1, 1])


@case("C4", "Von Mises flow at a point", schemes=("default",))
def von_mises(s: Setting) -> list[Check]:
    """Simple shear: τ12 = σ_Y/√3 (1 − O((σ_Y/μ)²)), det Fe = 1; uniaxial stretch: τ11 − τ22 = σ_Y; M(M(F)) = M(F);
    no step of flow gives energy.

    |dev τ| = √(2/3) σ_Y, so that σ_Y/√3 is never exceeded (with √(2/3) left out it is σ_Y/√2). In float32 F knows
    strains to 6e-8, of the elastic strain σ_Y/3μ. In a step energy is shed at the mean of the stress before and after
    flow, which lies at most μ γ̇ Δt/2 above the latter.
    """
    yields, dt = 1e3, 1e-3
    tau, Fe, shed = sheared("von_mises", {"yield_stress": yields}, 1.0, dt, 400)
    tau12 = float(tau[0, 1])
    F = deformations(200, torch.Generator().manual_seed(1))
    once = return_map(F, "von_mises", SOLID | {"yield_stress": yields})
    twice = return_map(once, "von_mises", SOLID | {"yield_stress": yields})
    tiny, bent = 2e-6 * MU, F[75:]  # those before are rotations or balls, or nearly
    after = kirchhoff(return_map(bent, "von_mises", SOLID | {"yield_stress": tiny}), "hencky", SOLID)
    checks = [
        within("τ12 √3/σ_Y in steady shear", tau12 * math.sqrt(3) / yields, 1 - (yields / MU) ** 2, 1 + 1e-12, 1.0),
        at_most("|ln det Fe| after 400 steps", abs(float(torch.linalg.det(Fe).log())), 1e-12),
        at_most("|M(M(F)) − M(F)|", float(norm(twice - once).max()), 1e-13),
        at_most("σ_Y/2μ = 1e-6: ||dev τ|/(√(2/3) σ_Y) − 1|", off(norm(dev(after)), math.sqrt(2 / 3) * tiny), 1e-8),
        at_least("energy shed in a step, smallest over γ̇ Δt σ_Y", min(shed) / (dt * yields), 0.0),
        within("energy shed over work, steady", shed[-1] / (tau12 * dt), 1.0, 1 + MU * dt / tau12, 1.0),
    ]
    for dtype in BOTH:
        rounding = 16 * torch.finfo(dtype).eps * 3 * MU / yields
        plateau = pulled("von_mises", {"yield_stress": yields}, 0.1, 20, dtype) / yields
        checks.append(near(f"plateau of uniaxial stretch over σ_Y, {str(dtype)[6:]}", plateau, 1.0, rounding))
    return checks


def off(found: Tensor, exact: float) -> float:
    """Largest relative error."""
    return float((found / exact - 1).abs().max())


@case("C4b", "Hardening and softening at a point", schemes=("default",))
def hardening(s: Setting) -> list[Check]:
    """σ = σ_Y + H ε and 3μ (e − ε) = σ in uniaxial stretch: σ = 3μ (σ_Y + H e)/(3μ + H), in one step as in a hundred;
    H < 0 softens to r σ_Y.

    Closed forms at every step: only rounding of e, relative to σ_Y/3μ, is left.
    """
    yields, strain = 1e3, 0.1
    checks = []
    for H, residual in ((2e4, 0.0), (-5e3, 0.0), (-2e4, 0.4)):
        line = 3 * MU * (yields + H * strain) / (3 * MU + H)
        exact = max(line, residual * yields)
        theta = {"yield_stress": yields, "hardening": H, "residual": residual}
        for steps in (1, 100):
            found = pulled("von_mises_hardening", theta, strain, steps, torch.float64)
            checks.append(near(f"σ with H = {H:g} Pa, steps: {steps}", found, exact, 1e-10 * exact, "Pa"))
    return checks


@case("C5", "Bingham and Herschel–Bulkley flow at a point", schemes=("default",))
def viscous(s: Setting) -> list[Check]:
    """Steady simple shear: τ12 = σ_Y/√3 + η γ̇ and σ_Y/√3 + K γ̇^N, less O((τ/μ)²), whatever Δt.

    η is the shear viscosity (PAC-NeRF's parameter is 2η). Five rates over four decades. η = 0 is von Mises, σ_Y = 0 is
    Newton. Elastic strain τ/μ tilts the stress, by less than (τ/μ)² of it.
    """
    yields, eta, rate = 1e3, 25.0, 2.0
    exact = yields / math.sqrt(3) + eta * rate
    theta = {"yield_stress": yields, "viscosity": eta}
    found = {dt: float(sheared("viscoplastic", theta, rate, dt, round(0.1 / dt))[0][0, 1]) for dt in (1e-3, 1e-4)}
    checks = [
        within("τ12 at Δt = 1e-3 s", found[1e-3], exact * (1 - 2 * (exact / MU) ** 2), exact, exact, "Pa"),
        at_most("|τ12(1e-4 s)/τ12(1e-3 s) − 1|", abs(found[1e-4] / found[1e-3] - 1), 2e-4),
    ]
    plain = sheared("von_mises", {"yield_stress": yields}, rate, 1e-3, 100)[0]
    inviscid = sheared("viscoplastic", theta | {"viscosity": 0.0}, rate, 1e-3, 100)[0]
    checks.append(at_most("η = 0 against von Mises", float(norm(inviscid - plain)) / yields, 1e-13))
    newton = float(sheared("viscoplastic", {"yield_stress": 0.0, "viscosity": 300.0}, rate, 1e-3, 200)[0][0, 1])
    checks.append(near("σ_Y = 0: τ12/ηγ̇", newton / (300.0 * rate), 1.0, 2 * (300.0 * rate / MU) ** 2))
    K, N = 100.0, 0.5
    for g in (0.01, 0.1, 1.0, 10.0, 100.0):
        exact = yields / math.sqrt(3) + K * g**N
        theta = {"yield_stress": yields, "consistency": K, "flow_index": N}
        tau12 = float(sheared("herschel_bulkley", theta, g, 5e-4 / g, 300)[0][0, 1])
        checks.append(near(f"τ12/(σ_Y/√3 + K γ̇^½) at γ̇ = {g:g}/s", tau12 / exact, 1.0, 2 * (exact / MU) ** 2))
    return checks


@case("C6", "Drucker–Prager flow at a point", schemes=("default",))
def cone(s: Setting) -> list[Check]:
    """|dev τ|/p = M √(2/3), M = 6 sin φ/(3 − sin φ); in plane strain 3√2 tan φ/√(9 + 12 tan² φ). Pulled apart
    Fe = U Vᵀ. Pressed for the first time p = −χ κ ln J.

    F = e^−0.01 (1 + shear), φ = 30°; tension leaves no strain. At the apex, F = I, value and gradient are finite.
    """
    theta = SOLID | {"friction_angle": 30.0, "cohesion": 0.0}
    kappa = E / (3 * (1 - 2 * NU))
    tan, sin = math.tan(math.pi / 6), 0.5
    slopes = {
        "drucker_prager": 6 * sin / (3 - sin) * math.sqrt(2 / 3),
        "drucker_prager_plane_strain": 3 * math.sqrt(2) * tan / math.sqrt(9 + 12 * tan * tan),
    }
    F = math.exp(-0.01) * EYE[None].clone()
    step = EYE.clone()
    step[0, 1] = 2e-3
    checks = []
    for law, exact in slopes.items():
        Fe, memory = F, {"log_J": torch.full((1,), -0.03, dtype=torch.float64)}
        for _ in range(20):
            Fe = return_map(step @ Fe, law, theta, memory=memory)
        tau = kirchhoff(Fe, "hencky", SOLID)
        p = -float(tau[0].trace()) / 3
        what = law.replace("_", " ")
        checks += [
            near(f"|dev τ|/p, {what}", float(norm(dev(tau))[0]) / p, exact, 1e-12),
            near(f"p/(−χ κ ln J), {what}", p / (LATCH * kappa * 0.03), 1.0, 1e-12),
        ]
    g = torch.Generator().manual_seed(4)
    U, V = random_rotations(100, g), random_rotations(100, g)
    stretch = 1 + 0.2 * torch.rand(100, 3, dtype=torch.float64, generator=g)
    loose = return_map((U * stretch[:, None, :]) @ V.mT, "drucker_prager", theta)
    apex = EYE[None].clone().requires_grad_()
    out = return_map(apex, "drucker_prager", theta)
    (bar_,) = torch.autograd.grad((out * torch.randn(1, 3, 3, dtype=torch.float64, generator=g)).sum(), [apex])
    finite = bool(torch.isfinite(bar_).all()) and torch.equal(out.detach(), EYE[None])
    checks.append(at_most("|Fe − U Vᵀ| in tension", float(norm(loose - U @ V.mT).max()), 1e-13))
    return [*checks, yes("at F = I: unchanged, gradient finite", finite)]


@dataclass(frozen=True)
class Blend(Body):
    """A body of several laws."""

    laws_e: tuple[str, ...] = ("hencky",)
    w_e: tuple[float, ...] = (1.0,)
    """Elastic weights."""
    laws_p: tuple[str, ...] = ("identity",)
    w_p: tuple[float, ...] = (1.0,)
    """Plastic weights."""

    @property
    def field(self) -> MaterialField:
        one = torch.ones_like(self.vol)
        theta = {"E": self.E, "nu": self.nu, **self.theta}
        weights = (one[:, None] * one.new_tensor(w) for w in (self.w_e, self.w_p))
        return MaterialField(self.laws_e, self.laws_p, *weights, {k: v * one for k, v in theta.items()}, self.rho * one)


LAWS = ("neo_hookean", "fixed_corotated", "hencky")
YIELD = {"yield_stress": 1e3}


def blend(body: Body, **laws: tuple) -> Blend:
    return Blend(body.x, body.vol, body.E, body.nu, body.rho, theta=YIELD, **laws)


def gated(dt: float, w: float) -> float:
    """τ12 of Hencky with a share ``w`` of von Mises in steady shear, γ̇ = 1/s, the share meant per millisecond [Pa].

    One particle so heavy that its stress does not change its affine velocity.
    """
    body = isolated(1)
    body = dataclasses.replace(body, rho=1e15)
    laws = {"laws_p": ("identity", "von_mises"), "w_p": (1 - w, w)}
    C = torch.zeros(1, 3, 3, dtype=torch.float64)
    C[:, 0, 1] = 1.0
    plain, heavy = SETTINGS["mls"], blend(body, **laws)
    steps = round(0.12 / dt)
    end = run(plain, heavy, dt, steps, 1, scene={"dx": 1.0}, state=at_rest(plain, heavy, C=C), dt_ref=1e-3)[-1]
    (w_p,) = rate_gate(torch.tensor([[1 - w, w]], dtype=torch.float64), ("identity", "von_mises"), dt, 1e-3)
    light = blend(isolated(1), laws_p=laws["laws_p"], w_p=tuple(w_p.tolist()))
    return float(stress(light, end.He + EYE)[0, 0, 1])


@case("C9", "Mixtures of laws", schemes=("default",))
def mixtures(s: Setting) -> list[Check]:
    """One law with all the weight is that law; τ(QF) = Q τ(F) Qᵀ for partial weights; partial flow per unit of time
    does not depend on Δt.

    A share that is meant per millisecond acts as a rate: halving Δt changes the steady stress by a part of μ γ̇ Δt,
    1.3 % of σ_Y/√3 here.
    """
    g = torch.Generator().manual_seed(3)
    F, Q = deformations(100, g), random_rotations(100, g)
    Q[0] = torch.diag(torch.tensor([-1.0, -1.0, 1.0], dtype=torch.float64))
    body = isolated(100)
    both = ("identity", "von_mises")
    hencky = blend(body, laws_p=both, w_p=(0.0, 1.0))
    pure = blend(body, laws_p=("von_mises",))
    part = blend(body, laws_p=both, w_p=(0.7, 0.3))
    tau = stress(part, F)
    turned = relative(stress(part, Q @ F) - Q @ tau @ Q.mT, tau.norm(dim=(1, 2)) + body.E)
    checks = [
        near("w = (0, 1) equal to the law alone, to the bit (1: yes)",
             float(torch.equal(stress(hencky, F), stress(pure, F))), 1.0, 0.0),
        at_most("τ(QF) − Q τ(F) Qᵀ, w = (0.7, 0.3)", turned, 1e-12),
    ]  # fmt: skip
    for w in (0.1, 0.5, 0.9):
        whole, half = gated(2e-4, w), gated(1e-4, w)
        checks.append(at_most(f"|τ12(Δt/2)/τ12(Δt) − 1| in steady shear, w = {w}", abs(half / whole - 1), 0.01))
    bad = blend(body, laws_p=both, w_p=(math.nan, 1.0))
    refusal = refused(lambda: at_rest(s, bad), words=("w_p", "particle 0"))
    checks.append(yes("a weight that is no number is refused by name", refusal))
    return checks


@case("C9b", "Vibration of mixtures", schemes=("default",), tier=1)
def vibrating(s: Setting) -> list[Check]:
    """Elastic laws of the same E and ν vibrate alike: v(t) of the bar of B2, at strains of 1e-5, for any weights.

    Laws differ at second order in strain, 1e-5 of the period, and in rounding.
    """
    body = bar(8)
    histories = []
    for w in ((1.0, 0.0, 0.0), (0.2, 0.3, 0.5), (0.0, 0.0, 1.0)):
        states = released(s, blend(body, laws_e=LAWS, w_e=w), 0.3, 2)
        histories.append(torch.tensor(mode(body, states), dtype=torch.float64))
    return [at_most(f"largest change of v/V, weights {k}", float((h - histories[0]).abs().max()), 1e-4)
            for k, h in enumerate(histories[1:], 1)]  # fmt: skip
