"""Neo-Hookean solid whose shear and volume answer separately: nearly incompressible rubber, flesh.

    ψ = μ/2 (J^(−2/3) tr FᵀF − 3) + κ/2 ((J² − 1)/2 − ln J),   κ = λ + 2μ/3
    T_i = μ J^(−2/3) (s_i² − Σ s²/3) + κ/2 (J² − 1),   τ = μ J^(−2/3) dev(F Fᵀ) + κ/2 (J² − 1) I

The pressure depends on the volume alone. κ, not λ, so that small strains obey Hooke's law with the given E and ν.
Simo & Hughes, Computational Inelasticity (1998), §9.2.1.
"""

import torch
import warp as wp
from torch import Tensor

from .. import linalg, moduli
from ..expert import Elastic, ElasticFunctions, Layout


def build(layout: Layout) -> ElasticFunctions:
    """Warp functions for one layout."""
    real, vec3, mat33, theta_t = layout.real, layout.vec3, layout.mat33, layout.theta_t
    m, la = moduli.build(layout), linalg.build(layout.real)
    nan, third = real(float("nan")), real(1.0 / 3.0)
    half, one, two = real(0.5), real(1.0), real(2.0)

    @wp.func(module="unique")
    def bulk(theta: theta_t):
        """μ and κ."""
        mu, lam = m.lame(theta)
        return mu, lam + two * mu * third

    @wp.func(module="unique")
    def isochoric(s: vec3, e: vec3):
        """Squares of the stretches at unit volume, and their mean."""
        c = wp.exp(real(-2.0) * third * (e[0] + e[1] + e[2])) * wp.cw_mul(s, s)
        return c, (c[0] + c[1] + c[2]) * third

    @wp.func(module="unique")
    def energy(s: vec3, e: vec3, theta: theta_t) -> real:
        mu, kappa = bulk(theta)
        _c, mean = isochoric(s, e)
        J = s[0] * s[1] * s[2]
        return real(1.5) * mu * (mean - one) + half * kappa * (half * (J * J - one) - (e[0] + e[1] + e[2]))

    @wp.func(module="unique")
    def stress(s: vec3, e: vec3, theta: theta_t) -> vec3:
        mu, kappa = bulk(theta)
        c, mean = isochoric(s, e)
        J = s[0] * s[1] * s[2]
        p = half * kappa * (J * J - one) - mu * mean
        return mu * c + vec3(p, p, p)

    @wp.func(module="unique")
    def stress_adjoint(s: vec3, e: vec3, theta: theta_t, T_bar: vec3):
        # ∂T_i/∂e_j = 2μ (c_i δ_ij − c_i/3 − c_j/3 + c̄/3) + κ J²,  c = J^(−2/3) s²
        mu, kappa = bulk(theta)
        c, mean = isochoric(s, e)
        J2 = s[0] * s[1] * s[2] * s[0] * s[1] * s[2]
        t = T_bar[0] + T_bar[1] + T_bar[2]
        dev = wp.dot(c, T_bar) - mean * t
        p = kappa * J2 * t - two * third * mu * dev
        e_bar = two * mu * (wp.cw_mul(c, T_bar) - (third * t) * c) + vec3(p, p, p)
        kappa_bar = half * t * (J2 - one)
        return e_bar, m.adjoint(theta, dev + two * third * kappa_bar, kappa_bar)

    @wp.func(module="unique")
    def slope(s: vec3, e: vec3, theta: theta_t) -> vec3:
        mu, _kappa = bulk(theta)
        mu *= wp.exp(real(-2.0) * third * (e[0] + e[1] + e[2]))
        return mu * vec3(s[1] + s[2], s[2] + s[0], s[0] + s[1])

    @wp.func(module="unique")
    def direct(F: mat33, theta: theta_t) -> mat33:
        mu, kappa = bulk(theta)
        J = wp.determinant(F)
        g = mu * wp.pow(J, real(-2.0) * third)
        p = half * kappa * (J * J - one) - g * (wp.ddot(F, F) / real(3.0))
        if not J > real(0.0):  # no such state, though J² has a value
            p = nan
        return g * (F * wp.transpose(F)) + wp.diag(vec3(p, p, p))

    @wp.func(module="unique")
    def direct_adjoint(F: mat33, theta: theta_t, tau_bar: mat33):
        # dτ = d(μ J^(−2/3)) dev b + μ J^(−2/3) dev db + κ J dJ I,  dJ = cof F : dF
        mu, kappa = bulk(theta)
        C = la.cofactor(F)
        J = F[0, 0] * C[0, 0] + F[0, 1] * C[0, 1] + F[0, 2] * C[0, 2]
        g = wp.pow(J, real(-2.0) * third)
        t = wp.trace(tau_bar)
        Y = half * (tau_bar + wp.transpose(tau_bar)) * F
        Y = Y - (third * t) * F
        dev = g * wp.ddot(Y, F)  # τ̄ : J^(−2/3) dev b
        F_bar = (two * mu * g) * Y + (kappa * J * t - two * third * mu * dev / J) * C
        kappa_bar = half * t * (J * J - one)
        return F_bar, m.adjoint(theta, dev + two * third * kappa_bar, kappa_bar)

    return ElasticFunctions(energy, stress, stress_adjoint, slope, direct, direct_adjoint)


def energy(e: Tensor, params: dict[str, Tensor]) -> Tensor:
    """ψ [Pa] at Hencky strains e (..., 3)."""
    mu, lam = moduli.lame(params)
    tr = e.sum(-1)
    dev = e - tr[..., None] / 3
    shear = mu / 2 * torch.expm1(2 * dev).sum(-1)
    return shear + (lam + 2 * mu / 3) / 2 * (torch.expm1(2 * tr) / 2 - tr)


def stress(e: Tensor, params: dict[str, Tensor]) -> Tensor:
    """Principal Kirchhoff stresses [Pa] at Hencky strains e (..., 3)."""
    mu, lam = moduli.lame(params)
    tr = e.sum(-1, keepdim=True)
    c = torch.expm1(2 * (e - tr / 3))
    return mu[..., None] * (c - c.mean(-1, keepdim=True)) + (lam + 2 * mu / 3)[..., None] / 2 * torch.expm1(2 * tr)


LAW = Elastic(
    name="isochoric_neo_hookean",
    params=(moduli.E, moduli.NU),
    build=build,
    wave_speed=moduli.p_wave_speed,
    energy=energy,
    stress=stress,
    is_direct=True,
)
