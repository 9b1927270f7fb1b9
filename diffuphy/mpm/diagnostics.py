"""What a simulation must conserve, measured on a state."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import torch
import warp as wp
from torch import Tensor

from diffuphy.compiling import LOCK
from diffuphy.mpm.scheme import Scheme
from diffuphy.mpm.state import REAL, Matter, State, view
from diffuphy.mpm.substep.spline import make_spline


@dataclass(frozen=True)
class Diagnostics:
    """Sums over the particles of one state."""

    mass: float
    """Σ m [kg]."""
    momentum: Tensor
    """Σ m v, shape (3,) [kg m/s]."""
    angular_momentum: Tensor
    """About the origin, Σ m (x × v + D ε:C) with D = Δx²/4, shape (3,) [kg m²/s]: what the affine transfer
    conserves."""
    kinetic: float
    """Σ m (|v|² + D |C|²) / 2 [J]."""
    elastic: float
    """Σ V ψ(Fe) [J]."""
    J: tuple[float, float]
    """Smallest and largest det F."""


def diagnose(mixture: Any, state: State, matter: Matter, dx: float, scheme: Scheme = Scheme()) -> Diagnostics:  # noqa: B008
    """Mass, momenta, energies and volume change of a state on a grid of spacing ``dx`` (Jiang et al. 2015 for the
    spin of C)."""
    x, v, C, m = (t.detach() for t in (state.x, state.v, state.C, matter.m))
    D = scheme.inertia * dx * dx
    spin = torch.stack([C[:, 2, 1] - C[:, 1, 2], C[:, 0, 2] - C[:, 2, 0], C[:, 1, 0] - C[:, 0, 1]], 1)
    angular = (m[:, None] * (torch.linalg.cross(x, v) + D * spin)).sum(0)
    kinetic = 0.5 * (m * ((v * v).sum(1) + D * (C * C).sum((1, 2)))).sum()
    det = torch.linalg.det(state.F.detach())
    elastic = (matter.vol * _energy(mixture, state, matter)).sum()
    return Diagnostics(
        float(m.sum()),
        (m[:, None] * v).sum(0),
        angular,
        float(kinetic),
        float(elastic),
        (float(det.min()), float(det.max())),
    )


@dataclass(frozen=True)
class Balance:
    """The books of one frame."""

    end: Diagnostics
    """Sums over the particles at its end."""
    lost: float
    """Energy at the start, less that at the end, and the work of gravity in between [J]: dissipation in the body, at
    the walls and by the transfer, less what moving walls and drives put in. A body with a viscous branch: what the
    branch stores counts as lost."""
    courant: float
    """Largest Δt (c + |v|) / Δx of a particle at its end, c in the present stretch [-]."""


def balance(
    mixture: Any,
    before: State,
    after: State,
    matter: Matter,
    scheme: Scheme,
    gravity: tuple[float, float, float],
    dt: float,
    dx: float,
) -> Balance:
    """The books of the frame from ``before`` to ``after`` with substeps of ``dt``.

    lost = E_start − E_end + Σ m g · (x_end − x_start),   E = kinetic + elastic
    """
    start, end = (diagnose(mixture, s, matter, dx, scheme) for s in (before, after))
    m, g = matter.m.detach().double(), before.x.new_tensor(gravity).double()
    work = float(((after.x - before.x).detach().double() @ g * m).sum())
    lost = start.kinetic + start.elastic - end.kinetic - end.elastic + work
    pace = waves(mixture, after, matter) + after.v.detach().norm(dim=1)
    return Balance(end, lost, float(pace.max()) * dt / dx)


def waves(mixture: Any, state: State, matter: Matter) -> Tensor:
    """Fastest wave of each particle in its present state, shape (N,) [m/s]; see ``material.wave``. NaN where
    det F ≤ 0."""
    return (_evaluate(mixture, state, matter, "wave") * (matter.vol / matter.m).detach()).sqrt()


def _energy(mixture: Any, state: State, matter: Matter) -> Tensor:
    """ψ of each particle, shape (N,) [Pa]."""
    return _evaluate(mixture, state, matter, "energy")


def _evaluate(mixture: Any, state: State, matter: Matter, what: str) -> Tensor:
    wp.init()
    real = REAL[state.x.dtype]
    with LOCK:
        kernel = _make_evaluate(mixture, real, what)
    out = torch.empty_like(matter.m)
    arrays = (
        (state.He, mixture.mat33),
        (state.memory, mixture.memory_t),
        (matter.w_e, mixture.w_e_t),
        (matter.w_p, mixture.w_p_t),
        (matter.theta, mixture.theta_t),
        (out, real),
    )
    inputs = [view(None if t is None else t.contiguous(), d, out.device) for t, d in arrays]
    with LOCK:
        wp.launch(kernel, dim=len(out), inputs=inputs, device=str(out.device))
    return out


@lru_cache
def _make_evaluate(mixture: Any, real: type, what: str) -> Any:
    """A kernel of one scalar function of the elastic deformation after what flows in no time has flowed."""
    mat33, w_e_t, w_p_t, theta_t = mixture.mat33, mixture.w_e_t, mixture.w_p_t, mixture.theta_t
    memory, memory_t, plastic = len(mixture.memory) > 0, mixture.memory_t, mixture.is_plastic
    stress, scalar, eye = mixture.stress, getattr(mixture, what), make_spline(real).eye

    @wp.kernel(module="unique", enable_backward=False)
    def evaluate(
        He: wp.array[mat33],
        memory_in: wp.array[memory_t],
        w_e: wp.array[w_e_t],
        w_p: wp.array[w_p_t],
        theta: wp.array[theta_t],
        out: wp.array[real],
    ):
        p = wp.tid()
        H = He[p]
        if wp.static(memory):
            _tau, flow, _h = stress(eye() + H, H, w_e[p], w_p[p], theta[p], real(0.0), memory_in[p])
            H += flow
        elif wp.static(plastic):
            _tau, flow = stress(eye() + H, H, w_e[p], w_p[p], theta[p], real(0.0))
            H += flow
        out[p] = scalar(eye() + H, H, w_e[p], theta[p])

    return evaluate
