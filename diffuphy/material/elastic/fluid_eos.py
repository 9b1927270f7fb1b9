"""Weakly compressible liquid: a pressure that depends on the volume alone (Tait, Cole, Murnaghan).

    p = (K/γ) (J^(−γ) − 1)            Cauchy pressure; K is the bulk modulus at rest, c = √(K/ρ)
    τ = −J p I = (K/γ) (J − J^(1−γ)) I
    ψ = (K/γ) (J − 1 + (J^(1−γ) − 1)/(γ − 1))
      = (K/γ) t² (r(t) + (γ − 1) r((1 − γ) t)),   t = ln J,  r(x) = (eˣ − 1 − x)/x²

Cole, Underwater Explosions (1948); Monaghan, J. Comput. Phys. 110 (1994), eq. 3.1, γ = 7 for water; Murnaghan, PNAS 30
(1944). Codes that write p = K (J^(−γ) − 1) call K what is K/γ here: their waves run √γ times faster than √(K/ρ).
Alone it holds no shear: together with the plastic law ``fluid`` the deformation gradient stays well conditioned.
"""

import torch
import warp as wp
from torch import Tensor

from .. import linalg, near_one, volume
from ..expert import Elastic, ElasticFunctions, Layout, Param

BULK_MODULUS = Param("bulk_modulus", "Pa", 1e3, 1e7, log=True, default=1e5)
GAMMA = Param("gamma", "-", 1.0, 12.0, log=False, default=7.0)


def build(layout: Layout) -> ElasticFunctions:
    """Warp functions for one layout."""
    real, vec3, mat33, theta_t = layout.real, layout.vec3, layout.mat33, layout.theta_t
    at, at_gamma = layout.at("bulk_modulus"), layout.at("gamma")
    la, vol, near = linalg.build(real), volume.build(real), near_one.build(real)
    one = real(1.0)

    @wp.func(module="unique")
    def of_volume(J: real, log_J: real, theta: theta_t):
        """T and ∂T/∂ln J [Pa], and θ̄ of T̄ = 1."""
        K, g = theta[at], theta[at_gamma]
        c = K / g * J
        x = -g * log_J
        ratio, y = near.exponential(x)
        T = -c * y
        theta_bar = theta_t()
        theta_bar[at] = T / K
        theta_bar[at_gamma] = c / g * x * x * (near.remainder(x) * (one - x) - one)  # (1 − x) eˣ − 1
        return T, c * (one + (g - one) * ratio), theta_bar

    @wp.func(module="unique")
    def energy(s: vec3, d: vec3, e: vec3, theta: theta_t) -> real:
        K, g = theta[at], theta[at_gamma]
        t = e[0] + e[1] + e[2]
        return K / g * t * t * (near.remainder(t) + (g - one) * near.remainder((one - g) * t))

    @wp.func(module="unique")
    def stress(s: vec3, d: vec3, e: vec3, theta: theta_t) -> vec3:
        T, _dT, _theta = of_volume(s[0] * s[1] * s[2], e[0] + e[1] + e[2], theta)
        return vec3(T, T, T)

    @wp.func(module="unique")
    def stress_adjoint(s: vec3, d: vec3, e: vec3, theta: theta_t, T_bar: vec3):
        _T, dT, theta_bar = of_volume(s[0] * s[1] * s[2], e[0] + e[1] + e[2], theta)
        t = T_bar[0] + T_bar[1] + T_bar[2]
        return vec3(dT * t, dT * t, dT * t), t * theta_bar

    @wp.func(module="unique")
    def slope(s: vec3, d: vec3, e: vec3, theta: theta_t) -> vec3:
        return vec3()

    @wp.func(module="unique")
    def direct(F: mat33, H: mat33, theta: theta_t) -> mat33:
        J, _j, log_J = vol.volume(F, H)
        T, _dT, _theta = of_volume(J, log_J, theta)
        return wp.diag(vec3(T, T, T))

    @wp.func(module="unique")
    def direct_adjoint(F: mat33, H: mat33, theta: theta_t, tau_bar: mat33):
        # dτ = (∂T/∂ln J) (cof F : dF)/J I
        J, _j, log_J = vol.volume(F, H)
        _T, dT, theta_bar = of_volume(J, log_J, theta)
        t = wp.trace(tau_bar)
        return (t * dT / J) * la.cofactor(F), t * theta_bar

    return ElasticFunctions(energy, stress, stress_adjoint, slope, direct, direct_adjoint)


def wave_speed(params: dict[str, Tensor], rho: Tensor) -> Tensor:
    """Speed of sound c = √(K/ρ) [m/s] at rest."""
    return torch.sqrt(params["bulk_modulus"] / rho)


def energy(e: Tensor, params: dict[str, Tensor]) -> Tensor:
    """ψ [Pa] at Hencky strains e (..., 3)."""
    g, t = params["gamma"], e.sum(-1)
    shape = near_one.remainder(t) + (g - 1) * near_one.remainder((1 - g) * t)
    return params["bulk_modulus"] / g * t * t * shape


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
