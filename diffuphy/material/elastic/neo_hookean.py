"""Compressible neo-Hookean solid: rubber, jelly.

    ψ = μ/2 (tr FᵀF − 3) − μ ln J + λ/2 (ln J)² = μ/2 Σ (e^(2e_i) − 1 − 2e_i) + λ/2 (ln J)²
    T_i = μ (s_i² − 1) + λ ln J,   τ = μ (F Fᵀ − I) + λ ln J I

Bonet & Wood, Nonlinear Continuum Mechanics for Finite Element Analysis (2008), §6.4.3.
"""

import torch
import warp as wp
from torch import Tensor

from .. import linalg, moduli, near_one, volume
from ..expert import Elastic, ElasticFunctions, Layout


def build(layout: Layout) -> ElasticFunctions:
    """Warp functions for one layout."""
    real, vec3, mat33, theta_t = layout.real, layout.vec3, layout.mat33, layout.theta_t
    m, la = moduli.build(layout), linalg.build(real)
    vol, remainder = volume.build(real), near_one.build(real).remainder

    @wp.func(module="unique")
    def energy(s: vec3, d: vec3, e: vec3, theta: theta_t) -> real:
        mu, lam = m.lame(theta)
        log_J = e[0] + e[1] + e[2]
        r = vec3(remainder(real(2.0) * e[0]), remainder(real(2.0) * e[1]), remainder(real(2.0) * e[2]))
        return real(2.0) * mu * wp.dot(r, wp.cw_mul(e, e)) + real(0.5) * lam * log_J * log_J

    @wp.func(module="unique")
    def stress(s: vec3, d: vec3, e: vec3, theta: theta_t) -> vec3:
        mu, lam = m.lame(theta)
        p = lam * (e[0] + e[1] + e[2])
        return mu * (wp.cw_mul(s, d) + d) + vec3(p, p, p)

    @wp.func(module="unique")
    def stress_adjoint(s: vec3, d: vec3, e: vec3, theta: theta_t, T_bar: vec3):
        # ∂T_i/∂e_j = 2μ s_i² δ_ij + λ
        mu, lam = m.lame(theta)
        t = T_bar[0] + T_bar[1] + T_bar[2]
        e_bar = real(2.0) * mu * wp.cw_mul(wp.cw_mul(s, s), T_bar) + vec3(lam * t, lam * t, lam * t)
        return e_bar, m.adjoint(theta, wp.dot(wp.cw_mul(s, d) + d, T_bar), t * (e[0] + e[1] + e[2]))

    @wp.func(module="unique")
    def slope(s: vec3, d: vec3, e: vec3, theta: theta_t) -> vec3:
        mu, _lam = m.lame(theta)
        return mu * vec3(s[1] + s[2], s[2] + s[0], s[0] + s[1])

    @wp.func(module="unique")
    def direct(F: mat33, H: mat33, theta: theta_t) -> mat33:
        mu, lam = m.lame(theta)
        _J, _j, log_J = vol.volume(F, H)
        p = lam * log_J
        return mu * la.strain(wp.transpose(H)) + wp.diag(vec3(p, p, p))

    @wp.func(module="unique")
    def direct_adjoint(F: mat33, H: mat33, theta: theta_t, tau_bar: mat33):
        # dτ = μ (dF Fᵀ + F dFᵀ) + λ tr(F⁻¹ dF) I
        mu, lam = m.lame(theta)
        _J, _j, log_J = vol.volume(F, H)
        t = tau_bar[0, 0] + tau_bar[1, 1] + tau_bar[2, 2]
        Y = (tau_bar + wp.transpose(tau_bar)) * F
        F_bar = mu * Y + (lam * t) * wp.transpose(wp.inverse(F))
        return F_bar, m.adjoint(theta, wp.ddot(tau_bar, la.strain(wp.transpose(H))), t * log_J)

    return ElasticFunctions(energy, stress, stress_adjoint, slope, direct, direct_adjoint)


def energy(e: Tensor, params: dict[str, Tensor]) -> Tensor:
    """ψ [Pa] at Hencky strains e (..., 3)."""
    mu, lam = moduli.lame(params)
    log_J = e.sum(-1)
    return 2 * mu * (e * e * near_one.remainder(2 * e)).sum(-1) + lam / 2 * log_J**2


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
