"""A Bingham solid that melts: yield stress and viscosity fade as heat comes in.

    σ_Y(h) = σ_Y e^(−h),   η(h) = η e^(−h),   h' = h + Δt/t_melt ("heat", kept by the mixture)

otherwise as ``viscoplastic``. h stands for the progress of melting; 1/t_melt is its rate, so viscosity falls as in
Arrhenius' law linearised about the melting point. Carlson et al., Melting and flowing, SCA 2002, §5.
"""

import torch
import warp as wp
from torch import Tensor

from .. import moduli
from ..expert import Layout, Param, Plastic, PlasticFunctions
from . import viscoplastic
from .viscoplastic import VISCOSITY
from .von_mises import YIELD_STRESS

MELT_TIME = Param("melt_time", "s", 1e-2, 1e3, log=True, default=1.0)


def build(layout: Layout) -> PlasticFunctions:
    """Warp functions for one layout."""
    real, theta_t, memory_t = layout.real, layout.theta_t, layout.memory_t
    at, at_eta, at_heat = layout.at("yield_stress"), layout.at("viscosity"), layout.remembers("heat")
    at_E, at_nu = layout.at("E"), layout.at("nu")
    solid = viscoplastic.build(layout)

    @wp.func(module="unique")
    def melted(theta: theta_t, f: real) -> theta_t:
        """Parameters of the solid when a fraction f of its strength is left."""
        out = theta_t()
        out[at_E] = theta[at_E]
        out[at_nu] = theta[at_nu]
        out[at] = f * theta[at]
        out[at_eta] = f * theta[at_eta]
        return out

    @wp.func(module="unique")
    def flow(n: real, tr: real, theta: theta_t, dt: real, h: memory_t):
        a, b = solid.flow(n, tr, melted(theta, wp.exp(-h[at_heat])), dt)
        return a, b

    @wp.func(module="unique")
    def flow_adjoint(n: real, tr: real, theta: theta_t, dt: real, a_bar: real, b_bar: real, h: memory_t):
        f = wp.exp(-h[at_heat])
        n_bar, tr_bar, theta_bar = solid.flow_adjoint(n, tr, melted(theta, f), dt, a_bar, b_bar)
        sigma_bar = f * theta_bar[at]
        eta_bar = f * theta_bar[at_eta]
        theta_bar[at] = sigma_bar
        theta_bar[at_eta] = eta_bar
        h_bar = memory_t()
        h_bar[at_heat] = -(sigma_bar * theta[at] + eta_bar * theta[at_eta])
        return n_bar, tr_bar, theta_bar, h_bar

    return PlasticFunctions(flow, flow_adjoint)


def flow(
    n: Tensor, tr: Tensor, params: dict[str, Tensor], dt: float, memory: dict[str, Tensor]
) -> tuple[Tensor, Tensor]:
    """(a, b) of the trial state with |ê| = n after a step of dt [s], as far molten as memory["heat"]."""
    left = torch.exp(-memory["heat"])
    soft = {k: params[k] * left for k in ("yield_stress", "viscosity")}
    return viscoplastic.flow(n, tr, {**params, **soft}, dt)


LAW = Plastic(
    name="melting",
    params=(moduli.E, moduli.NU, YIELD_STRESS, VISCOSITY, MELT_TIME),
    build=build,
    flow=flow,
    memory=("heat",),
)
