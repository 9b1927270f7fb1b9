"""What the output of a denoiser says of the noise, and how guidance changes it."""

from torch import Tensor


def to_epsilon(output: Tensor, z_t: Tensor, alpha: Tensor, sigma: Tensor, prediction: str) -> Tensor:
    """ε̂ of a network's output, with z_t = α x₀ + σ ε.

        epsilon: ε̂,   v_prediction: v = α ε − σ x₀ ⇒ ε̂ = α v + σ z_t,   sample: ε̂ = (z_t − α x̂₀)/σ

    Salimans & Ho (2022), appendix D.

    Raises:
        ValueError: an unknown kind of prediction.
    """
    if prediction == "epsilon":
        return output
    if prediction == "v_prediction":
        return alpha * output + sigma * z_t
    if prediction == "sample":
        return (z_t - alpha * output) / sigma
    raise ValueError(f"prediction_type of the scheduler must be epsilon, v_prediction or sample, got {prediction!r}")


def rescale(guided: Tensor, positive: Tensor, z_t: Tensor, alpha: Tensor, sigma: Tensor, phi: float) -> Tensor:
    """ε̂ whose x̂₀ has the contrast of the prediction without guidance; strong guidance saturates colours.

        x̂ = (z_t − σ ε̂)/α,   x̂' = (φ std(x̂_pos)/std(x̂) + 1 − φ) x̂,   ε̂' = (z_t − α x̂')/σ

    Lin et al. (2023), section 3.4, on x̂₀ as in MVDream (Shi et al. 2024).

    Args:
        guided, positive: ε̂ with and without guidance, shape (B, ...); the standard deviation is over all but B.
        phi: share φ of the rescaled prediction.
    """
    own, target = ((z_t - sigma * e) / alpha for e in (guided, positive))
    dims = tuple(range(1, own.ndim))
    factor = phi * target.std(dims, keepdim=True) / own.std(dims, keepdim=True) + 1 - phi
    return guided + (alpha / sigma) * (1 - factor) * own
