"""Branches in parallel to the elastic law, each with a deformation of its own that the solver carries.

**Maxwell.** A Hencky spring of modulus E_N in series with a dashpot; with the law beside it a standard linear solid.
The spring's own deformation F_N follows the flow like that of the particle, and relaxes:

    dev e_N' = dev e_N / (1 + Δt/t_N),   tr e_N' = tr e_N / (1 + β Δt/t_N)           (implicit: no bound on Δt)
    τ_N = 2μ_N e_N' + λ_N tr e_N' I,     Fe_N = U exp(e_N') Vᵀ

μ_N, λ_N from E_N and the particle's ν; t_N = ``relaxation_time``; β = ``bulk_relaxation``: 0 keeps the volume stiff
for good, 1 lets all of the strain relax alike, which in a bar is σ = E ε + E_N ε_N to first order.
Reese & Govindjee, Int. J. Solids Struct. 35 (1998), with a linear dashpot in Hencky strain.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import warp as wp
from torch import Tensor

from . import moduli, principal
from .elastic import hencky
from .expert import Layout, Param
from .sums import ElasticSum, PlasticSum, sum_elastic

E_N = Param("E_N", "Pa", 1e2, 1e7, log=True, default=1e5)
RELAXATION_TIME = Param("relaxation_time", "s", 1e-3, 1e2, log=True, default=1e-1)
BULK_RELAXATION = Param("bulk_relaxation", "-", 0.0, 1.0, log=False, default=0.0)


@dataclass(frozen=True)
class BranchFunctions:
    """Warp functions of one branch; F_N, H_N = F_N − I: its trial deformation."""

    stress: Any
    """(F_N, H_N, θ, dt) → (τ_N [Pa], Fe_N − F_N)."""
    stress_adjoint: Any
    """(F_N, H_N, θ, dt, τ̄, F̄e_N) → (F̄_N, θ̄)."""
    energy: Any
    """(Fe_N, He_N, θ) → ψ_N [Pa]."""
    stiffness: Any
    """θ → ρ_0 c² [Pa] of the branch at rest."""


@dataclass(frozen=True)
class Branch:
    """A stress in parallel to that of the elastic laws, with a deformation of its own."""

    name: str
    """Key in ``BRANCHES`` and in ``MaterialField.branches``."""
    params: tuple[Param, ...]
    """Parameters it reads."""
    build: Callable[[Layout], BranchFunctions]
    """Warp functions for one layout."""
    stiffness: Callable[[dict[str, Tensor]], Tensor]
    """Torch: θ by name → ρ_0 c² [Pa] at rest; adds to that of the elastic laws."""


def build_maxwell(layout: Layout) -> BranchFunctions:
    """Warp functions for one layout."""
    real, mat33, theta_t, memory_t = layout.real, layout.mat33, layout.theta_t, layout.memory_t
    own = layout.renamed(E="E_N")
    at_time, at_beta = layout.at("relaxation_time"), layout.at("bulk_relaxation")
    w_t = wp.types.vector(1, real)
    m = moduli.build(own)

    @wp.func(module="unique")
    def flow(n: real, tr: real, w: w_t, theta: theta_t, dt: real, h: memory_t):
        slow = theta[at_beta] * dt
        return dt / (theta[at_time] + dt), -(tr / real(3.0)) * slow / (theta[at_time] + slow)

    @wp.func(module="unique")
    def flow_adjoint(n: real, tr: real, w: w_t, theta: theta_t, dt: real, a_bar: real, b_bar: real, h: memory_t):
        t, slow = theta[at_time], theta[at_beta] * dt
        d = real(1.0) / (t + slow)
        theta_bar = theta_t()
        y = b_bar * tr / real(3.0) * d * d
        theta_bar[at_time] = y * slow - a_bar * dt / ((t + dt) * (t + dt))
        theta_bar[at_beta] = -y * t * dt
        return real(0.0), -b_bar / real(3.0) * slow * d, w_t(), theta_bar, memory_t()

    total: ElasticSum = sum_elastic(own, (hencky.build(own),), w_t)
    stress_w, adjoint_w, _, _ = principal.elastoplastic(own, total, PlasticSum(flow, flow_adjoint), w_t, w_t)
    energy_w = principal.energy(own, total, w_t)

    @wp.func(module="unique")
    def branch_stress(F_N: mat33, H_N: mat33, theta: theta_t, dt: real):
        tau, flow_N = stress_w(F_N, H_N, w_t(), w_t(), theta, dt)
        return tau, flow_N

    @wp.func(module="unique")
    def branch_stress_adjoint(F_N: mat33, H_N: mat33, theta: theta_t, dt: real, tau_bar: mat33, Fe_bar: mat33):
        F_bar, _w_e, _w_p, theta_bar = adjoint_w(F_N, H_N, w_t(), w_t(), theta, dt, tau_bar, Fe_bar)
        return F_bar, theta_bar

    @wp.func(module="unique")
    def branch_energy(Fe_N: mat33, He_N: mat33, theta: theta_t) -> real:
        return energy_w(Fe_N, He_N, w_t(), theta)

    @wp.func(module="unique")
    def stiffness(theta: theta_t) -> real:
        mu, lam = m.lame(theta)
        return lam + real(2.0) * mu

    return BranchFunctions(branch_stress, branch_stress_adjoint, branch_energy, stiffness)


def maxwell_stiffness(params: dict[str, Tensor]) -> Tensor:
    """λ_N + 2μ_N [Pa]."""
    mu, lam = moduli.lame({"E": params["E_N"], "nu": params["nu"]})
    return lam + 2 * mu


BRANCHES: dict[str, Branch] = {
    "maxwell": Branch("maxwell", (E_N, moduli.NU, RELAXATION_TIME, BULK_RELAXATION), build_maxwell, maxwell_stiffness)
}
"""Viscous branches, by name."""
