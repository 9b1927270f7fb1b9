"""Distances of two sets of clips in the space of a feature network."""

import torch
from torch import Tensor


def frechet(a: Tensor, b: Tensor) -> float:
    """Fréchet distance of two Gaussians that have the moments of two sets.

        d² = |μ_a − μ_b|² + tr(Σ_a + Σ_b − 2 (Σ_a^½ Σ_b Σ_a^½)^½)

    With Σ = XᵀX for the centred rows X/√(n−1), the last trace is the sum of the singular values of X_a X_bᵀ (polar
    decomposition, Σ^½ = U X): an n × n matrix, no matrix root, exact also where n is less than the number of features.
    Dowson & Landau (1982); Heusel et al. (2017); Unterthiner et al. (2018), where d² is called FVD.

    Args:
        a, b: features, shapes (n, D) and (m, D), n and m at least 2.

    Raises:
        ValueError: fewer than two rows, another number of features, or a feature that is not finite.
    """
    a, b = _check(a, b)
    mu_a, mu_b = a.mean(0), b.mean(0)
    X, Y = (a - mu_a) / (len(a) - 1) ** 0.5, (b - mu_b) / (len(b) - 1) ** 0.5
    if a.shape[1] < min(len(a), len(b)):  # as many columns are enough: QR keeps XᵀX
        X, Y = (torch.linalg.qr(Z, mode="r")[1] for Z in (X, Y))
    cross = torch.linalg.svdvals(X @ Y.mT).sum()
    return float((mu_a - mu_b).square().sum() + X.square().sum() + Y.square().sum() - 2 * cross)


def kernel(a: Tensor, b: Tensor) -> float:
    """Unbiased squared maximum mean discrepancy with k(x, y) = (x·y/D + 1)³: the KVD, KID of clips.

        Σ_{i≠j} k(a_i, a_j)/n(n−1) + Σ_{i≠j} k(b_i, b_j)/m(m−1) − 2 Σ k(a_i, b_j)/nm

    Its mean is 0 for two draws of one distribution whatever their size, where the Fréchet distance is biased upwards.
    Bińkowski et al., Demystifying MMD GANs (2018), eq. 4.
    """
    a, b = _check(a, b)

    def k(x: Tensor, y: Tensor) -> Tensor:
        return (x @ y.mT / x.shape[1] + 1) ** 3

    n, m = len(a), len(b)
    aa, bb = k(a, a), k(b, b)
    within = (aa.sum() - aa.trace()) / (n * (n - 1)) + (bb.sum() - bb.trace()) / (m * (m - 1))
    return float(within - 2 * k(a, b).mean())


def windows(clip: Tensor, length: int, stride: int = 1) -> Tensor:
    """All stretches of ``length`` frames of (T, ...), a view of shape (n, length, ...).

    Raises:
        ValueError: a clip shorter than that.
    """
    if len(clip) < length:
        raise ValueError(f"a clip of {len(clip)} frames has no stretch of {length}; film longer, or take fewer")
    return clip.unfold(0, length, stride).movedim(-1, 1)


def _check(a: Tensor, b: Tensor) -> tuple[Tensor, Tensor]:
    if a.ndim != 2 or b.ndim != 2 or a.shape[1] != b.shape[1] or min(len(a), len(b)) < 2:
        raise ValueError(f"need two sets of at least two feature vectors, got {tuple(a.shape)} and {tuple(b.shape)}")
    a, b = a.double(), b.double()
    if not (torch.isfinite(a).all() and torch.isfinite(b).all()):
        raise ValueError("a feature is not finite; look at the network and at the clips it was given")
    return a, b
