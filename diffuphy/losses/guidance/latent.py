"""What the latent diffusion models of the Stable Diffusion family share: weights, text, latents, prediction,
guidance."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal, NamedTuple

import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from diffuphy.losses.schedules import timestep, variance_preserving
from diffuphy.models import choose, load_component, where


class Texts(NamedTuple):
    """Embedded words, the condition of a latent diffusion model."""

    positive: Tensor
    """What each sample should show, shape (B, L, D)."""
    negative: Tensor
    """What it should not show, shape (B, L, D)."""


class Networks(NamedTuple):
    """The frozen parts of one checkpoint that stay in memory."""

    unet: Any
    vae: Any


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


@dataclass(frozen=True)
class LatentDiffusion:
    """Base of the backends: loads a checkpoint component by component, on first use, where the samples are.

    The text encoder lives only while words are embedded: embeddings are kept, it is freed.
    """

    model: str = ""
    """Hub id, or a folder laid out the same way; ``auto`` is the first known one that is on this machine."""
    cfg: float = 100.0
    """Classifier-free guidance scale s in ε̂ = ε̂_neg + s (ε̂_pos − ε̂_neg); DreamFusion's 100 sharpens what small
    values blur."""
    negative: str = ""
    """Words to move away from, joined to those of the prompt."""
    dtype: Literal["float32", "float16", "bfloat16"] = "float16"
    """Of the denoiser and the text encoder. Latents, noise and ε̂ are float32."""
    revision: str | None = None
    """Commit of the hub repository, for results that can be repeated."""
    local_files_only: bool = field(default=False, metadata={"runtime": True})
    """Never ask the network, use what is on this machine."""

    unet_class = "UNet2DConditionModel"

    def __post_init__(self) -> None:
        object.__setattr__(self, "model", choose(self.model, type(self).model))
        if not self.model:
            raise ValueError(f"{type(self).__name__}.model is empty; give a hub id or a folder")
        if self.cfg < 0:
            raise ValueError(f"cfg must not be negative, got {self.cfg}")
        if self.dtype not in ("float32", "float16", "bfloat16"):
            raise ValueError(f"dtype must be float32, float16 or bfloat16, got {self.dtype!r}")

    @cached_property
    def _memory(self) -> dict[str, Any]:
        """Networks and embeddings: a cache, no setting."""
        return {}

    @property
    def backend(self) -> str:
        """Name of the configuration group's choice."""
        return type(self).__module__.rpartition(".")[2]

    # ------------------------------------------------------------------ weights
    def _load(self, load: Callable[..., Any], subfolder: str, **options: Any) -> Any:
        options |= where(self.revision, self.local_files_only)
        return load_component(load, self.model, subfolder, self.backend, **options)

    def noise(self) -> tuple[Tensor, str]:
        """ᾱ_k of the model's scheduler, shape (n,), float64, and what its network predicts."""
        if "noise" not in self._memory:
            from diffusers import DDIMScheduler

            scheduler = self._load(DDIMScheduler.from_pretrained, "scheduler")
            self._memory["noise"] = (scheduler.alphas_cumprod.double(), scheduler.config.prediction_type)
        return self._memory["noise"]

    def networks(self, device: torch.device) -> Networks:
        """Denoiser and autoencoder on ``device``, loaded on first use."""
        if "networks" not in self._memory:
            import diffusers

            unet = self._load(
                getattr(diffusers, self.unet_class).from_pretrained, "unet", dtype=getattr(torch, self.dtype)
            )
            vae = self._load(diffusers.AutoencoderKL.from_pretrained, "vae", dtype=torch.float32)
            self._memory["networks"] = Networks(*(module.eval().requires_grad_(False) for module in (unet, vae)))
        for module in self._memory["networks"]:
            module.to(device)  # costs nothing when it is there already
        return self._memory["networks"]

    # ------------------------------------------------------------------ text
    def embed(self, texts: Sequence[str], device: torch.device) -> Tensor:
        """Last hidden states of CLIP for each text, shape (n, 77, D), float32; remembered."""
        known = self._memory.setdefault("texts", {})
        if new := sorted(set(texts) - known.keys()):
            from transformers import CLIPTextModel, CLIPTokenizer

            tokenizer = self._load(CLIPTokenizer.from_pretrained, "tokenizer")
            encoder = self._load(CLIPTextModel.from_pretrained, "text_encoder", dtype=getattr(torch, self.dtype))
            encoder = encoder.eval().requires_grad_(False).to(device)
            length = tokenizer.model_max_length
            ids = tokenizer(
                new, padding="max_length", max_length=length, truncation=True, return_tensors="pt"
            ).input_ids
            with torch.no_grad():
                known |= dict(zip(new, encoder(ids.to(device)).last_hidden_state.float(), strict=True))
        return torch.stack([known[t] for t in texts]).to(device)

    def texts(self, positive: Sequence[str], negative: str, device: torch.device) -> Texts:
        """Embeddings of one positive text a sample and of the negative words of prompt and settings."""
        joined = ", ".join(w for w in (negative, self.negative) if w)
        embedded = self.embed([*positive, joined], device)
        return Texts(embedded[:-1], embedded[-1:].expand(len(positive), -1, -1))

    # ------------------------------------------------------------------ latents
    def encode_frames(self, frames: Tensor, side: int) -> Tensor:
        """Latents (n, C, h, w) of frames (n, H, W, 3) in [0, 1], resized to ``side``: posterior mean × scaling factor.

        The encoder keeps 0.4 GiB of activations for a 256 px frame; each frame is therefore encoded alone and again in
        the backward pass, which is exact and keeps one frame's at a time. It runs in float32: in float16 its gradient
        overflows.
        """
        vae = self.networks(frames.device).vae

        def encode(frame: Tensor) -> Tensor:
            return vae.encode(2 * frame[None] - 1).latent_dist.mode()[0] * vae.config.scaling_factor

        x = frames.float().permute(0, 3, 1, 2)
        if x.shape[-2:] != (side, side):
            x = torch.nn.functional.interpolate(x, (side, side), mode="bilinear", align_corners=False, antialias=True)
        alone = len(x) > 1 and x.requires_grad
        return torch.stack(
            [checkpoint(encode, f, use_reentrant=False, preserve_rng_state=False) if alone else encode(f) for f in x]
        )

    # ------------------------------------------------------------------ noise
    def schedule(self, t: Tensor) -> tuple[Tensor, Tensor]:
        """α_t = √ᾱ_k, σ_t = √(1 − ᾱ_k) of the model's own scheduler, k = ⌊n t⌋."""
        return variance_preserving(t, self.noise()[0])

    @torch.no_grad()
    def predict_noise(self, z_t: Tensor, t: Tensor, cond: Texts) -> Tensor:
        """ε̂ = ε̂_neg + cfg (ε̂_pos − ε̂_neg), combined in float32; one call of the network on both texts."""
        unet = self.networks(z_t.device).unet
        alpha_bar, prediction = self.noise()
        dtype = getattr(torch, self.dtype)
        k = timestep(t, len(alpha_bar)).to(z_t.device)
        text = torch.cat([cond.negative, cond.positive]).to(z_t.device, dtype)
        output = unet(torch.cat([z_t, z_t]).to(dtype), torch.cat([k, k]), encoder_hidden_states=text).sample.float()
        alpha, sigma = (a.to(z_t).view(-1, *[1] * (z_t.ndim - 1)) for a in self.schedule(t))
        negative, positive = (to_epsilon(o, z_t, alpha, sigma, prediction) for o in output.chunk(2))
        return negative + self.cfg * (positive - negative)
