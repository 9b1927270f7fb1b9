"""Estimators of score distillation: the residual of a prior's answers that a good sample has none of.

An estimator turns a latent into r with ∂L/∂z = w(t) r. What separates them is what they take from the prior's answer:
SDS the noise it was given, CSD the answer to unwanted words, ISM the prior's own answer a little earlier.
"""

import math
from dataclasses import dataclass
from typing import Any, Protocol

import torch
from torch import Tensor

from diffuphy.losses.guidance import Guidance, TextGuidance


class Estimator(Protocol):
    """A residual r whose weighted mean is the gradient of score distillation."""

    def check(self, guidance: Guidance) -> None:
        """Refuse a prior that cannot be asked what this estimator asks.

        Raises:
            ValueError: it cannot.
        """
        ...

    def __call__(self, guidance: Guidance, z: Tensor, cond: Any, *, t: Tensor, noise: Tensor) -> Tensor:
        """r, the shape of z.

        Args:
            z: latents without noise, shape (B, ...).
            cond: what ``guidance.condition(...)`` returned.
            t: diffusion time of each sample in (0, 1), shape (B,).
            noise: ε ~ N(0, I), the shape of z.
        """
        ...


@dataclass(frozen=True)
class SDS:
    """Score distillation sampling.

        r = ε̂(z_t; y, t) − ε,   z_t = α_t z + σ_t ε

    Poole et al., DreamFusion (2023), eq. 3. Works with every prior; wants classifier-free guidance near 100.
    """

    def check(self, guidance: Guidance) -> None:
        """Every prior will do."""

    def __call__(self, guidance: Guidance, z: Tensor, cond: Any, *, t: Tensor, noise: Tensor) -> Tensor:
        alpha, sigma = coefficients(guidance, t, z)
        return guidance.predict_noise(alpha * z + sigma * noise, t, cond) - noise


@dataclass(frozen=True)
class CSD:
    """Classifier score distillation.

        r = ε̂(z_t; y, t) − ε̂(z_t; y⁻, t)

    Yu et al., Text-to-3D with Classifier Score Distillation (2023): the implicit classifier alone, the limit of SDS
    for an infinite guidance scale. y⁻ are the negative words; without any, it is the unconditional answer. The
    guidance's ``cfg`` plays no part.
    """

    def check(self, guidance: Guidance) -> None:
        text_parts(guidance, "csd")

    def __call__(self, guidance: Guidance, z: Tensor, cond: Any, *, t: Tensor, noise: Tensor) -> Tensor:
        alpha, sigma = coefficients(guidance, t, z)
        prior = text_parts(guidance, "csd")
        positive, negative = prior.predict_parts(alpha * z + sigma * noise, t, cond, ("positive", "negative"))
        return positive - negative


@dataclass(frozen=True)
class ISM:
    """Interval score matching.

        r = ε̂(z_t; y, t) − ε̂(z_s; ∅, s),   s = t − δ,
        z_s from z, and z_t from z_s, by DDIM inversion: z_{t'} = α_{t'} (z_t − σ_t ε̂)/α_t + σ_{t'} ε̂,  ε̂ = ε̂(z_t; ∅, t)

    Liang et al., LucidDreamer (2024); inversion: Song et al., DDIM (2021). The path begins at the prior's
    first time, where the noise ε is nearly nothing, as in the authors' program. Needs no strong guidance: they use
    ``cfg`` 7.5 and w = σ/α (``weight="x0"``), and their annealed δ is constant here.
    """

    delta: float = 0.05
    """Interval δ; 50 of 1000 steps is the end of the authors' annealing."""
    step: float = 0.2
    """Longest step on the way to z_s; one call of the network with one text each. 200 of 1000 in the paper."""
    start: float = 0.0005
    """Time at which the path begins: inside the first of a thousand steps."""

    def __post_init__(self) -> None:
        if not 0 < self.delta < 1 or not 0 < self.step < 1 or not 0 < self.start < 1:
            raise ValueError(
                f"delta, step and start must lie in (0, 1), got {self.delta}, {self.step} and {self.start}; "
                "they are diffusion times, 0.05 is 50 of 1000 steps"
            )

    def check(self, guidance: Guidance) -> None:
        text_parts(guidance, "ism")

    def __call__(self, guidance: Guidance, z: Tensor, cond: Any, *, t: Tensor, noise: Tensor) -> Tensor:
        prior = text_parts(guidance, "ism")
        if not bool((t > self.start).all()):
            raise ValueError(f"t must exceed start = {self.start}, got {t.tolist()}; raise t_min or lower start")
        s = (t - self.delta).clamp_min(self.start)
        z_s, unconditional = self.invert(prior, z, cond, s=s, noise=noise)
        z_t = ddim(guidance, z_s, unconditional, s, t)
        return guidance.predict_noise(z_t, t, cond) - unconditional

    def invert(self, prior: TextGuidance, z: Tensor, cond: Any, *, s: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
        """z_s and ε̂(z_s; ∅, s). A sample that has arrived stays exactly where it is while others go on."""
        time = torch.full_like(s, self.start)
        alpha, sigma = coefficients(prior, time, z)
        z_s = alpha * z + sigma * noise
        steps = math.ceil((float(s.max()) - self.start) / self.step - 1e-6)  # s itself is rounded
        for k in range(1, steps + 1):
            later = s if k == steps else torch.minimum(torch.full_like(s, self.start + k * self.step), s)
            (answer,) = prior.predict_parts(z_s, time, cond, ("empty",))
            z_s, time = ddim(prior, z_s, answer, time, later), later
        (answer,) = prior.predict_parts(z_s, s, cond, ("empty",))
        return z_s, answer


PLAIN = SDS()
"""What is used unless another is asked for."""


def coefficients(guidance: Guidance, t: Tensor, z: Tensor) -> tuple[Tensor, Tensor]:
    """α_t and σ_t as factors of z, shape (B, 1, ...)."""
    alpha, sigma = guidance.schedule(t)
    return tuple(a.to(z).view(-1, *[1] * (z.ndim - 1)) for a in (alpha, sigma))  # type: ignore[return-value]


def ddim(guidance: Guidance, z: Tensor, epsilon: Tensor, t: Tensor, to: Tensor) -> Tensor:
    """z at the times ``to``, from z at the times ``t`` and its noise: the deterministic step, in either direction.

        z' = α' (z − σ ε̂)/α + σ' ε̂

    Song et al., DDIM (2021), eq. 12 with η = 0. Written so that a step from t to t is exactly nothing.
    """
    (alpha, sigma), (alpha_to, sigma_to) = (coefficients(guidance, x, z) for x in (t, to))
    ratio = alpha_to / alpha
    return ratio * z + (sigma_to - ratio * sigma) * epsilon


def text_parts(guidance: Guidance, estimator: str) -> TextGuidance:
    """The guidance, known to answer to several texts apart.

    Raises:
        ValueError: it does not.
    """
    if not isinstance(guidance, TextGuidance):
        raise ValueError(
            f"estimator={estimator} compares answers to different words, and {type(guidance).__name__} has no words; "
            "use estimator=sds, or a guidance that reads text, such as stable_diffusion or mvdream"
        )
    return guidance
