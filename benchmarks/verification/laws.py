"""A6, A7: stress seen through the solver: uniform, it accelerates nothing; everywhere it is the slope of an energy."""

import torch
from torch import Tensor

from benchmarks.verification.bodies import Body, at_rest, block, rotation, run, stored
from benchmarks.verification.case import SETTINGS, Check, Setting, at_most, case, within
from diffuphy.mpm import State

LAWS = ("neo_hookean", "fixed_corotated", "hencky")
GAP = 4
"""Cells between particles that share no node."""


def isolated(n: int, **material: float | str) -> Body:
    """n particles too far apart to feel each other, each elsewhere in its cell; Δx = 1 m."""
    side = 1
    while side**3 < n:
        side += 1
    x = GAP * torch.cartesian_prod(*[torch.arange(side, dtype=torch.float64)] * 3)[:n]
    x = x + torch.rand(n, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(3))
    return Body(x, torch.full((n,), 0.125, dtype=torch.float64), **material)  # type: ignore[arg-type]


def one_step(s: Setting, body: Body, dt: float, **tensors: Tensor) -> State:
    """A state after one substep on a grid of Δx = 1 m; ``tensors`` replace those of the start."""
    return run(s, body, dt, 1, 1, scene={"dx": 1.0}, state=at_rest(s, body, **tensors))[-1]


def stress(body: Body, F: Tensor) -> Tensor:
    """τ of isolated particles with deformation F [Pa], shape (N, 3, 3), as plain MLS-MPM applies it.

    At rest q_i = −Δt V (4/Δx²) τ w_i d_i and m_i = w_i m, so that C = −Δt V (4/Δx²) τ/m after one substep:
    Σ_i w_i d_i d_iᵀ = (Δx²/4) I.
    """
    dt = 1e-3  # gentle: |C| Δt ≪ 1 at 1e5 Pa and 1000 kg/m³
    end = one_step(SETTINGS["mls"], body, dt, He=F - torch.eye(3, dtype=F.dtype))
    return -end.C * body.rho / (4.0 * dt)


def random_rotations(n: int, generator: torch.Generator) -> Tensor:
    Q, R = torch.linalg.qr(torch.randn(n, 3, 3, dtype=torch.float64, generator=generator))
    Q = Q * R.diagonal(dim1=-2, dim2=-1).sign()[:, None, :]
    return Q * torch.linalg.det(Q)[:, None, None]


def deformations(n: int, generator: torch.Generator) -> Tensor:
    """U S Vᵀ with det in [0.2, 3]; some within 1e-8 of a rotation, some with two or three equal stretches."""
    U, V = (random_rotations(n, generator) for _ in range(2))
    s = torch.exp(0.35 * torch.randn(n, 3, dtype=torch.float64, generator=generator))
    J = 0.2 + 2.8 * torch.rand(n, dtype=torch.float64, generator=generator)
    s = s * (J / s.prod(1))[:, None] ** (1 / 3)
    k = n // 8
    s[:k] = 1 + 1e-8 * torch.randn(k, 3, dtype=torch.float64, generator=generator)
    s[k : 2 * k, 1] = s[k : 2 * k, 0]
    s[2 * k : 3 * k] = s[2 * k : 3 * k, :1]
    return (U * s[:, None, :]) @ V.mT


def derivative(body: Body, F: Tensor) -> Tensor:
    """(∂ψ/∂F) Fᵀ [Pa] of the textbook energy."""
    F = F.clone().requires_grad_()
    (P,) = torch.autograd.grad(stored(body, F).sum(), [F])
    return P @ F.detach().mT


def relative(error: Tensor, scale: Tensor) -> float:
    """Largest |error|/scale over the particles."""
    return float((error.norm(dim=(1, 2)) / scale).max())


@case("A7", "Stress and its energy", schemes=("default",))
def constitutive(s: Setting) -> list[Check]:
    """τ = (∂ψ/∂F) Fᵀ = τᵀ, τ(QF) = Q τ(F) Qᵀ, τ(FQ) = τ(F), τ(Q) = 0, dτ = 2μ sym(HQᵀ) + λ tr(HQᵀ) I at Q.

    2000 random F with det in [0.2, 3], near rotations and with equal stretches among them, each on a particle alone.
    The derivative of the textbook energy is taken by autograd. Rounding of F alone moves τ by 1e-16 E, so errors count
    in |τ| + E, but in |τ| for the linear response to H of size 1e-6, whose second order is some units of it.
    """
    generator = torch.Generator().manual_seed(7)
    n = 2000
    F = deformations(n, generator)
    Q, near_Q = random_rotations(n, generator), random_rotations(n, generator)
    H = 1e-6 * torch.randn(n, 3, 3, dtype=torch.float64, generator=generator)
    a = H @ near_Q.mT
    trace = a.diagonal(dim1=-2, dim2=-1).sum(-1)[:, None, None] * torch.eye(3, dtype=torch.float64)
    checks = []
    for law in LAWS:
        body = isolated(n, elastic=law)
        lam, mu = body.lame
        tau, linear = stress(body, F), mu * (a + a.mT) + lam * trace
        scale = tau.norm(dim=(1, 2)) + body.E
        response = relative(stress(body, near_Q + H) - linear, linear.norm(dim=(1, 2)))
        checks += [
            at_most(f"{law}: τ − (∂ψ/∂F) Fᵀ", relative(tau - derivative(body, F), scale), 1e-12),
            at_most(f"{law}: τ − τᵀ", relative(tau - tau.mT, scale), 1e-13),
            at_most(f"{law}: τ(QF) − Q τ(F) Qᵀ", relative(stress(body, Q @ F) - Q @ tau @ Q.mT, scale), 1e-12),
            at_most(f"{law}: τ(FQ) − τ(F)", relative(stress(body, F @ Q) - tau, scale), 1e-12),
            at_most(f"{law}: |τ(Q)|/E", float(stress(body, Q).abs().max()) / body.E, 1e-13),
            at_most(f"{law}: linear response at a rotation", response, 1e-4),
        ]
    return checks


