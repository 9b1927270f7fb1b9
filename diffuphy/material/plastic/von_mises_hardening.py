"""Von Mises plasticity with linear isotropic hardening, or softening (damage): metal, plasticine, clay that tears.

    strength   σ(ε) = max(σ_Y + H ε, r σ_Y),   ε: accumulated equivalent plastic strain ("slip")
    yield      s = 2μ |ê| > √(2/3) σ(ε)
    implicit   s' = 2μ |ê| (1 − a) = √(2/3) σ(ε'),   ε' = ε + √(2/3) a |ê|
               a = (s − √(2/3)(σ_Y + H ε)) / (|ê| (2μ + 2H/3)), or (s − √(2/3) r σ_Y)/s where that is less

H > 0 hardens. H < 0 softens down to the residual strength r σ_Y; below −3μ the strength falls faster than the matter
unloads, and it drops to the residual at once. H = 0 is ``von_mises``. Simo & Hughes, Computational Inelasticity (1998),
box 3.1, in Hencky strain.
"""

import torch
import warp as wp
from torch import Tensor

from .. import moduli
from ..expert import Layout, Param, Plastic, PlasticFunctions
from .von_mises import YIELD_STRESS

HARDENING = Param("hardening", "Pa", -1e6, 1e6, log=False, default=0.0)
RESIDUAL = Param("residual", "-", 0.0, 1.0, log=False, default=0.2)


def build(layout: Layout) -> PlasticFunctions:
    """Warp functions for one layout."""
    real, theta_t, memory_t = layout.real, layout.theta_t, layout.memory_t
    at, at_H, at_r = layout.at("yield_stress"), layout.at("hardening"), layout.at("residual")
    at_slip = layout.remembers("slip")
    m = moduli.build(layout)
    root = real((2.0 / 3.0) ** 0.5)
    nil, two, two_thirds = real(0.0), real(2.0), real(2.0 / 3.0)

    @wp.func(module="unique")
    def flow(n: real, tr: real, theta: theta_t, dt: real, h: memory_t):
        mu, _lam = m.lame(theta)
        s = two * mu * n
        line = root * (theta[at] + theta[at_H] * h[at_slip])
        least = root * theta[at_r] * theta[at]
        a = nil
        if s > wp.max(line, least):
            a = (s - least) / s
            stiff = two * mu + two_thirds * theta[at_H]
            if stiff > nil:
                a = wp.min(a, (s - line) / (n * stiff))
        return a, nil

    @wp.func(module="unique")
    def flow_adjoint(n: real, tr: real, theta: theta_t, dt: real, a_bar: real, b_bar: real, h: memory_t):
        mu, _lam = m.lame(theta)
        s = two * mu * n
        line = root * (theta[at] + theta[at_H] * h[at_slip])
        least = root * theta[at_r] * theta[at]
        stiff = two * mu + two_thirds * theta[at_H]
        n_bar = nil
        theta_bar = theta_t()
        h_bar = memory_t()
        if s > wp.max(line, least):
            if stiff > nil and (s - line) / (n * stiff) < (s - least) / s:  # a = 2μ/c − line/(n c),  c = 2μ + 2H/3
                d = real(1.0) / (n * stiff)
                line_bar = -a_bar * d
                n_bar = a_bar * line * d / n
                c_bar = -a_bar * (s - line) * d / stiff
                theta_bar = m.adjoint(theta, two * (a_bar / stiff + c_bar), nil)
                theta_bar[at] = root * line_bar
                theta_bar[at_H] = root * line_bar * h[at_slip] + two_thirds * c_bar
                h_bar[at_slip] = root * line_bar * theta[at_H]
            else:  # a = 1 − least/s
                s_bar = a_bar * least / (s * s)
                n_bar = two * mu * s_bar
                theta_bar = m.adjoint(theta, two * n * s_bar, nil)
                theta_bar[at] = -a_bar * root * theta[at_r] / s
                theta_bar[at_r] = -a_bar * root * theta[at] / s
        return n_bar, nil, theta_bar, h_bar

    return PlasticFunctions(flow, flow_adjoint)


def flow(
    n: Tensor, tr: Tensor, params: dict[str, Tensor], dt: float, memory: dict[str, Tensor]
) -> tuple[Tensor, Tensor]:
    """(a, b) of the trial state with |ê| = n and the accumulated strain memory["slip"]."""
    mu, _ = moduli.lame(params)
    root, H = (2 / 3) ** 0.5, params["hardening"]
    s = 2 * mu * n
    line = root * (params["yield_stress"] + H * memory["slip"])
    least = root * params["residual"] * params["yield_stress"]
    flows, stiff = s > torch.maximum(line, least), 2 * mu + 2 / 3 * H
    one = torch.ones_like(n)
    residual = (s - least) / torch.where(flows, s, one)
    linear = (s - line) / torch.where(flows & (stiff > 0), n * stiff, one)
    a = torch.where(stiff > 0, torch.minimum(residual, linear), residual)
    return torch.where(flows, a, torch.zeros_like(n)), torch.zeros_like(n)


LAW = Plastic(
    name="von_mises_hardening",
    params=(moduli.E, moduli.NU, YIELD_STRESS, HARDENING, RESIDUAL),
    build=build,
    flow=flow,
    memory=("slip",),
)
