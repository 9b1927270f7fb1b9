"""E1, E2, E4, E5, E10: the adjoint against differences, closed forms and itself."""

import dataclasses
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from benchmarks.verification.bodies import Body, at_rest, block, rotation
from benchmarks.verification.case import SETTINGS, Check, Setting, at_most, case, near
from benchmarks.verification.laws import LAWS, isolated
from diffuphy.material import ELASTIC, PLASTIC
from diffuphy.mpm import State, simulate

DX = 0.1
DT = 1e-3
"""CFL 0.13 at 12 m/s."""


@dataclass(frozen=True)
class Problem:
    """A few uneven particles, what to differentiate in, and one number to differentiate."""

    body: Body
    inputs: dict[str, Tensor]
    """State (x, v, C, He) and parameters of the material, by name."""
    weights: tuple[Tensor, Tensor, Tensor]
    """Of x, v and F in the number."""
    scene: dict[str, Any]

    def end(self, s: Setting, steps: int, inputs: dict[str, Tensor], frames: int = 1, **options: Any) -> State:
        """The state after ``steps`` substeps."""
        made = dataclasses.replace(s.scene(dx=DX, **self.scene), fps=frames / (DT * steps))
        parts = {k: t for k, t in inputs.items() if k in ("x", "v", "C", "He")}
        start = at_rest(s, self.body.to(inputs["x"].dtype), **parts)
        if start.H is not None:
            start = dataclasses.replace(start, H=start.He.clone())
        material = self.body.to(inputs["x"].dtype).field
        theta = material.theta | {k: t for k, t in inputs.items() if k in material.theta}
        material = dataclasses.replace(material, theta=theta, rho=inputs["rho"])
        vol = self.body.vol.to(inputs["x"])
        *_, last = simulate(made, inputs["x"], vol, material, frames=frames, dt=DT * (1 + 1e-9), state=start, **options)
        return last

    def number(self, state: State) -> Tensor:
        """Σ a·x + b·v + c:F with fixed random a, b, c."""
        a, b, c = (w.to(state.x) for w in self.weights)
        return (a * state.x).sum() + (b * state.v).sum() + (c * state.F).sum()

    def gradients(self, s: Setting, steps: int, names: tuple[str, ...] = (), **options: Any) -> dict[str, Tensor]:
        """Of the number with respect to ``names``, all inputs if empty."""
        names = names or tuple(self.inputs)
        leaves = {k: self.inputs[k].clone().requires_grad_() for k in names}
        found = self.number(self.end(s, steps, self.inputs | leaves, grad=True, **options))
        return dict(zip(leaves, torch.autograd.grad(found, list(leaves.values())), strict=True))

    def single(self) -> "Problem":
        """The same in float32."""
        inputs = {k: t.float() for k, t in self.inputs.items()}
        return dataclasses.replace(self, body=self.body.to(torch.float32), inputs=inputs)


def problem(elastic: str = "neo_hookean", plastic: str = "identity", seed: int = 1, **scene: Any) -> Problem:
    """4³ particles off the grid lines that move, spin and are strained by some per cent, with uneven material."""
    g = torch.Generator().manual_seed(seed)
    rand = lambda *n: torch.randn(*n, generator=g, dtype=torch.float64)  # noqa: E731
    box = block((2, 2, 2), DX, (0.17, 0.16, 0.113))
    theta = {"yield_stress": 300.0, "cohesion": 0.002, "viscosity": 5.0}
    body = dataclasses.replace(box, E=2e4, elastic=elastic, plastic=plastic, theta=theta)
    n = len(body.x)
    inputs = {
        "x": body.x + 0.003 * rand(n, 3),
        "v": 0.3 * rand(n, 3),
        "C": 2.0 * rand(n, 3, 3),
        "He": 0.02 * rand(n, 3, 3),
        "rho": body.rho * (1 + 0.1 * rand(n)),
    }
    read = dict.fromkeys(q.name for law in (ELASTIC[elastic], PLASTIC[plastic]) for q in law.params)
    inputs |= {k: body.field.theta[k] * (1 + 0.05 * rand(n)) for k in read}
    weights = (rand(n, 3) / DX, rand(n, 3) / body.c, rand(n, 3, 3))
    return Problem(body, inputs, weights, {"gravity": (0.0, 0.3, -9.81)} | scene)


def ladder(
    s: Setting, p: Problem, steps: int, names: tuple[str, ...] = (), rungs: range = range(2, 10)
) -> dict[str, float]:
    """Smallest error of central differences with h = 10^−rung of the size of each input, along a random direction,
    relative to the norm of the terms that are summed."""
    names = names or tuple(p.inputs)
    exact = p.gradients(s, steps, names)
    found = {}
    for name in names:
        t = p.inputs[name]
        delta = torch.randn(t.shape, generator=torch.Generator().manual_seed(4), dtype=t.dtype) * t.abs().mean()
        if name == "x":
            delta = delta / t.abs().mean() * DX
        terms = exact[name] * delta
        errors = []
        for h in (10.0**-k for k in rungs):
            up, down = (float(p.number(p.end(s, steps, p.inputs | {name: t + e * h * delta}))) for e in (1, -1))
            errors.append(abs((up - down) / (2 * h) - float(terms.sum())) / float(terms.norm()))
        found[name] = min(errors)
    return found


