"""Von Mises (J2) plasticity: metal, plasticine.

    yield: 2μ |ê| > √(2/3) σ_Y,   flow to the surface: k = √(2/3) σ_Y / (2μ |ê|), m = tr/3
    a = 1 − k,  b = 0

σ_Y is the uniaxial yield stress: in uniaxial tension |dev τ| = √(2/3) σ_Y. Simo & Hughes, Computational Inelasticity
(1998), §3.3; radial return in Hencky strain.
"""

import torch
import warp as wp
from torch import Tensor

from .. import moduli
from ..expert import Layout, Param, Plastic, PlasticFunctions

YIELD_STRESS = Param("yield_stress", "Pa", 1e1, 1e6, log=True, default=1e3)


def build(layout: Layout) -> PlasticFunctions:
    """Warp functions for one layout."""
    real, theta_t, at = layout.real, layout.theta_t, layout.at("yield_stress")
    m = moduli.build(layout)
    root = real((2.0 / 3.0) ** 0.5)

    @wp.func(module="unique")
    def flow(n: real, tr: real, theta: theta_t, dt: real):
        mu, _lam = m.lame(theta)
        r = root * theta[at] / (real(2.0) * mu)
        a = real(0.0)
        if n > r:
            a = (n - r) / n
        return a, real(0.0)

    @wp.func(module="unique")
    def flow_adjoint(n: real, tr: real, theta: theta_t, dt: real, a_bar: real, b_bar: real):
        mu, _lam = m.lame(theta)
        r = root * theta[at] / (real(2.0) * mu)
        n_bar = real(0.0)
        theta_bar = theta_t()
        if n > r:  # a = 1 − r/n
            r_bar = -a_bar / n
            n_bar = a_bar * r / (n * n)
            theta_bar = m.adjoint(theta, -r_bar * r / mu, real(0.0))
            theta_bar[at] = r_bar * root / (real(2.0) * mu)
        return n_bar, real(0.0), theta_bar

    return PlasticFunctions(flow, flow_adjoint)


def flow(n: Tensor, tr: Tensor, params: dict[str, Tensor], dt: float) -> tuple[Tensor, Tensor]:
    """(a, b) of the trial state with |ê| = n."""
    mu, _ = moduli.lame(params)
    r = (2 / 3) ** 0.5 * params["yield_stress"] / (2 * mu)
    flows = n > r
    share = (n - r) / torch.where(flows, n, torch.ones_like(n))
    return torch.where(flows, share, torch.zeros_like(n)), torch.zeros_like(n)


LAW = Plastic(name="von_mises", params=(moduli.E, moduli.NU, YIELD_STRESS), build=build, flow=flow)
