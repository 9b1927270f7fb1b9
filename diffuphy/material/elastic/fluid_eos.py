"""Weakly compressible liquid: a pressure that depends on the volume alone (Tait, Cole, Murnaghan).

    p = (K/γ) (J^(−γ) − 1)            Cauchy pressure; K is the bulk modulus at rest, c = √(K/ρ)
    τ = −J p I = (K/γ) (J − J^(1−γ)) I
    ψ = (K/γ) (J − 1 + (J^(1−γ) − 1)/(γ − 1))

Cole, Underwater Explosions (1948); Monaghan, J. Comput. Phys. 110 (1994), eq. 3.1, γ = 7 for water; Murnaghan, PNAS 30
(1944). Codes that write p = K (J^(−γ) − 1) call K what is K/γ here: their waves run √γ times faster than √(K/ρ).
Alone it holds no shear: together with the plastic law ``fluid`` the deformation gradient stays well conditioned.
"""

import torch
import warp as wp
from torch import Tensor

from .. import linalg
from ..expert import Elastic, ElasticFunctions, Layout, Param

BULK_MODULUS = Param("bulk_modulus", "Pa", 1e3, 1e7, log=True, default=1e5)
GAMMA = Param("gamma", "-", 1.0, 12.0, log=False, default=7.0)


def build(layout: Layout) -> ElasticFunctions:
    """Warp functions for one layout."""
    real, vec3, mat33, theta_t = layout.real, layout.vec3, layout.mat33, layout.theta_t
    at, at_gamma = layout.at("bulk_modulus"), layout.at("gamma")
    la = linalg.build(real)
    nan, one = real(float("nan")), real(1.0)

    @wp.func(module="unique")
    def of_volume(J: real, log_J: real, theta: theta_t):
        """T and ∂T/∂ln J [Pa], and θ̄ of T̄ = 1."""
        K, g = theta[at], theta[at_gamma]
        c = K / g
        stiff = J * wp.exp(-g * log_J)  # J^(1−γ)
        T = c * (J - stiff)
        theta_bar = theta_t()
        theta_bar[at] = T / K
        theta_bar[at_gamma] = c * stiff * log_J - T / g
        return T, c * (J + (g - one) * stiff), theta_bar

    @wp.func(module="unique")
    def energy(s: vec3, e: vec3, theta: theta_t) -> real:
        K, g = theta[at], theta[at_gamma]
        log_J = e[0] + e[1] + e[2]
        x = (one - g) * log_J
        y = one + x * (real(0.5) + x * (real(1.0 / 6.0) + x * real(1.0 / 24.0)))
        if wp.abs(x) > real(1e-3):  # (eˣ − 1)/x; the next term of the series, x⁴/120, is 1e-14
            y = (wp.exp(x) - one) / x
        return K / g * (wp.exp(log_J) - one - log_J * y)

    @wp.func(module="unique")
    def stress(s: vec3, e: vec3, theta: theta_t) -> vec3:
        T, _dT, _theta = of_volume(s[0] * s[1] * s[2], e[0] + e[1] + e[2], theta)
        return vec3(T, T, T)

    @wp.func(module="unique")
    def stress_adjoint(s: vec3, e: vec3, theta: theta_t, T_bar: vec3):
        _T, dT, theta_bar = of_volume(s[0] * s[1] * s[2], e[0] + e[1] + e[2], theta)
        t = T_bar[0] + T_bar[1] + T_bar[2]
        return vec3(dT * t, dT * t, dT * t), t * theta_bar

    @wp.func(module="unique")
    def slope(s: vec3, e: vec3, theta: theta_t) -> vec3:
        return vec3()

    @wp.func(module="unique")
    def direct(F: mat33, theta: theta_t) -> mat33:
        J = wp.determinant(F)
        T, _dT, _theta = of_volume(J, wp.log(J), theta)
        if not J > real(0.0):
            T = nan
        return wp.diag(vec3(T, T, T))

    @wp.func(module="unique")
    def direct_adjoint(F: mat33, theta: theta_t, tau_bar: mat33):
        # dτ = (∂T/∂ln J) (cof F : dF)/J I
        C = la.cofactor(F)
        J = F[0, 0] * C[0, 0] + F[0, 1] * C[0, 1] + F[0, 2] * C[0, 2]
        _T, dT, theta_bar = of_volume(J, wp.log(J), theta)
        t = wp.trace(tau_bar)
        return (t * dT / J) * C, t * theta_bar

    return ElasticFunctions(energy, stress, stress_adjoint, slope, direct, direct_adjoint)


def wave_speed(params: dict[str, Tensor], rho: Tensor) -> Tensor:
    """Speed of sound c = √(K/ρ) [m/s] at rest."""
    return torch.sqrt(params["bulk_modulus"] / rho)


def energy(e: Tensor, params: dict[str, Tensor]) -> Tensor:
    """ψ [Pa] at Hencky strains e (..., 3)."""
    g, log_J = params["gamma"], e.sum(-1)
    x = (1 - g) * log_J
    ratio = torch.where(x.abs() > 1e-8, torch.expm1(x) / torch.where(x == 0, 1, x), 1 + x / 2)
    return params["bulk_modulus"] / g * (torch.expm1(log_J) - log_J * ratio)


def stress(e: Tensor, params: dict[str, Tensor]) -> Tensor:
    """Principal Kirchhoff stresses [Pa] at Hencky strains e (..., 3)."""
    g, log_J = params["gamma"], e.sum(-1)
    T = -params["bulk_modulus"] / g * torch.exp(log_J) * torch.expm1(-g * log_J)
    return T[..., None].expand_as(e)


LAW = Elastic(
    name="fluid_eos",
    params=(BULK_MODULUS, GAMMA),
    build=build,
    wave_speed=wave_speed,
    energy=energy,
    stress=stress,
    is_direct=True,
)
