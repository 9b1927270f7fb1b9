"""Hencky (logarithmic) solid: the elasticity for which all return maps here are exact; metal, sand, clay.

    ψ = μ |e|² + λ/2 (tr e)²
    T_i = 2μ e_i + λ tr e,   e = ln S,  F = U S Vᵀ

Klár et al., Drucker–Prager elastoplasticity for sand animation, ACM TOG 35 (2016), §5.
"""

import warp as wp
from torch import Tensor

from .. import moduli
from ..expert import Elastic, ElasticFunctions, Layout


def build(layout: Layout) -> ElasticFunctions:
    """Warp functions for one layout."""
    real, vec3, theta_t = layout.real, layout.vec3, layout.theta_t
    m = moduli.build(layout)

    @wp.func(module="unique")
    def log_slope(a: real, b: real, log_a: real, log_b: real) -> real:
        """(ln a − ln b)/(a − b) = 2 artanh(d)/(d (a + b)), d = (a − b)/(a + b)."""
        sum = a + b
        d = (a - b) / sum
        y = d * d
        if y < real(1e-3):  # next term y⁵/11 < 1e-16
            c = real(1.0 / 9.0)
            return (
                real(2.0)
                * (real(1.0) + y * (real(1.0 / 3.0) + y * (real(1.0 / 5.0) + y * (real(1.0 / 7.0) + y * c))))
                / sum
            )
        return (log_a - log_b) / (a - b)

    @wp.func(module="unique")
    def energy(s: vec3, d: vec3, e: vec3, theta: theta_t) -> real:
        mu, lam = m.lame(theta)
        tr = e[0] + e[1] + e[2]
        return mu * wp.dot(e, e) + real(0.5) * lam * tr * tr

    @wp.func(module="unique")
    def stress(s: vec3, d: vec3, e: vec3, theta: theta_t) -> vec3:
        mu, lam = m.lame(theta)
        p = lam * (e[0] + e[1] + e[2])
        return real(2.0) * mu * e + vec3(p, p, p)

    @wp.func(module="unique")
    def stress_adjoint(s: vec3, d: vec3, e: vec3, theta: theta_t, T_bar: vec3):
        # ∂T_i/∂e_j = 2μ δ_ij + λ
        mu, lam = m.lame(theta)
        t = T_bar[0] + T_bar[1] + T_bar[2]
        e_bar = real(2.0) * mu * T_bar + vec3(lam * t, lam * t, lam * t)
        return e_bar, m.adjoint(theta, real(2.0) * wp.dot(e, T_bar), t * (e[0] + e[1] + e[2]))

    @wp.func(module="unique")
    def slope(s: vec3, d: vec3, e: vec3, theta: theta_t) -> vec3:
        mu, _lam = m.lame(theta)
        d_12 = log_slope(s[1], s[2], e[1], e[2])
        d_20 = log_slope(s[2], s[0], e[2], e[0])
        d_01 = log_slope(s[0], s[1], e[0], e[1])
        return real(2.0) * mu * vec3(d_12, d_20, d_01)

    return ElasticFunctions(energy, stress, stress_adjoint, slope)


def energy(e: Tensor, params: dict[str, Tensor]) -> Tensor:
    """ψ [Pa] at Hencky strains e (..., 3)."""
    mu, lam = moduli.lame(params)
    return mu * (e * e).sum(-1) + lam / 2 * e.sum(-1) ** 2


def stress(e: Tensor, params: dict[str, Tensor]) -> Tensor:
    """Principal Kirchhoff stresses [Pa] at Hencky strains e (..., 3)."""
    mu, lam = moduli.lame(params)
    return 2 * mu[..., None] * e + (lam * e.sum(-1))[..., None]


LAW = Elastic(
    name="hencky",
    params=(moduli.E, moduli.NU),
    build=build,
    wave_speed=moduli.p_wave_speed,
    energy=energy,
    stress=stress,
)
