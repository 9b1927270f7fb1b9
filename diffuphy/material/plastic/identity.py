"""No flow: the solid stays elastic.

z = s   (a = b = 0)
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
        return real(0.0), real(0.0)

    @wp.func(module="unique")
    def flow_adjoint(n: real, tr: real, theta: theta_t, dt: real, a_bar: real, b_bar: real):
        return real(0.0), real(0.0), theta_t()

    return PlasticFunctions(flow, flow_adjoint)


def flow(n: Tensor, tr: Tensor, params: dict[str, Tensor], dt: float) -> tuple[Tensor, Tensor]:
    """Nothing flows."""
    return torch.zeros_like(n), torch.zeros_like(n)


LAW = Plastic(name="identity", params=(), build=build, flow=flow, is_identity=True)
