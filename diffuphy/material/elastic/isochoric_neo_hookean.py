"""Neo-Hookean solid whose shear and volume answer separately: nearly incompressible rubber, flesh.

    ψ = μ/2 (J^(−2/3) tr FᵀF − 3) + κ/2 ((J² − 1)/2 − ln J),   κ = λ + 2μ/3
      = μ/2 Σ (e^(2ê_i) − 1 − 2ê_i) + κ/4 (J² − 1 − 2 ln J),   ê = dev ln s
    T_i = μ J^(−2/3) (s_i² − Σ s²/3) + κ/2 (J² − 1),   τ = μ J^(−2/3) dev(F Fᵀ − I) + κ/2 (J² − 1) I

The pressure depends on the volume alone. κ, not λ, so that small strains obey Hooke's law with the given E and ν.
Simo & Hughes, Computational Inelasticity (1998), §9.2.1.
"""

import torch
import warp as wp
from torch import Tensor

from .. import linalg, moduli, near_one, volume
from ..expert import Elastic, ElasticFunctions, Layout


def build(layout: Layout) -> ElasticFunctions:
    """Warp functions for one layout."""
    real, vec3, mat33, theta_t = layout.real, layout.vec3, layout.mat33, layout.theta_t
    m, la, vol = moduli.build(layout), linalg.build(real), volume.build(real)
    remainder = near_one.build(real).remainder
    third, half, two = real(1.0 / 3.0), real(0.5), real(2.0)

    @wp.func(module="unique")
    def bulk(theta: theta_t):
        """μ and κ."""
        mu, lam = m.lame(theta)
        return mu, lam + two * mu * third

    @wp.func(module="unique")
    def isochoric(s: vec3, d: vec3, e: vec3):
        """g = J^(−2/3) and the deviator of the squared stretches at unit volume, that of s² − 1 = (s + 1) d."""
        g = wp.exp(-two * third * (e[0] + e[1] + e[2]))
        c = wp.cw_mul(s, d) + d
        mean = third * (c[0] + c[1] + c[2])
        return g, g * (c - vec3(mean, mean, mean))

    @wp.func(module="unique")
    def energy(s: vec3, d: vec3, e: vec3, theta: theta_t) -> real:
        mu, kappa = bulk(theta)
        log_J = e[0] + e[1] + e[2]
        mean = third * log_J
        x = e - vec3(mean, mean, mean)
        r = vec3(remainder(two * x[0]), remainder(two * x[1]), remainder(two * x[2]))
        return two * mu * wp.dot(r, wp.cw_mul(x, x)) + kappa * log_J * log_J * remainder(two * log_J)

    @wp.func(module="unique")
    def stress(s: vec3, d: vec3, e: vec3, theta: theta_t) -> vec3:
        mu, kappa = bulk(theta)
        _g, dev = isochoric(s, d, e)
        j = vol.excess(s, d)
        p = half * kappa * j * (two + j)
        return mu * dev + vec3(p, p, p)

    @wp.func(module="unique")
    def stress_adjoint(s: vec3, d: vec3, e: vec3, theta: theta_t, T_bar: vec3):
        # ∂T_i/∂e_j = 2μ (c_i δ_ij − c_i/3 − c_j/3 + c̄/3) + κ J²,  c = J^(−2/3) s²
        mu, kappa = bulk(theta)
        g, dev = isochoric(s, d, e)
        c = g * wp.cw_mul(s, s)
        J2 = s[0] * s[1] * s[2] * s[0] * s[1] * s[2]
        j = vol.excess(s, d)
        t = T_bar[0] + T_bar[1] + T_bar[2]
        mu_bar = wp.dot(dev, T_bar)
        p = kappa * J2 * t - two * third * mu * mu_bar
        e_bar = two * mu * (wp.cw_mul(c, T_bar) - (third * t) * c) + vec3(p, p, p)
        kappa_bar = half * t * j * (two + j)
        return e_bar, m.adjoint(theta, mu_bar + two * third * kappa_bar, kappa_bar)

    @wp.func(module="unique")
    def slope(s: vec3, d: vec3, e: vec3, theta: theta_t) -> vec3:
        mu, _kappa = bulk(theta)
        mu *= wp.exp(real(-2.0) * third * (e[0] + e[1] + e[2]))
        return mu * vec3(s[1] + s[2], s[2] + s[0], s[0] + s[1])

    @wp.func(module="unique")
    def shape(H: mat33, log_J: real) -> mat33:
        """dev(FFᵀ)/J^(2/3)."""
        P = la.strain(wp.transpose(H))
        mean = third * wp.trace(P)
        return wp.exp(-two * third * log_J) * (P - wp.diag(vec3(mean, mean, mean)))

    @wp.func(module="unique")
    def direct(F: mat33, H: mat33, theta: theta_t) -> mat33:
        mu, kappa = bulk(theta)
        _J, j, log_J = vol.volume(F, H)
        p = half * kappa * j * (two + j)
        return mu * shape(H, log_J) + wp.diag(vec3(p, p, p))

    @wp.func(module="unique")
    def direct_adjoint(F: mat33, H: mat33, theta: theta_t, tau_bar: mat33):
        # dτ = d(μ J^(−2/3)) dev b + μ J^(−2/3) dev db + κ J dJ I,  dJ = cof F : dF
        mu, kappa = bulk(theta)
        J, j, log_J = vol.volume(F, H)
        t = wp.trace(tau_bar)
        Y = half * (tau_bar + wp.transpose(tau_bar)) * F
        Y = Y - (third * t) * F
        mu_bar = wp.ddot(tau_bar, shape(H, log_J))
        g = wp.exp(-two * third * log_J)
        F_bar = (two * mu * g) * Y + (kappa * J * t - two * third * mu * mu_bar / J) * la.cofactor(F)
        kappa_bar = half * t * j * (two + j)
        return F_bar, m.adjoint(theta, mu_bar + two * third * kappa_bar, kappa_bar)

    return ElasticFunctions(energy, stress, stress_adjoint, slope, direct, direct_adjoint)


def energy(e: Tensor, params: dict[str, Tensor]) -> Tensor:
    """ψ [Pa] at Hencky strains e (..., 3)."""
    mu, lam = moduli.lame(params)
    tr = e.sum(-1)
    dev = e - tr[..., None] / 3
    shear = 2 * mu * (dev * dev * near_one.remainder(2 * dev)).sum(-1)
    return shear + (lam + 2 * mu / 3) * tr * tr * near_one.remainder(2 * tr)


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
