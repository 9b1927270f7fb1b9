"""What may be asked of a material field, or of Gaussians, before any film is seen: smooth, decided, near the table; no
needles. Pure functions.

A caller whose weight is 0 does not call them. All are means over particles, so a weight means the same for any number.
"""

import math

import torch
from torch import Tensor


def total_variation(values: Tensor, neighbours: Tensor) -> Tensor:
    """Mean change of a field between neighbours.

        L = 1/(N K) Σ_i Σ_{j ∈ nbr(i)} |y_i − y_j|_1

    Total variation on a graph (Rudin, Osher & Fatemi 1992): unlike a squared difference it lets regions differ
    sharply and only counts the length of their border. For parameters that span decades give their logarithm.

    Args:
        values: field, one row per particle or group, shape (N,) or (N, C).
        neighbours: indices of the K neighbours of each row, shape (N, K), int64.
    """
    if neighbours.ndim != 2 or neighbours.shape[0] != values.shape[0]:
        raise ValueError(
            f"neighbours must be ({values.shape[0]}, K), one row per row of values, got {tuple(neighbours.shape)}"
        )
    y = values.reshape(values.shape[0], -1)
    return (y[:, None] - y[neighbours]).abs().sum(-1).mean()


def gate_entropy(w: Tensor) -> Tensor:
    """Mean entropy of the gates [nat]: 0 for one-hot rows, ln K for uniform ones.

        H = −1/N Σ_n Σ_c w_nc ln w_nc

    A weight that is exactly 0 contributes nothing and gets no gradient (the limit of w ln w; its slope there is
    infinite, and a gate with exact zeros does not move them). Early in training this term makes a fit commit to the
    wrong expert.

    Args:
        w: weights, rows on the simplex, shape (N, K).
    """
    w_safe = torch.where(w > 0, w, torch.ones_like(w))
    return -(w_safe * w_safe.log()).sum(-1).mean()


def log_prior(theta: Tensor, reference: Tensor | float, *, decades: float = 1.0) -> Tensor:
    """Squared distance of a positive parameter from its table value, in the logarithm.

        L = 1/N Σ_n ½ (log10 θ_n − log10 θ_ref)² / s²

    The negative log density of a log-normal prior around the table, without its constant.

    Args:
        theta: parameter [SI], shape (N,), positive.
        reference: table value, shape (N,) or a number, positive.
        decades: standard deviation s [decades].

    Raises:
        ValueError: for a value or a spread that is not positive.
    """
    reference = torch.as_tensor(reference, dtype=theta.dtype, device=theta.device)
    if decades <= 0 or not bool((theta.detach() > 0).all() and (reference > 0).all()):
        raise ValueError(
            f"log_prior needs positive theta, reference and decades, got minima {float(theta.detach().min()):g}, "
            f"{float(reference.min()):g} and {decades:g}; a parameter that may be 0 has no logarithmic prior"
        )
    distance = (theta.log() - reference.log()) / (math.log(10) * decades)
    return 0.5 * distance.square().mean()


def spread(values: Tensor, labels: Tensor) -> Tensor:
    """Mean over regions of the variance inside each.

        L = 1/R Σ_r Var{y_n : l_n = r}

    Args:
        values: field y, shape (N,); for a parameter that spans decades its logarithm.
        labels: region l of each value, 0 … R − 1, none empty, shape (N,).
    """
    return torch.stack([values[labels == r].var(correction=0) for r in range(int(labels.max()) + 1)]).mean()


def anisotropy(log_scales: Tensor, ratio: float) -> Tensor:
    """Mean excess of the longest over the shortest axis of Gaussians.

        L = 1/G Σ_g max(max S_g / min S_g, r) − r

    Xie et al., PhysGaussian (2024), section 3.6: needles and sheets fit the training pictures, and stick out of a body
    that deforms.

    Args:
        log_scales: logarithms of the standard deviations S, shape (G, 3).
        ratio: r, up to which Gaussians are let alone [-].

    Raises:
        ValueError: r below 1, which no Gaussian has.
    """
    if not ratio >= 1.0:
        raise ValueError(f"ratio must be at least 1, got {ratio}")
    longest, shortest = log_scales.amax(1), log_scales.amin(1)
    return ((longest - shortest).exp().clamp_min(ratio) - ratio).mean()
