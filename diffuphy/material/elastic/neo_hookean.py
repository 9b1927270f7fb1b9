"""Compressible neo-Hookean solid: rubber, jelly.

    ψ = μ/2 (tr FᵀF − 3) − μ ln J + λ/2 (ln J)²
    T_i = μ (s_i² − 1) + λ ln J,   τ = μ (F Fᵀ − I) + λ ln J I

Bonet & Wood, Nonlinear Continuum Mechanics for Finite Element Analysis (2008), §6.4.3.
"""

import torch
import warp as wp
from torch import Tensor

from .. import moduli
from ..expert import Elastic, ElasticFunctions, Layout


def build(layout: Layout) -> ElasticFunctions:
    """Warp functions for one layout."""
    real, vec3, mat33, theta_t = layout.real, layout.vec3, layout.mat33, layout.theta_t
    m = moduli.build(layout)

    @wp.func(module="unique")
    def energy(s: vec3, e: vec3, theta: theta_t) -> real:
        mu, lam = m.lame(theta)
        log_J = e[0] + e[1] + e[2]
        return real(0.5) * mu * (wp.dot(s, s) - real(3.0)) - mu * log_J + real(0.5) * lam * log_J * log_J

    @wp.func(module="unique")
    def stress(s: vec3, e: vec3, theta: theta_t) -> vec3:
        mu, lam = m.lame(theta)
        p = lam * (e[0] + e[1] + e[2]) - mu
        return vec3(mu * s[0] * s[0] + p, mu * s[1] * s[1] + p, mu * s[2] * s[2] + p)

    @wp.func(module="unique")
    def stress_adjoint(s: vec3, e: vec3, theta: theta_t, T_bar: vec3):
        # ∂T_i/∂e_j = 2μ s_i² δ_ij + λ
        mu, lam = m.lame(theta)
        c = wp.cw_mul(s, s)
        t = T_bar[0] + T_bar[1] + T_bar[2]
        e_bar = real(2.0) * mu * wp.cw_mul(c, T_bar) + vec3(lam * t, lam * t, lam * t)
        return e_bar, m.adjoint(theta, wp.dot(c, T_bar) - t, t * (e[0] + e[1] + e[2]))

    @wp.func(module="unique")
    def slope(s: vec3, e: vec3, theta: theta_t) -> vec3:
        mu, _lam = m.lame(theta)
        return mu * vec3(s[1] + s[2], s[2] + s[0], s[0] + s[1])

    @wp.func(module="unique")
    def direct(F: mat33, theta: theta_t) -> mat33:
        mu, lam = m.lame(theta)
        p = lam * wp.log(wp.determinant(F)) - mu
        return mu * (F * wp.transpose(F)) + wp.diag(vec3(p, p, p))

    @wp.func(module="unique")
    def direct_adjoint(F: mat33, theta: theta_t, tau_bar: mat33):
        # dτ = μ (dF Fᵀ + F dFᵀ) + λ tr(F⁻¹ dF) I
        mu, lam = m.lame(theta)
        t = tau_bar[0, 0] + tau_bar[1, 1] + tau_bar[2, 2]
        Y = (tau_bar + wp.transpose(tau_bar)) * F
        F_bar = mu * Y + (lam * t) * wp.transpose(wp.inverse(F))
        mu_bar = real(0.5) * wp.ddot(Y, F) - t  # τ̄ : F Fᵀ − tr τ̄
        return F_bar, m.adjoint(theta, mu_bar, t * wp.log(wp.determinant(F)))

    return ElasticFunctions(energy, stress, stress_adjoint, slope, direct, direct_adjoint)


def energy(e: Tensor, params: dict[str, Tensor]) -> Tensor:
    """ψ [Pa] at Hencky strains e (..., 3)."""
    mu, lam = moduli.lame(params)
    log_J = e.sum(-1)
    return mu / 2 * (torch.exp(2 * e).sum(-1) - 3) - mu * log_J + lam / 2 * log_J**2


def stress(e: Tensor, params: dict[str, Tensor]) -> Tensor:
    """Principal Kirchhoff stresses [Pa] at Hencky strains e (..., 3)."""
    mu, lam = moduli.lame(params)
    return mu[..., None] * torch.expm1(2 * e) + (lam * e.sum(-1))[..., None]


LAW = Elastic(
    name="neo_hookean",
    params=(moduli.E, moduli.NU),
    build=build,
    wave_speed=moduli.p_wave_speed,
    energy=energy,
    stress=stress,
    is_direct=True,
)