@case("E1", "Gradients against differences")
def differences(s: Setting) -> list[Check]:
    """∂(a·x + b·v + c:F)/∂(x0, v0, C0, F0, E, ν, ρ) against central differences, h = 1e-2 … 1e-9: 1e-6 after one
    substep, 1e-5 after 100; float32 within 1e-3 of float64.

    Truncation h² meets rounding 1e-16/h near h = 1e-5: about 1e-10 of the terms, less what the dynamics amplify.
    """
    p = problem()
    checks = []
    for steps, limit in ((1, 1e-6), (100, 1e-5)):
        for name, error in ladder(s, p, steps).items():
            checks.append(at_most(f"{name}, {steps} substeps", error, limit))
    double, single = p.gradients(s, 100), p.single().gradients(s, 100)
    worst = max(float((single[k].double() - g).norm() / g.norm()) for k, g in double.items())
    return [*checks, at_most("float32 against float64, 100 substeps, worst input", worst, 1e-3)]


@case("E1b", "Gradients against differences: laws that flow, long runs", tier=1)
def differences_of_laws(s: Setting) -> list[Check]:
    """The same through return maps (yield stress, friction angle, cohesion, viscosity) and over 1000 substeps: 1e-4.

    A return map has kinks: a particle that yields between x − h and x + h leaves an error of order h; the smallest of
    the ladder has none.
    """
    checks = []
    for plastic in ("von_mises", "viscoplastic", "drucker_prager"):
        p = problem("hencky", plastic)
        for name, error in ladder(s, p, 30).items():
            checks.append(at_most(f"{plastic}: {name}, 30 substeps", error, 1e-5))
    for name, error in ladder(s, problem(), 1000, ("x", "v", "E"), range(4, 8)).items():
        checks.append(at_most(f"{name}, 1000 substeps", error, 1e-4))
    return checks


@case("E2", "Gradient of stress at equal stretches", schemes=("default",))
def repeated(s: Setting) -> list[Check]:
    """dτ = 2μ sym(HQᵀ) + λ tr(HQᵀ) I at every rotation Q, for every elastic law; at 0.9 I and diag(1.1, 1.1, 0.9)
    against differences of the exact values.

    Seen through particles alone, see A7. An adjoint that divides by the differences of stretches is 5 to 50 % off here.
    Fourth-order differences with h = 3e-4: truncation 1e-13, rounding 1e-12.
    """
    n, plain = 64, SETTINGS["mls"]
    g = torch.Generator().manual_seed(11)
    eye = torch.eye(3, dtype=torch.float64)
    W = torch.randn(n, 3, 3, dtype=torch.float64, generator=g)
    Q = torch.stack([rotation(tuple(torch.randn(3, generator=g).tolist()), 0.1 * k) for k in range(n)])
    Q[0] = eye
    checks = []
    for law in LAWS:
        body = isolated(n, elastic=law)
        lam, mu = body.lame
        sym = W + W.mT
        exact = (mu * sym + lam * W.diagonal(dim1=-2, dim2=-1).sum(-1)[:, None, None] * eye) @ Q
        found = stress_adjoint(plain, body, Q, W)
        checks.append(at_most(f"{law}: at rotations", _relative(found, exact), 1e-10))
        beside = (Q + 1e-6 * torch.randn(n, 3, 3, dtype=torch.float64, generator=g)).float()
        single = stress_adjoint(plain, body.to(torch.float32), beside, W.float()).double()
        double = stress_adjoint(plain, body, beside.double(), W.float().double())
        checks.append(at_most(f"{law}: 1e-6 beside rotations, float32", _relative(single, double), 1e-5))
        for stretch in ((0.9, 0.9, 0.9), (1.1, 1.1, 0.9)):
            F = Q @ torch.diag(eye.new_tensor(stretch))
            H = torch.randn(n, 3, 3, dtype=torch.float64, generator=g)
            found = (stress_adjoint(plain, body, F, W) * H).sum((1, 2))
            slope = (W * _slope(plain, body, F, H)).sum((1, 2))
            error = float((found - slope).abs().max() / slope.abs().max())
            checks.append(at_most(f"{law}: at diag{stretch}", error, 1e-10))
    return checks


def _relative(found: Tensor, exact: Tensor) -> float:
    return float(((found - exact).norm(dim=(1, 2)) / exact.norm(dim=(1, 2))).max())


