"""Fluid: shape is forgotten at once, volume is kept.

    z_i = J^⅓,   M(F) = J^⅓ U Vᵀ   (k = 0, m = tr/3; a = 1, b = 0)

The rotation U Vᵀ is kept: J^⅓ I would not be objective (the stress is the same, but what rides on F is not).
With any elastic law the stress is then a pressure p(J) alone. Stomakhin et al., ACM TOG 33 (2014), §3.
"""

import torch
import warp as wp
from torch import Tensor

from ..expert import Layout, Plastic, PlasticFunctions


def build(layout: Layout) -> PlasticFunctions:
    """Warp functions for one layout."""
    real, theta_t = layout.real, layout.theta_t

    @wp.func(module="unique")
    def flow(n: real, tr: real, theta: theta_t, dt: real):
        return real(1.0), real(0.0)

    @wp.func(module="unique")
    def flow_adjoint(n: real, tr: real, theta: theta_t, dt: real, a_bar: real, b_bar: real):
        return real(0.0), real(0.0), theta_t()

    return PlasticFunctions(flow, flow_adjoint)


def flow(n: Tensor, tr: Tensor, params: dict[str, Tensor], dt: float) -> tuple[Tensor, Tensor]:
    """All of the shape flows, none of the volume."""
    return torch.ones_like(n), torch.zeros_like(n)


LAW = Plastic(name="fluid", params=(), build=build, flow=flow)
