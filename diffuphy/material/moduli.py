"""Elastic moduli: Young's modulus and Poisson's ratio to the Lamé parameters, and back through the adjoint.

μ = E / (2 (1 + ν)),   λ = E ν / ((1 + ν)(1 − 2ν)),   κ = λ + 2μ/3,   M = λ + 2μ
"""

from dataclasses import dataclass
from typing import Any

import torch
import warp as wp
from torch import Tensor

from .expert import Layout, Param

E = Param("E", "Pa", 1e3, 1e7, log=True, default=1e5)
NU = Param("nu", "-", 0.05, 0.45, log=False, default=0.3)


def check(params: dict[str, Tensor]) -> None:
    """Refuse moduli for which no elastic solid exists.

    Raises:
        ValueError: E ≤ 0, ν outside (−1, ½), or a value that is not finite.
    """
    young, nu = torch.as_tensor(params["E"]), torch.as_tensor(params["nu"])
    if not bool(((young > 0) & torch.isfinite(young)).all()):
        got = float(young.min())
        raise ValueError(f"E must be positive and finite [Pa], got {got:g}; for a liquid use the 'fluid' expert")
    if not bool(((nu > -1) & (nu < 0.5)).all()):
        got = float(nu.max() if bool((nu >= 0.5).any()) else nu.min())
        raise ValueError(
            f"nu must be in (-1, 0.5), got {got:g}: at 0.5 the bulk modulus is infinite; use at most 0.49, "
            "and for a liquid use the 'fluid' expert"
        )


def lame(params: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
    """Lamé parameters (μ, λ) [Pa]."""
    young, nu = params["E"], params["nu"]
    return young / (2 * (1 + nu)), young * nu / ((1 + nu) * (1 - 2 * nu))


def p_wave_speed(params: dict[str, Tensor], rho: Tensor) -> Tensor:
    """Speed of pressure waves c = √((λ + 2μ)/ρ) [m/s], the fastest of a solid at rest."""
    mu, lam = lame(params)
    return torch.sqrt((lam + 2 * mu) / rho)


@dataclass(frozen=True)
class ModuliFunctions:
    """Warp functions on θ."""

    lame: Any
    """θ → (μ, λ) [Pa]."""
    adjoint: Any
    """(θ, μ̄, λ̄) → θ̄, zero outside E and ν."""
    ratio: Any
    """θ → 3κ/(2μ) = (1 + ν)/(1 − 2ν)."""


def build(layout: Layout) -> ModuliFunctions:
    """Moduli functions for one layout; it must hold "E" and "nu"."""
    real, theta_t = layout.real, layout.theta_t
    at_E, at_nu = layout.at("E"), layout.at("nu")

    @wp.func(module="unique")
    def lame_theta(theta: theta_t):
        young = theta[at_E]
        nu = theta[at_nu]
        one = real(1.0)
        mu = young / (real(2.0) * (one + nu))
        return mu, real(2.0) * mu * nu / (one - real(2.0) * nu)

    @wp.func(module="unique")
    def lame_adjoint(theta: theta_t, mu_bar: real, lam_bar: real) -> theta_t:
        young = theta[at_E]
        nu = theta[at_nu]
        one = real(1.0)
        two = real(2.0)
        a = one + nu
        b = one - two * nu
        mu = one / (two * a)  # per unit of E
        lam = nu / (a * b)
        out = theta_t()
        out[at_E] = mu_bar * mu + lam_bar * lam
        # dμ/dν = −μ/(1+ν); dλ/dν = E (1 + 2ν²)/((1+ν)(1−2ν))²
        out[at_nu] = young * (lam_bar * (one + two * nu * nu) / (a * b * a * b) - mu_bar * mu / a)
        return out

    @wp.func(module="unique")
    def ratio(theta: theta_t) -> real:
        nu = theta[at_nu]
        return (real(1.0) + nu) / (real(1.0) - real(2.0) * nu)

    return ModuliFunctions(lame_theta, lame_adjoint, ratio)