def _state(s: Setting, body: Body, He: Tensor, grad: bool = False) -> Tensor:
    """τ of particles alone [Pa], see ``laws.stress``; differentiable in H = F − I."""
    dt = 1e-3
    scene = dataclasses.replace(s.scene(dx=1.0), fps=1.0 / dt)
    start = at_rest(s, body, He=He)
    *_, end = simulate(scene, body.x, body.vol, body.field, frames=1, dt=dt * (1 + 1e-9), state=start, grad=grad)
    return -end.C * body.rho / (4.0 * dt)


def stress_adjoint(s: Setting, body: Body, F: Tensor, W: Tensor) -> Tensor:
    """∂(W:τ)/∂F of particles alone, shape (N, 3, 3)."""
    He = (F - torch.eye(3, dtype=F.dtype)).requires_grad_()
    (found,) = torch.autograd.grad((W * _state(s, body, He, grad=True)).sum(), [He])
    return found


def _slope(s: Setting, body: Body, F: Tensor, H: Tensor) -> Tensor:
    """dτ/dF : H by differences of fourth order."""
    h, eye = 3e-4, torch.eye(3, dtype=F.dtype)
    at = [_state(s, body, F + k * h * H - eye) for k in (-2, -1, 1, 2)]
    return (at[0] - 8 * at[1] + 8 * at[2] - at[3]) / (12 * h)


@case("E4", "Dot-product test")
def dot_product(s: Setting) -> list[Check]:
    """⟨J u, w⟩ = ⟨u, Jᵀ w⟩ in all inputs at once: 1e-9 after one substep, 1e-7 after 100.

    J u by differences of fourth order at three sizes, the best of them: truncation h⁴ meets rounding 1e-16/h near
    h = 1e-3; a particle that passes the middle between nodes on the way, where the second derivative of its weights
    jumps, leaves an error of order h or h² and needs a smaller one.
    """
    p = problem(seed=6)
    g = torch.Generator().manual_seed(8)
    size = {k: DX if k == "x" else float(t.abs().mean()) for k, t in p.inputs.items()}
    u = {k: 0.1 * size[k] * torch.randn(t.shape, generator=g, dtype=t.dtype) for k, t in p.inputs.items()}
    checks = []
    for steps, limit in ((1, 1e-9), (100, 1e-7)):
        back = p.gradients(s, steps)
        terms = torch.cat([(back[k] * u[k]).flatten() for k in u])
        errors = []
        for h in (1e-3, 1e-4, 1e-5):
            moved = [{k: t + m * h * u[k] for k, t in p.inputs.items()} for m in (-2, -1, 1, 2)]
            at = [float(p.number(p.end(s, steps, inputs))) for inputs in moved]
            forward = (at[0] - 8 * at[1] + 8 * at[2] - at[3]) / (12 * h)
            errors.append(abs(forward - float(terms.sum())) / float(terms.norm()))
        checks.append(at_most(f"{steps} substeps", min(errors), limit))
    return checks


@case("E5", "Checkpoints do not change gradients")
def checkpoints(s: Setting) -> list[Check]:
    """Replaying 1, 7, 17, 32 or all substeps at a time, or storing them, gives the same bits; so does asking for one
    gradient alone."""
    p = problem()
    whole = p.gradients(s, 60, frames=2)
    checks = []
    ways: dict[str, dict[str, Any]] = {f"{k} at a time": {"segment": k} for k in (1, 7, 17, 32)} | {
        "kept": {"keep": True}
    }
    for what, options in ways.items():
        again = p.gradients(s, 60, frames=2, **options)
        same = all(torch.equal(whole[k], again[k]) for k in whole)
        checks.append(near(f"{what}: equal to the last bit (1: yes)", float(same), 1.0, 0.0))
    alone = all(torch.equal(p.gradients(s, 60, (k,), frames=2)[k], whole[k]) for k in ("v", "E", "rho"))
    return [*checks, near("one input alone: equal to the last bit (1: yes)", float(alone), 1.0, 0.0)]


@case("E10", "Gradients of a mirrored scene")
def mirrored(s: Setting) -> list[Check]:
    """∂/∂v0 and ∂/∂x0 of the mirrored scene are mirrored: 50 substeps, the same sums in another order."""
    p = problem(gravity=(0.5, 0.3, -9.81))
    here = p.gradients(s, 50, ("x", "v"))
    M = torch.diag(torch.tensor([-1.0, 1.0, 1.0], dtype=torch.float64))
    i = p.inputs
    inputs = i | {"x": i["x"] @ M, "v": i["v"] @ M, "C": M @ i["C"] @ M, "He": M @ i["He"] @ M}
    a, b, c = p.weights
    scene = p.scene | {"gravity": (-0.5, 0.3, -9.81)}
    q = dataclasses.replace(p, inputs=inputs, weights=(a @ M, b @ M, M @ c @ M), scene=scene)
    there = q.gradients(s, 50, ("x", "v"))
    return [
        at_most(f"∂/∂{k}0, relative", float((there[k] - g @ M).abs().max() / g.abs().max()), 1e-12)
        for k, g in here.items()
    ]
