"""Bingham viscoplasticity: cream, honey, dough, mud, and everything that has melted.

    overstress y = s − √(2/3) σ_Y,  s = 2μ |ê|;   y ≤ 0 keeps
    implicit step: s' = s − y μ dt/(μ dt + η),  k = s'/s,  m = tr/3
    a = 1 − k = (y/s) μ dt/(μ dt + η),  b = 0

η is the true shear viscosity: in steady shear dev τ = √(2/3) σ_Y dev τ/|dev τ| + 2η D. (Codes that follow PAC-NeRF read
their parameter as 2η.) η → 0 gives von Mises, η → ∞ the elastic solid. The step is implicit, so viscosity puts no bound
on dt. Yue et al., Continuum foam, ACM TOG 34 (2015), with h = 1.
"""

import torch
import warp as wp
from torch import Tensor

from .. import moduli
from ..expert import Layout, Param, Plastic, PlasticFunctions
from .von_mises import YIELD_STRESS

VISCOSITY = Param("viscosity", "Pa s", 1e-1, 1e4, log=True, default=1e1)


def build(layout: Layout) -> PlasticFunctions:
    """Warp functions for one layout."""
    real, theta_t = layout.real, layout.theta_t
    at, at_eta = layout.at("yield_stress"), layout.at("viscosity")
    m = moduli.build(layout)
    root = real((2.0 / 3.0) ** 0.5)

    @wp.func(module="unique")
    def flow(n: real, tr: real, theta: theta_t, dt: real):
        mu, _lam = m.lame(theta)
        r = root * theta[at] / (real(2.0) * mu)
        a = real(0.0)
        if n > r:
            a = (n - r) / n
            if theta[at_eta] > real(0.0):  # else it flows in no time, also in a step of none
                a = a * (mu * dt / (mu * dt + theta[at_eta]))
        return a, real(0.0)

    @wp.func(module="unique")
    def flow_adjoint(n: real, tr: real, theta: theta_t, dt: real, a_bar: real, b_bar: real):
        mu, _lam = m.lame(theta)
        r = root * theta[at] / (real(2.0) * mu)
        n_bar = real(0.0)
        theta_bar = theta_t()
        if n > r:  # a = (1 − r/n) g,  g = μ dt/(μ dt + η)
            d = real(0.0)
            g = real(1.0)
            if mu * dt + theta[at_eta] > real(0.0):
                d = real(1.0) / (mu * dt + theta[at_eta])
                g = mu * dt * d
            g_bar = a_bar * (n - r) / n
            r_bar = -a_bar * g / n
            n_bar = a_bar * g * r / (n * n)
            theta_bar = m.adjoint(theta, g_bar * theta[at_eta] * dt * d * d - r_bar * r / mu, real(0.0))
            theta_bar[at] = r_bar * root / (real(2.0) * mu)
            theta_bar[at_eta] = -g_bar * g * d
        return n_bar, real(0.0), theta_bar

    return PlasticFunctions(flow, flow_adjoint)


def flow(n: Tensor, tr: Tensor, params: dict[str, Tensor], dt: float) -> tuple[Tensor, Tensor]:
    """(a, b) of the trial state with |ê| = n after a step of dt [s]."""
    mu, _ = moduli.lame(params)
    r = (2 / 3) ** 0.5 * params["yield_stress"] / (2 * mu)
    flows = n > r
    eta = params["viscosity"]
    rate = torch.where(eta > 0, mu * dt / torch.where(eta > 0, mu * dt + eta, torch.ones_like(n)), torch.ones_like(n))
    share = (n - r) / torch.where(flows, n, torch.ones_like(n)) * rate
    return torch.where(flows, share, torch.zeros_like(n)), torch.zeros_like(n)


LAW = Plastic(name="viscoplastic", params=(moduli.E, moduli.NU, YIELD_STRESS, VISCOSITY), build=build, flow=flow)
