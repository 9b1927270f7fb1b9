"""Rotations and covariances of Gaussians, volumes of matter."""

import math

import torch
from torch import Tensor


def rotations(quats: Tensor) -> Tensor:
    """Matrices R, shape (..., 3, 3), of quaternions wxyz, shape (..., 4), of any length but zero."""
    w, x, y, z = torch.nn.functional.normalize(quats, dim=-1).unbind(-1)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return torch.stack([torch.stack(row, dim=-1) for row in rows], dim=-2)


def covariances(quats: Tensor, scales: Tensor, F: Tensor | None = None) -> Tensor:
    """Σ = F R S² Rᵀ Fᵀ, shape (..., 3, 3), in the unit of ``scales`` squared.

    Args:
        quats: orientations wxyz, shape (..., 4). scales: standard deviations, shape (..., 3).
        F: deformation gradients, shape (..., 3, 3); the identity when left out.
    """
    M = rotations(quats) * scales[..., None, :]
    if F is not None:
        M = F @ M
    return M @ M.mT


def log_covariances(quats: Tensor, log_scales: Tensor, *, thinnest: float = 1e-3) -> Tensor:
    """ln Σ = R diag(2 ln s) Rᵀ, shape (..., 3, 3), of the natural logarithm of a length squared.

    Arsigny et al. (2006). Twice as large and half as large are equally far, and turning the Gaussian turns the matrix
    to rounding, however thin it is: the logarithm of a rounded Σ does not.

    Args:
        quats: orientations wxyz, shape (..., 4). log_scales: ln s, shape (..., 3).
        thinnest: an extent below this part of the largest counts as this part: a disc has a finite logarithm.
    """
    R = rotations(quats)
    floor = log_scales.amax(-1, keepdim=True) + math.log(thinnest)
    return (R * (2 * torch.maximum(log_scales, floor))[..., None, :]) @ R.mT


KNOWN = 1e-3
"""Rounding of det F over det F up to which it is believed [-]."""


def volume_ratio(F: Tensor, Fe: Tensor | None = None) -> Tensor:
    """Volume over rest volume J = det F, of F (..., 3, 3), in float64.

    A product of many steps is rounded in each; det F of it to ε |F| |cof F|. What flows shears on and on until that is
    all there is: then J is det Fe, the volume that the matter itself feels. It is the same for flow that keeps volume.

    Args:
        F: total deformation gradients. Fe: their elastic part; None where nothing flows.
    """
    G = F.double()
    a, b, c = G.unbind(-2)
    cofactor = torch.stack([torch.linalg.cross(b, c), torch.linalg.cross(c, a), torch.linalg.cross(a, b)], -2)
    J = (a * cofactor[..., 0, :]).sum(-1)
    if Fe is None:
        return J
    elastic = torch.linalg.det(Fe.double())
    rounding = torch.finfo(F.dtype).eps * torch.linalg.matrix_norm(G) * torch.linalg.matrix_norm(cofactor)
    return torch.where(rounding <= KNOWN * elastic, J, elastic)
