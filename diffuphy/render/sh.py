"""View-dependent colour: spherical harmonics of degree 0 to 3 in the basis of Kerbl et al. (2023)."""

import math
from functools import cache

import torch
from torch import Tensor

from diffuphy.types import N_SH, Camera

C0 = 0.28209479177387814
C1 = 0.4886025119029199
C2 = (1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396)
C3 = (
    -0.5900435899266435,
    2.890611442640554,
    -0.4570457994644658,
    0.3731763325901154,
    -0.4570457994644658,
    1.445305721320277,
    -0.5900435899266435,
)


def degree_of(sh: Tensor) -> int:
    """Degree of coefficients of shape (..., (degree + 1)², 3)."""
    by_count = {count: degree for degree, count in N_SH.items()}
    if sh.shape[-2] not in by_count:
        raise ValueError(f"sh must hold 1, 4, 9 or 16 coefficients (degree 0 to 3) a channel, got {sh.shape[-2]}")
    return by_count[sh.shape[-2]]


def basis(directions: Tensor, degree: int) -> Tensor:
    """Y_k of unit ``directions`` (..., 3), shape (..., (degree + 1)²)."""
    x, y, z = directions.unbind(-1)
    bands = [torch.full_like(x, C0)]
    if degree > 0:
        bands += [-C1 * y, C1 * z, -C1 * x]
    if degree > 1:
        xx, yy, zz = x * x, y * y, z * z
        bands += [C2[0] * x * y, C2[1] * y * z, C2[2] * (2 * zz - xx - yy), C2[3] * x * z, C2[4] * (xx - yy)]
    if degree > 2:
        bands += [
            C3[0] * y * (3 * xx - yy),
            C3[1] * x * y * z,
            C3[2] * y * (4 * zz - xx - yy),
            C3[3] * z * (2 * zz - 3 * xx - 3 * yy),
            C3[4] * x * (4 * zz - xx - yy),
            C3[5] * z * (xx - yy),
            C3[6] * x * (xx - 3 * yy),
        ]
    return torch.stack(bands, dim=-1)


def colors(sh: Tensor, means: Tensor, camera: Camera, F: Tensor | None = None) -> Tensor:
    """Colours seen by C cameras, shape (C, G, 3): rgb = max(0, ½ + Σ_k Y_k(polar(F)ᵀ d) sh_k), d from camera to
    Gaussian.

    A deformed Gaussian carries its colours with it: the direction of view is turned back by the rotation of F (Xie
    et al., PhysGaussian, 2024, section 3.4). At degree 0 directions and F are not looked at, and the views share one
    memory.

    Args:
        sh: (G, (degree + 1)², 3).
        means: (G, 3).
        F: (G, 3, 3), det F > 0.
    """
    degree = degree_of(sh)
    if degree == 0:
        return to_rgb(sh).clamp_min(0).expand(len(camera), -1, -1)
    view = camera.viewmats.to(means)
    eyes = -(view[:, :3, :3].mT @ view[:, :3, 3:])[..., 0]
    d = means - eyes[:, None]  # (C, G, 3)
    if F is not None:
        d = (polar(F).mT @ d[..., None])[..., 0]
    Y = basis(torch.nn.functional.normalize(d, dim=-1), degree)
    return (0.5 + torch.einsum("cgk,gkn->cgn", Y, sh)).clamp_min(0)


def from_rgb(rgb: Tensor) -> Tensor:
    """Coefficients of degree 0, shape (..., 1, 3), of colours (..., 3)."""
    return ((rgb - 0.5) / C0)[..., None, :]


def to_rgb(sh: Tensor) -> Tensor:
    """Colours (..., 3) of coefficients (..., K, 3) seen from nowhere in particular: ½ + C₀ sh₀, not clipped."""
    return 0.5 + C0 * sh[..., 0, :]


def cofactor(A: Tensor) -> Tensor:
    """Matrix of cofactors, det(A) A⁻ᵀ, of (..., 3, 3)."""
    a, b, c = A.unbind(-2)
    return torch.stack([torch.linalg.cross(b, c), torch.linalg.cross(c, a), torch.linalg.cross(a, b)], dim=-2)


def polar(F: Tensor) -> Tensor:
    """Rotation R of F = R U with U symmetric positive definite, for F (..., 3, 3) with det F > 0; differentiable.

    Newton's iteration R ← ½ (γ R + (γ R)⁻ᵀ) with γ = |det R|^(-1/3) (Higham, Functions of matrices, 2008, section 8.6):
    quadratic, and free of the division by differences of stretches that spoils the derivative of an SVD near F = 1.
    """
    R = F
    for _ in range(_polar_steps(F.dtype)):
        cof = cofactor(R)
        det = (R[..., 0, :] * cof[..., 0, :]).sum(-1)[..., None, None]
        g = det.detach().abs() ** (-1 / 3)
        R = 0.5 * (g * R + cof / (g * det))
    return R


def _polar_steps(dtype: torch.dtype) -> int:
    """Steps from a condition number of 1e6 to rounding: each halves the logarithm of the stretches until they are
    near 1."""
    return 8 + round(math.log2(-math.log10(torch.finfo(dtype).eps)))


@cache
def _sphere() -> tuple[Tensor, tuple[Tensor, ...]]:
    """32 fixed directions and, for each band, the pseudo-inverse of its basis on them, float64."""
    k = torch.arange(32, dtype=torch.float64)
    z = 1 - (2 * k + 1) / 32
    phi = (
        k * math.pi * (3 - math.sqrt(5))
    )  # golden angle: even over the sphere, so that the inverse is well conditioned
    r = torch.sqrt(1 - z * z)
    d = torch.stack([r * torch.cos(phi), r * torch.sin(phi), z], dim=-1)
    Y = basis(d, 3)
    return d, tuple(torch.linalg.pinv(Y[:, b * b : (b + 1) ** 2]) for b in range(4))


def rotate(sh: Tensor, R: Tensor) -> Tensor:
    """Coefficients of the rotated colour function f'(R d) = f(d): sh'_l = Y_l(D)⁺ Y_l(Rᵀ D) sh_l on fixed directions D.

    Each band is closed under rotation, so that the least squares are exact (the matrix is Wigner's, in this basis).

    Args:
        sh: (..., (degree + 1)², 3).
        R: rotations (..., 3, 3), broadcast against sh.
    """
    degree = degree_of(sh)
    if degree == 0:
        return sh
    directions, inverses = _sphere()
    Y = basis(directions.to(R) @ R, degree)  # rows of D R are Rᵀ d
    bands = [sh[..., :1, :]]
    for b in range(1, degree + 1):
        band = slice(b * b, (b + 1) ** 2)
        bands.append(inverses[b].to(R) @ Y[..., band] @ sh[..., band, :])
    bands[0] = bands[0].expand(*bands[1].shape[:-2], 1, 3)
    return torch.cat(bands, dim=-2)
