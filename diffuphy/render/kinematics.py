"""How Gaussians deform with the matter they stand for."""

import torch
from torch import Tensor


def advance(covariance: Tensor, grad_v: Tensor, dt: float) -> Tensor:
    """Covariances (..., 3, 3) after a step in a velocity gradient: for matter whose F nobody keeps.

        Σ ← (1 + Δt ∇v) Σ (1 + Δt ∇v)ᵀ

    With the ∇v of the update F ← (1 + Δt ∇v) F this is F Σ₀ Fᵀ itself, and symmetric and positive definite whatever
    Δt. The form of PhysGaussian (Xie et al. 2024, section 3.4), Σ + Δt (∇v Σ + Σ ∇vᵀ), leaves out Δt² ∇v Σ ∇vᵀ: it is
    of first order, and no covariance any more where |Δt ∇v| comes near ½.

    Args:
        grad_v: velocity gradients (..., 3, 3) [1/s].
        dt: time step [s].
    """
    A = torch.eye(3).to(grad_v) + dt * grad_v
    return A @ covariance @ A.mT


def limit_stretch(F: Tensor, limit: float) -> Tensor:
    """F (G, 3, 3) with its singular values cut at ``limit``."""
    return limited(F, limit)[0]


def limited(F: Tensor, limit: float) -> tuple[Tensor, int]:
    """F (G, 3, 3) with its singular values cut at ``limit``, and of how many it had to be."""
    # no singular value exceeds the Frobenius norm: most need no decomposition
    far = torch.linalg.matrix_norm(F) > limit
    if not far.any():
        return F, 0
    U, S, V = torch.linalg.svd(F[far])
    F = F.clone()
    F[far] = (U * S.clamp_max(limit)[:, None]) @ V
    return F, int((S[:, 0] > limit).sum())
