"""Fixed corotated solid: toys, plants, soft bodies.

    ψ = μ |F − R|² + λ/2 (J − 1)²,   F = R S (polar)
    T_i = 2μ (s_i − 1) s_i + λ J (J − 1),   τ = μ (FFᵀ − I + DDᵀ) + λ J (J − 1) I,   D = F − R

Stomakhin et al., Energetically consistent invertible elasticity, SCA 2012, eq. 3.
"""

import torch
import warp as wp
from torch import Tensor

from .. import linalg, moduli, volume
from ..expert import Elastic, ElasticFunctions, Layout


def build(layout: Layout) -> ElasticFunctions:
    """Warp functions for one layout."""
    real, vec3, mat33, theta_t = layout.real, layout.vec3, layout.mat33, layout.theta_t
    m, la, vol = moduli.build(layout), linalg.build(real), volume.build(real)

    @wp.func(module="unique")
    def energy(s: vec3, d: vec3, e: vec3, theta: theta_t) -> real:
        mu, lam = m.lame(theta)
        j = vol.excess(s, d)
        return mu * wp.dot(d, d) + real(0.5) * lam * j * j

    @wp.func(module="unique")
    def stress(s: vec3, d: vec3, e: vec3, theta: theta_t) -> vec3:
        mu, lam = m.lame(theta)
        j = vol.excess(s, d)
        p = lam * (real(1.0) + j) * j
        return real(2.0) * mu * wp.cw_mul(s, d) + vec3(p, p, p)

    @wp.func(module="unique")
    def stress_adjoint(s: vec3, d: vec3, e: vec3, theta: theta_t, T_bar: vec3):
        # ∂T_i/∂e_j = 2μ (2 s_i − 1) s_i δ_ij + λ J (2J − 1)
        mu, lam = m.lame(theta)
        j = vol.excess(s, d)
        J = real(1.0) + j
        t = T_bar[0] + T_bar[1] + T_bar[2]
        c = wp.cw_mul(s, d)
        p = lam * J * (J + j) * t
        e_bar = real(2.0) * mu * wp.cw_mul(real(2.0) * c + s, T_bar) + vec3(p, p, p)
        return e_bar, m.adjoint(theta, real(2.0) * wp.dot(c, T_bar), t * J * j)

    @wp.func(module="unique")
    def slope(s: vec3, d: vec3, e: vec3, theta: theta_t) -> vec3:
        mu, _lam = m.lame(theta)
        one = real(1.0)
        return real(2.0) * mu * vec3(s[1] + s[2] - one, s[2] + s[0] - one, s[0] + s[1] - one)

    @wp.func(module="unique")
    def direct(F: mat33, H: mat33, theta: theta_t) -> mat33:
        mu, lam = m.lame(theta)
        J, j = vol.dilation(F, H)
        p = lam * J * j
        D = F - la.polar(F)
        return mu * (la.strain(wp.transpose(H)) + la.gram(wp.transpose(D))) + wp.diag(vec3(p, p, p))

    @wp.func(module="unique")
    def direct_adjoint(F: mat33, H: mat33, theta: theta_t, tau_bar: mat33):
        # dτ = 2μ (dF Fᵀ + F dFᵀ − dV) + λ (2J − 1) dJ I with V = F Rᵀ;  dR = [ω]ₓ R, (tr V I − V) ω = ax(dF Rᵀ)
        mu, lam = m.lame(theta)
        R = la.polar(F)
        D = F - R
        J, j = vol.dilation(F, H)
        Y = real(0.5) * (tau_bar + wp.transpose(tau_bar))
        V = F * wp.transpose(R)
        v = wp.trace(V)
        t = wp.trace(Y)
        A = Y * V
        ax = vec3(A[2, 1] - A[1, 2], A[0, 2] - A[2, 0], A[1, 0] - A[0, 1])
        q = wp.inverse(wp.diag(vec3(v, v, v)) - V) * ax
        F_bar = real(2.0) * mu * (real(2.0) * Y * F - (Y + wp.skew(q)) * R) + (lam * t * (J + j)) * la.cofactor(F)
        mu_bar = wp.ddot(Y, la.strain(wp.transpose(H)) + la.gram(wp.transpose(D)))
        return F_bar, m.adjoint(theta, mu_bar, t * J * j)

    return ElasticFunctions(energy, stress, stress_adjoint, slope, direct, direct_adjoint)


def energy(e: Tensor, params: dict[str, Tensor]) -> Tensor:
    """ψ [Pa] at Hencky strains e (..., 3)."""
    mu, lam = moduli.lame(params)
    return mu * (torch.expm1(e) ** 2).sum(-1) + lam / 2 * torch.expm1(e.sum(-1)) ** 2


def stress(e: Tensor, params: dict[str, Tensor]) -> Tensor:
    """Principal Kirchhoff stresses [Pa] at Hencky strains e (..., 3)."""
    mu, lam = moduli.lame(params)
    tr = e.sum(-1)
    return 2 * mu[..., None] * torch.expm1(e) * torch.exp(e) + (lam * torch.exp(tr) * torch.expm1(tr))[..., None]


LAW = Elastic(
    name="fixed_corotated",
    params=(moduli.E, moduli.NU),
    build=build,
    wave_speed=moduli.p_wave_speed,
    energy=energy,
    stress=stress,
    is_direct=True,
)
