"""What a simulation must conserve, measured on a state."""

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import torch
import warp as wp
from torch import Tensor

from diffuphy.mpm.kernels import cached, make_spline
from diffuphy.mpm.state import REAL, Matter, State


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


def diagnose(mixture: Any, state: State, matter: Matter, dx: float) -> Diagnostics:
    """Mass, momenta, energies and volume change of a state on a grid of spacing ``dx`` (Jiang et al. 2015 for the
    spin of C)."""
    x, v, C, m = (t.detach() for t in (state.x, state.v, state.C, matter.m))
    D = dx * dx / 4
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


def _energy(mixture: Any, state: State, matter: Matter) -> Tensor:
    """ψ of each particle, shape (N,) [Pa]."""
    wp.init()
    real = REAL[state.x.dtype]
    kernel = cached(_make_energy, mixture, real).energy
    psi = torch.empty_like(matter.m)
    arrays = (
        (state.He, mixture.mat33),
        (matter.m if state.log_J is None else state.log_J, real),  # read only with volumetric memory
        (matter.w_e, mixture.w_e_t),
        (matter.w_p, mixture.w_p_t),
        (matter.theta, mixture.theta_t),
        (psi, real),
    )
    inputs = [wp.from_torch(t.detach().contiguous(), dtype=d) for t, d in arrays]
    wp.launch(kernel, dim=len(psi), inputs=inputs, device=str(psi.device))
    return psi


def _make_energy(mixture: Any, real: type) -> SimpleNamespace:
    mat33, w_e_t, w_p_t, theta_t = mixture.mat33, mixture.w_e_t, mixture.w_p_t, mixture.theta_t
    memory = mixture.volumetric_memory
    stress, density, eye = mixture.stress, mixture.energy, make_spline(real).eye

    @wp.kernel(module="unique", enable_backward=False)
    def energy(
        He: wp.array[mat33],
        log_J: wp.array[real],
        w_e: wp.array[w_e_t],
        w_p: wp.array[w_p_t],
        theta: wp.array[theta_t],
        psi: wp.array[real],
    ):
        p = wp.tid()
        F = eye() + He[p]
        if wp.static(memory):  # in no time only what flows at once has flowed
            _tau, Fe = stress(F, w_e[p], w_p[p], theta[p], real(0.0), log_J[p])
        else:
            _tau, Fe = stress(F, w_e[p], w_p[p], theta[p], real(0.0))
        psi[p] = density(Fe, w_e[p], theta[p])

    return SimpleNamespace(energy=energy)
