"""Stress of the matter of a film, from the elastic deformation and the laws that its particles follow."""

import torch
from torch import Tensor

from diffuphy.types import MaterialField


def cauchy(Fe: Tensor, J: Tensor, field: MaterialField) -> Tensor:
    """Principal Cauchy stresses σ_i = T_i/J [Pa], shape (N, 3), in no order.

        T = Σ_k w_k T^k(ln s),   s = singular values of Fe

    Laws are isotropic: the mixture's Kirchhoff stress is diagonal in the frame of Fe Feᵀ (``material.mixture``). A
    viscous branch relaxes and is not in it. Strains below 1e-7 are lost where Fe is float32.

    Args:
        Fe: elastic deformation gradients, det Fe > 0, shape (N, 3, 3).
        J: det of the total deformation gradient, over which stress per rest volume becomes stress, shape (N,).

    Raises:
        ValueError: det Fe ≤ 0, or a field of another number of particles.
    """
    from diffuphy.material.elastic import ELASTIC
    from diffuphy.material.reference import decompose

    if len(field) != len(Fe):
        raise ValueError(f"Fe is that of {len(Fe)} particles, the material that of {len(field)}; give those of one run")
    e = decompose(Fe)[1]
    theta = {name: value.to(e) for name, value in field.theta.items()}
    T = torch.zeros_like(e)
    for k, name in enumerate(field.elastic):
        w = 1.0 if len(field.elastic) == 1 else field.w_e[:, k : k + 1].to(e)
        T = T + w * ELASTIC[name].stress(e, theta)
    return T / J[:, None]


def von_mises(sigma: Tensor) -> Tensor:
    """Equivalent stress √(½ Σ_{i<j} (σ_i − σ_j)²) [Pa], shape (...,), of principal stresses (..., 3)."""
    return ((sigma - sigma.roll(1, -1)).square().sum(-1) / 2).sqrt()
