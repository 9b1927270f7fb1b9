"""What may be asked of a material field, or of Gaussians, before any film is seen: alike inside a region; no needles.
Pure functions.

A caller whose weight is 0 does not call them. All are means over particles, so a weight means the same for any number.
"""

import torch
from torch import Tensor


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
