"""Score distillation of images, views, clips and points: an estimator's residual, weighted and injected."""

from collections.abc import Callable
from typing import Any, Literal

import torch
from torch import Tensor

from diffuphy.losses.estimators import PLAIN, Estimator, coefficients
from diffuphy.losses.guidance import Guidance

Weight = Literal["sigma2", "x0", "unit"]

WEIGHTS: dict[str, Callable[[Tensor, Tensor], Tensor]] = {
    "sigma2": lambda alpha, sigma: sigma**2,
    "x0": lambda alpha, sigma: sigma / alpha,
    "unit": lambda alpha, sigma: torch.ones_like(sigma),
}
"""w(t) by name: DreamFusion's σ²; σ/α, which makes the gradient of SDS z − x̂₀ (MVDream, LucidDreamer); 1."""


class _Inject(torch.autograd.Function):
    """A scalar whose gradient is given: forward returns ``value``, backward hands ``grad`` to z."""

    @staticmethod
    def forward(ctx: Any, z: Tensor, grad: Tensor, value: Tensor) -> Tensor:
        ctx.save_for_backward(grad)
        return value.clone()

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, None, None]:
        (grad,) = ctx.saved_tensors
        return upstream * grad, None, None


def inject(z: Tensor, grad: Tensor, value: Tensor) -> Tensor:
    """The scalar ``value`` with ∂/∂z = ``grad``, of the shape of z."""
    return _Inject.apply(z, grad, value)


def sds(
    guidance: Guidance,
    sample: Tensor,
    cond: Any,
    *,
    t: Tensor,
    noise: Tensor | None = None,
    generator: torch.Generator | None = None,
    weight: Weight = "sigma2",
    estimator: Estimator = PLAIN,
) -> Tensor:
    """Scalar whose gradient with respect to ``sample`` is the score-distillation gradient.

        z = encode(sample),   ∂L/∂z = w(t) r,   r = ε̂(α_t z + σ_t ε; y, t) − ε for SDS

    Poole et al., DreamFusion (2023), eq. 3; DiffuPhyGS, eqs. 2 and 4. The gradient is injected, not obtained from the
    popular target ``(z − g).detach()``, which loses 18 % of it in float16 and 78 % in bfloat16. The value is
    mean(w ‖r‖²), the printed loss, whose true derivative would contain the network's Jacobian; it is for the log only.

    Args:
        sample: what was rendered, in ``guidance.layout``: images (B, H, W, 3) or a clip (1, T, H, W, 3) in [0, 1].
        cond: what ``guidance.condition(...)`` returned.
        t: diffusion time in (0, 1), shape (B,).
        noise: ε ~ N(0, I) of the shape of z; drawn from ``generator`` if None.
        generator: source of the noise; its device may differ from the sample's.
        weight: w(t), see ``WEIGHTS``.
        estimator: r, see ``estimators``.

    Raises:
        ValueError: t outside (0, 1) or not one per sample, an unknown weight, neither noise nor generator, an estimator
            that this guidance cannot answer.
        FloatingPointError: the guidance answered with a non-finite prediction.
    """
    z = guidance.encode(sample)
    gradient, value = score(
        guidance, z.detach(), cond, t=t, noise=noise, generator=generator, weight=weight, estimator=estimator
    )
    return inject(z, gradient, value)


@torch.no_grad()
def score(
    guidance: Guidance,
    z: Tensor,
    cond: Any,
    *,
    t: Tensor,
    noise: Tensor | None = None,
    generator: torch.Generator | None = None,
    weight: Weight = "sigma2",
    estimator: Estimator = PLAIN,
) -> tuple[Tensor, Tensor]:
    """∂L/∂z = w(t) r, the shape of z, and the value mean(w ‖r‖²), without any graph; see ``sds``, which injects it."""
    if weight not in WEIGHTS:
        raise ValueError(f"weight must be one of {', '.join(WEIGHTS)}, got {weight!r}")
    if t.shape != z.shape[:1] or not bool(((t > 0) & (t < 1)).all()):
        raise ValueError(f"t must hold {z.shape[0]} diffusion times in (0, 1), one per sample, got {t.tolist()}")
    if noise is None:
        if generator is None:
            raise ValueError("give noise or a torch.Generator: the noise is never drawn from global state")
        noise = torch.randn(z.shape, generator=generator, device=generator.device, dtype=z.dtype).to(z.device)
    residual = estimator(guidance, z, cond, t=t, noise=noise)
    if not torch.isfinite(residual).all():
        raise FloatingPointError(
            f"{type(guidance).__name__} predicted a non-finite noise at t = {[round(x, 4) for x in t.tolist()]}; "
            "run the model in float32 or bfloat16, or narrow the range of t"
        )
    w = WEIGHTS[weight](*coefficients(guidance, t, z))
    return w * residual, (w * residual**2).mean()
