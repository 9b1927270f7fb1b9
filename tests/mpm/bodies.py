"""Small bodies of known material for the tests of this folder."""

import torch
from torch import Tensor

from diffuphy.types import MaterialField

RHO = 1000.0


def block(
    cells: tuple[float, float, float],
    dx: float,
    corner: tuple[float, float, float] = (0.0, 0.0, 0.0),
    per: int = 2,
    dtype: torch.dtype = torch.float64,
) -> tuple[Tensor, Tensor]:
    """Particles of a box of ``cells`` grid cells, ``per`` along each axis of a cell, and their volumes."""
    axes = [
        (torch.arange(round(c * per), dtype=dtype) + 0.5) / per * dx + o for c, o in zip(cells, corner, strict=True)
    ]
    x = torch.cartesian_prod(*axes)
    return x, torch.full((len(x),), (dx / per) ** 3, dtype=dtype)


def field(
    n: int,
    elastic: tuple[str, ...] = ("neo_hookean",),
    plastic: tuple[str, ...] = ("identity",),
    *,
    E: float = 1e5,
    nu: float = 0.3,
    rho: float = RHO,
    dtype: torch.dtype = torch.float64,
    **theta: float,
) -> MaterialField:
    """The same material everywhere, equal weights."""
    values = {"E": E, "nu": nu, "yield_stress": 1e3, "friction_angle": 30.0, "cohesion": 0.0, "viscosity": 10.0} | theta
    weights = [torch.full((n, len(k)), 1 / len(k), dtype=dtype) for k in (elastic, plastic)]
    return MaterialField(
        elastic,
        plastic,
        *weights,
        {k: torch.full((n,), v, dtype=dtype) for k, v in values.items()},
        torch.full((n,), rho, dtype=dtype),
    )


def rotation(axis: tuple[float, float, float], angle: float) -> Tensor:
    """Rotation matrix about an axis [rad]."""
    a = torch.tensor(axis, dtype=torch.float64)
    a = a / a.norm() * angle
    return torch.linalg.matrix_exp(
        torch.tensor([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]], dtype=torch.float64)
    )
