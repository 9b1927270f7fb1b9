"""Fixed corotated solid: toys, plants, soft bodies.

    ψ = μ |F − R|² + λ/2 (J − 1)²,   F = R S (polar)
    T_i = 2μ (s_i − 1) s_i + λ J (J − 1),   τ = 2μ (F − R) Fᵀ + λ J (J − 1) I

Stomakhin et al., Energetically consistent invertible elasticity, SCA 2012, eq. 3.
"""

import torch
import warp as wp
from torch import Tensor

from .. import moduli
from ..expert import Elastic, ElasticFunctions, Layout


def build(layout: Layout) -> ElasticFunctions:
    """Warp functions for one layout."""
    real, vec3, theta_t = layout.real, layout.vec3, layout.theta_t
    m = moduli.build(layout)

    @wp.func(module="unique")
    def energy(s: vec3, e: vec3, theta: theta_t) -> real:
        mu, lam = m.lame(theta)
        d = s - vec3(real(1.0), real(1.0), real(1.0))
        j = s[0] * s[1] * s[2] - real(1.0)
        return mu * wp.dot(d, d) + real(0.5) * lam * j * j

    @wp.func(module="unique")
    def stress(s: vec3, e: vec3, theta: theta_t) -> vec3:
        mu, lam = m.lame(theta)
        J = s[0] * s[1] * s[2]
        p = lam * J * (J - real(1.0))
        return real(2.0) * mu * (wp.cw_mul(s, s) - s) + vec3(p, p, p)

    @wp.func(module="unique")
    def stress_adjoint(s: vec3, e: vec3, theta: theta_t, T_bar: vec3):
        # ∂T_i/∂e_j = 2μ (2 s_i − 1) s_i δ_ij + λ J (2J − 1)
        mu, lam = m.lame(theta)
        J = s[0] * s[1] * s[2]
        t = T_bar[0] + T_bar[1] + T_bar[2]
        d = wp.cw_mul(s, s) - s
        p = lam * J * (real(2.0) * J - real(1.0)) * t
        e_bar = real(2.0) * mu * wp.cw_mul(real(2.0) * d + s, T_bar) + vec3(p, p, p)
        return e_bar, m.adjoint(theta, real(2.0) * wp.dot(d, T_bar), t * J * (J - real(1.0)))

    @wp.func(module="unique")
    def slope(s: vec3, e: vec3, theta: theta_t) -> vec3:
        mu, _lam = m.lame(theta)
        one = real(1.0)
        return real(2.0) * mu * vec3(s[1] + s[2] - one, s[2] + s[0] - one, s[0] + s[1] - one)

    return ElasticFunctions(energy, stress, stress_adjoint, slope)


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
)
