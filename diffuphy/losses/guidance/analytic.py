"""The prior whose score is known in closed form: no weights, no GPU, exact tests."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, NamedTuple

import torch
from torch import Tensor

from diffuphy.losses.guidance import Layout
from diffuphy.losses.schedules import scaled_linear, variance_preserving
from diffuphy.types import Camera, Look, Motion


class Variants(NamedTuple):
    """What a sample may look like: the condition of ``Analytic``."""

    images: Tensor
    """K references for each of B samples, in [0, 1], shape (B, K, H, W, 3), or (1, K, T, H, W, 3) for clips."""
    logits: Tensor | None = None
    """Log-prior log π_k up to a constant, shape (K,); None for equal chances."""
    offset: tuple[int, int] = (0, 0)
    """Where the patch grid starts [px]; only ``mode="patch"`` looks at it."""


@dataclass(frozen=True)
class Analytic:
    """Exact score of an explicit distribution of reference pictures or clips, as a diffusion model would answer it.

        p(z) = Σ_k π_k N(z; r_k, s² I),   z_t = α z + σ ε,
        ε̂ = −σ ∇ log p_t(z_t) = σ (z_t − α Σ_k γ_k r_k) / (α² s² + σ²),
        γ_k ∝ π_k exp(−‖z_t − α r_k‖² / 2(α² s² + σ²)).

    A memorising prior by design: with one reference and s = 0 the noise cancels, ε̂ − ε = (α/σ)(z − r), and score
    distillation is a weighted least-squares reconstruction; with several, whole-picture posteriors are nearly hard and
    choose one of them; only ``mode="patch"`` (a local score machine: Kamb & Ganguli 2024) makes objects that are in no
    reference.
    """

    frames_alone: ClassVar[bool] = True

    references: Callable[..., tuple[Tensor, Tensor | None]] | None = None
    """``references(words, camera, background) -> (images (B, K, H, W, 3) in [0, 1], logits (K,))``; None when
    conditions are built by hand."""
    mode: Literal["joint", "independent", "patch"] = "joint"
    """Who shares the posterior γ: all samples of a batch (views of one object), each sample alone, or each patch
    alone."""
    patch: int = 8
    """Side of a patch [px]; must divide the picture. Smaller mixes more freely and holds together less."""
    s: float = 0.05
    """Width of each mode in z ∈ [−1, 1]. 0.05 is a grey level of 6/255: below what a Gaussian of the scene resolves."""
    layout: Layout = "views"
    """What is rendered for it."""

    def __post_init__(self) -> None:
        if self.mode not in ("joint", "independent", "patch"):
            raise ValueError(f"mode must be 'joint', 'independent' or 'patch', got {self.mode!r}")
        if self.s < 0:
            raise ValueError(f"s must not be negative, got {self.s}")
        if self.patch < 1:
            raise ValueError(f"patch must be at least 1 px, got {self.patch}")

    def condition(
        self, words: Look | Motion, camera: Camera, background: Tensor, *, generator: torch.Generator | None = None
    ) -> Variants:
        """The references for these words and cameras, and in patch mode a random start of the grid (needs
        ``generator``)."""
        if self.references is None:
            raise ValueError(
                "Analytic has no references; give references=..., or build the condition with Variants(images, logits)"
            )
        images, logits = self.references(words, camera, background)
        offset = (0, 0)
        if self.mode == "patch":
            if generator is None:
                raise ValueError(
                    "mode='patch' shifts its grid at random: call condition(..., generator=torch.Generator())"
                )
            oy, ox = torch.randint(0, self.patch, (2,), generator=generator, device=generator.device).tolist()
            offset = (oy, ox)
        return Variants(images, logits, offset)

    def encode(self, sample: Tensor) -> Tensor:
        """z = 2 x − 1; pixels are the latent. Halves become float32, float64 stays."""
        return 2 * (sample if sample.dtype == torch.float64 else sample.float()) - 1

    def schedule(self, t: Tensor) -> tuple[Tensor, Tensor]:
        """The variance-preserving schedule of Stable Diffusion, 1000 steps."""
        return variance_preserving(t, scaled_linear())

    def predict_noise(self, z_t: Tensor, t: Tensor, cond: Variants | tuple[Any, ...]) -> Tensor:
        """ε̂ = σ (z_t − α m) / (α² s² + σ²) with the posterior mean m = Σ_k γ_k r_k; never divides by a small number
        but σ² + α² s²."""
        images, logits, offset = Variants(*cond)
        r = 2 * images.to(z_t) - 1  # (B, K, ...)
        if r.shape[:1] + r.shape[2:] != z_t.shape:
            raise ValueError(f"references of shape {tuple(r.shape)} do not fit samples of shape {tuple(z_t.shape)}")
        alpha, sigma = (a.to(z_t).view(-1, *[1] * (z_t.ndim - 1)) for a in self.schedule(t))
        variance = alpha**2 * self.s**2 + sigma**2
        if self.mode == "patch":
            z_, r_ = self._patches(z_t, 1, offset), self._patches(r, 2, offset)  # (B, P, D), (B, K, P, D)
        else:
            z_, r_ = z_t.flatten(1)[:, None], r.flatten(2)[:, :, None]  # one patch: (B, 1, D), (B, K, 1, D)
        gamma = self._posterior(z_, r_, alpha.view(-1, 1, 1), variance.view(-1, 1, 1), logits)  # (B, K, P)
        m = torch.einsum("bkp,bkpd->bpd", gamma.to(z_t.dtype), r_)
        m = self._unpatch(m, z_t.shape, offset) if self.mode == "patch" else m.view_as(z_t)
        return sigma * (z_t - alpha * m) / variance

    def _posterior(self, z: Tensor, r: Tensor, alpha: Tensor, variance: Tensor, logits: Tensor | None) -> Tensor:
        """γ of shape (B, K, P). Squares are summed in float64: the softmax sees differences of sums over 10⁵ pixels."""
        distance = (z[:, None] - alpha[:, None] * r).square().sum(-1, dtype=torch.float64)
        log_gamma = -distance / (2 * variance.double())
        if self.mode == "joint":
            log_gamma = log_gamma.sum(0, keepdim=True)
        if logits is not None:
            log_gamma = log_gamma + logits.to(log_gamma).view(1, -1, 1)
        return torch.softmax(log_gamma, 1).expand(len(z), -1, -1)

    def _patches(self, x: Tensor, lead: int, offset: tuple[int, int]) -> Tensor:
        """``lead`` leading axes, then ([T,] H, W, 3) → (P, D): patches of a grid shifted by ``offset``, wrapped; a
        clip's span all frames."""
        h, w, c = x.shape[-3:]
        p = self.patch
        if h % p or w % p:
            raise ValueError(f"patch = {p} px must divide the picture, {w}×{h} px")
        x = torch.roll(x, offset, (-3, -2)).reshape(*x.shape[:lead], -1, h // p, p, w // p, p, c)
        x = x.movedim((lead + 1, lead + 3), (lead, lead + 1))  # (..., h/p, w/p, T, p, p, 3)
        return x.flatten(lead, lead + 1).flatten(lead + 1)

    def _unpatch(self, x: Tensor, shape: torch.Size, offset: tuple[int, int]) -> Tensor:
        """The inverse of ``_patches`` for one leading axis."""
        h, w, c = shape[-3:]
        p = self.patch
        x = x.reshape(len(x), h // p, w // p, -1, p, p, c).movedim((1, 2), (2, 4))
        return torch.roll(x.reshape(shape), (-offset[0], -offset[1]), (-3, -2))