@case("A7h", "Order of the update of F")
def composition(s: Setting) -> list[Check]:
    """F² = (I + Δt L2)(I + Δt L1): the later gradient on the left.

    A particle alone reproduces its own affine field exactly, and E is too small to matter. No other case sees
    F (I + Δt L).
    """
    generator = torch.Generator().manual_seed(5)
    body = isolated(200, E=1e-9)
    L1, L2 = (2.0 * torch.randn(200, 3, 3, dtype=torch.float64, generator=generator) for _ in range(2))
    eye, dt = torch.eye(3, dtype=torch.float64), 0.02
    middle = one_step(s, body, dt, C=L1)
    again = at_rest(s, body, x=middle.x, He=middle.He, C=L2)
    end = run(s, body, dt, 1, 1, scene={"dx": 1.0}, state=again)[-1]
    exact = (eye + dt * L2) @ (eye + dt * L1)
    swapped = (eye + dt * L1) @ (eye + dt * L2)
    return [
        at_most("max |F² − (I + Δt L2)(I + Δt L1)|", float((end.F - exact).abs().max()), 1e-14),
        within("the wrong order would differ by", float((swapped - exact).abs().max()), 1e-3, 1.0),
    ]


def acceleration(s: Setting, x: Tensor, F: Tensor, X: Tensor) -> float:
    """Largest |a| ρ Δx/|τ| of a block of 14³ cells under uniform F, where its faces at X = 0 and 0.7 are not felt."""
    dx, dt = 0.05, 1e-9  # so short that the second half of a kick does not see what the first moved
    body = Body(x, torch.full((len(x),), (dx / 2) ** 3, dtype=x.dtype))
    He = (F - torch.eye(3, dtype=x.dtype)).expand(len(x), 3, 3).contiguous()
    end = run(s, body, dt, 1, 1, scene={"dx": dx}, state=at_rest(s, body, He=He))[-1]
    # particle, node, its neighbour, particle: 4 or 5 cells along each axis, and 0.3 of that more for a sheared face
    reach = {2: 5.3, 3: 6.6}[s.scheme.order] * dx
    inside = ((X > reach) & (X < 0.7 - reach)).all(1)
    return float(end.v[inside].norm(dim=1).max()) / dt * body.rho * dx / float(derivative(body, F[None])[0].norm())


@case("A6", "Patch test")
def patch(s: Setting) -> list[Check]:
    """Uniform F, uniform τ: a = 0 inside a body. Exact for a lattice that fits the grid, whatever its phase and stress;
    else the quadrature error of one point a particle, |a| ρ Δx/|τ|.

    Stretched by 1.1 an independent code has 5e-2, with a quarter of random jitter 5e-2; twice that is accepted.
    """
    dx, eye = 0.05, torch.eye(3, dtype=torch.float64)
    X = block((14, 14, 14), dx).x
    generator = torch.Generator().manual_seed(2)
    sheared = eye.clone()
    sheared[0, 1] = 0.3
    skewed = rotation((1.0, 2.0, 0.5), 0.3) @ torch.diag(eye.new_tensor([1.1, 0.9, 1.05]))
    phase = X + X.new_tensor([0.3, 0.1, 0.7]) * dx
    jitter = X + 0.25 * dx / 2 * (2 * torch.rand(X.shape, generator=generator, dtype=X.dtype) - 1)
    return [
        at_most("regular lattice, any stress", acceleration(s, phase, skewed, X), 1e-12),
        at_most("lattice in simple shear", acceleration(s, X @ sheared.T, sheared, X), 1e-12),
        at_most("stretched by 1.1, incommensurate with the grid", acceleration(s, 1.1 * X, 1.1 * eye, X), 0.1),
        at_most("random jitter of a quarter of the spacing", acceleration(s, jitter, 1.1 * eye, X), 0.1),
    ]
