"""What the latent diffusion models of the Stable Diffusion family share: weights, text, latents, prediction,
guidance."""

import logging
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any, ClassVar, Literal, NamedTuple

import torch
from torch import Tensor

from diffuphy.losses.guidance import Layout, Part
from diffuphy.losses.guidance.memory import Footprint, footprint, gigabytes
from diffuphy.losses.guidance.prediction import rescale, to_epsilon
from diffuphy.losses.guidance.recompute import Recomputed
from diffuphy.losses.schedules import timestep, variance_preserving
from diffuphy.models import choose, load_component, where

log = logging.getLogger(__name__)
LOADING = threading.RLock()
"""Held while networks are loaded or, when offloaded, used: clips may be judged by several threads."""


class Texts(NamedTuple):
    """Embedded words, the condition of a latent diffusion model."""

    positive: Tensor
    """What each sample should show, shape (B, L, D)."""
    negative: Tensor
    """What it should not show, shape (B, L, D)."""
    empty: Tensor
    """No words, shape (B, L, D)."""
    labels: Tensor | None = None
    """What the denoiser is told of each sample besides words, shape (B, K): a camera, for instance."""


class Networks(NamedTuple):
    """The frozen parts of one checkpoint that stay in memory."""

    unet: Any
    vae: Any


@dataclass(frozen=True)
class LatentDiffusion:
    """Base of the backends: loads a checkpoint component by component, on first use, where the samples are.

    The text encoder lives only while words are embedded: embeddings are kept, it is freed.
    """

    model: str = ""
    """Hub id, or a folder laid out the same way; ``auto`` is the first known one that is on this machine."""
    size: int = 512
    """Side the frames are resized to [px], a multiple of 8."""
    cfg: float = 100.0
    """Classifier-free guidance scale s in ε̂ = ε̂_neg + s (ε̂_pos − ε̂_neg); DreamFusion's 100 sharpens what small
    values blur."""
    negative: str = ""
    """Words to move away from, joined to those of the prompt."""
    rescale: float = 0.0
    """Share φ of the prediction whose contrast is brought back to that without guidance (Lin et al. 2023); 0.7 there,
    0 is plain guidance."""
    dtype: Literal["float32", "float16", "bfloat16"] = "float16"
    """Of the denoiser and the text encoder. Latents, noise and ε̂ are float32."""
    chunk: int | None = field(default=None, metadata={"runtime": True})
    """Most rows (samples × texts) of one call of the denoiser; None: all at once. Fewer take less memory and more time,
    and round differently."""
    offload: bool = field(default=False, metadata={"runtime": True})
    """Keep denoiser and autoencoder in the host's memory, each on the device only while it computes."""
    revision: str | None = None
    """Commit of the hub repository, for results that can be repeated."""
    local_files_only: bool = field(default=False, metadata={"runtime": True})
    """Never ask the network, use what is on this machine."""

    layout: ClassVar[Layout] = "image"
    unet_class: ClassVar[str] = "UNet2DConditionModel"
    unet_folder: ClassVar[str] = "unet"
    vae_class: ClassVar[str] = "AutoencoderKL"
    text_class: ClassVar[str] = "CLIPTextModel"
    text_length: ClassVar[int | None] = None
    """Tokens of a text; None: what the text encoder says."""
    together: ClassVar[int] = 1
    """Rows that the denoiser judges as one sample."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "model", choose(self.model, type(self).model))
        if not self.model:
            raise ValueError(f"{type(self).__name__}.model is empty; give a hub id or a folder")
        if self.size < 8 or self.size % 8:
            raise ValueError(f"size must be a positive multiple of 8 px, got {self.size}")
        if self.cfg < 0 or not 0 <= self.rescale <= 1:
            raise ValueError(
                f"cfg must not be negative and rescale in [0, 1], got cfg = {self.cfg} and rescale = {self.rescale}"
            )
        if self.chunk is not None and (self.chunk < 1 or self.chunk % self.together):
            raise ValueError(
                f"chunk must be a positive multiple of {self.together}, the rows judged as one sample, got {self.chunk}"
            )
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

    def settings(self, subfolder: str) -> dict[str, Any]:
        """``config.json`` of one part of the checkpoint; nothing else of it is read."""
        from diffusers import UNet2DConditionModel

        # partial, which has no class: of any part, and whether its weights are there is not asked
        return dict(self._load(partial(UNet2DConditionModel.load_config), subfolder))

    def noise(self) -> tuple[Tensor, str]:
        """ᾱ_k of the model's scheduler, shape (n,), float64, and what its network predicts."""
        if "noise" not in self._memory:
            from diffusers import DDIMScheduler

            scheduler = self._load(DDIMScheduler.from_pretrained, "scheduler")
            self._memory["noise"] = (scheduler.alphas_cumprod.double(), scheduler.config.prediction_type)
        return self._memory["noise"]

    def networks(self, device: torch.device) -> Networks:
        """Denoiser and autoencoder, loaded on first use; on ``device``, unless they are offloaded."""
        with LOADING:
            if "networks" not in self._memory:
                import diffusers

                need = self.footprint(self.together)
                log.info("%s: at most %s on the device: %s", self.backend, gigabytes(need.peak), need.parts)
                unet = self.load_unet()
                vae = self._load(getattr(diffusers, self.vae_class).from_pretrained, "vae", dtype=torch.float32)
                self._memory["networks"] = Networks(*(module.eval().requires_grad_(False) for module in (unet, vae)))
        if not self.offload:
            for module in self._memory["networks"]:
                module.to(device)  # costs nothing when it is there already
        return self._memory["networks"]

    def skeleton(self, part: str) -> Any:
        """The network of one part ("unet", "vae", "text_encoder") without weights, on the default device ("meta"
        included)."""
        import diffusers
        import transformers

        if part == "text_encoder":
            kind = getattr(transformers, self.text_class)
            return kind(kind.config_class.from_dict(self.settings(part)))
        if part == "unet":
            return getattr(diffusers, self.unet_class).from_config(self.settings(self.unet_folder))
        return getattr(diffusers, self.vae_class).from_config(self.settings(part))

    def footprint(self, count: int) -> Footprint:
        """Memory that it takes to judge ``count`` pictures, or a clip of ``count`` frames; reads no weights."""
        return footprint(self, count)

    def load_unet(self) -> Any:
        """The denoiser, in ``dtype``."""
        import diffusers

        load = getattr(diffusers, self.unet_class).from_pretrained
        return self._load(load, self.unet_folder, dtype=getattr(torch, self.dtype))

    @contextmanager
    def use(self, name: Literal["unet", "vae"], device: torch.device) -> Iterator[Any]:
        """One network, on ``device`` for the time of a computation."""
        with LOADING if self.offload else nullcontext():
            module = getattr(self.networks(device), name).to(device)
            try:
                yield module
            finally:
                if self.offload:
                    module.to("cpu")

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
        embedded = self.embed([*positive, joined, ""], device)
        n = len(positive)
        return Texts(embedded[:n], *(e.expand(n, -1, -1) for e in embedded[n:, None]))

    # ------------------------------------------------------------------ latents
    def encode_frames(self, frames: Tensor, side: int) -> Tensor:
        """Latents (n, C, h, w) of frames (n, H, W, 3) in [0, 1], resized to ``side``: posterior mean × scaling factor.

        The encoder keeps 0.4 GiB of activations for a 256 px frame; each frame is therefore encoded alone and again in
        the backward pass, which is exact and keeps one frame's at a time. It runs in float32: in float16 its gradient
        overflows.
        """

        def encode(vae: Any, frame: Tensor) -> Tensor:
            return vae.encode(2 * frame[None] - 1).latent_dist.mode()[0] * vae.config.scaling_factor

        x = frames.float().permute(0, 3, 1, 2).contiguous()  # channels last, GroupNorm loses 1e-4 of a gradient
        if x.shape[-2:] != (side, side):
            x = torch.nn.functional.interpolate(x, (side, side), mode="bilinear", align_corners=False, antialias=True)
        if len(x) == 1 and not self.offload:  # one graph, which no other frame has to make room for
            return encode(self.networks(x.device).vae, x[0])[None]
        return Recomputed.apply(x, encode, lambda: self.use("vae", x.device))

    def sight(self, count: int) -> tuple[int, ...]:
        """Shape of what the autoencoder sees at a time, of ``count`` pictures or frames: one."""
        return (1, 3, self.size, self.size)

    def latent_shape(self, side: int) -> tuple[int, int, int]:
        """Channels, height and width of the latents of a frame of ``side`` pixels."""
        config = self.settings("vae")
        down = side // 2 ** (len(config["block_out_channels"]) - 1)
        return config["latent_channels"], down, down

    def latents(self, count: int) -> tuple[int, ...]:
        """Shape of z of ``count`` pictures, or of a clip of ``count`` frames."""
        channels, height, width = self.latent_shape(self.size)
        if self.layout == "clip":
            return (1, channels, count, height, width)
        return (count, channels, height, width)

    # ------------------------------------------------------------------ noise
    def schedule(self, t: Tensor) -> tuple[Tensor, Tensor]:
        """α_t = √ᾱ_k, σ_t = √(1 − ᾱ_k) of the model's own scheduler, k = ⌊n t⌋."""
        return variance_preserving(t, self.noise()[0])

    def predict_noise(self, z_t: Tensor, t: Tensor, cond: Texts) -> Tensor:
        """ε̂ = ε̂_neg + cfg (ε̂_pos − ε̂_neg), rescaled if asked for, in float32; one call of the network on both texts."""
        return self.guided(z_t, t, cond, self.cfg)

    @torch.no_grad()
    def guided(self, z_t: Tensor, t: Tensor, cond: Texts, cfg: float) -> Tensor:
        """ε̂ with a guidance scale of the caller's."""
        negative, positive = self.predict_parts(z_t, t, cond, ("negative", "positive"))
        guided = negative + cfg * (positive - negative)
        if not self.rescale:
            return guided
        alpha, sigma = (a.to(z_t).view(-1, *[1] * (z_t.ndim - 1)).expand_as(z_t) for a in self.schedule(t))
        joined = (a.reshape(-1, self.together, *z_t.shape[1:]) for a in (guided, positive, z_t, alpha, sigma))
        return rescale(*joined, self.rescale).view_as(z_t)

    @torch.no_grad()
    def predict_parts(self, z_t: Tensor, t: Tensor, cond: Texts, parts: Sequence[Part]) -> tuple[Tensor, ...]:
        """ε̂ for each of the named texts, in float32; one call, more with ``chunk``."""
        n, dtype = len(parts), getattr(torch, self.dtype)
        text = torch.cat([getattr(cond, part) for part in parts]).to(z_t.device, dtype)
        labels = None if cond.labels is None else torch.cat([cond.labels] * n).to(z_t.device, dtype)
        rows = self.rows(torch.cat([z_t] * n).to(dtype), torch.cat([self.clock(t)] * n).to(z_t.device), text, labels)
        size = self.chunk or n * len(z_t)
        with self.use("unet", z_t.device) as unet:
            output = [
                unet(**{k: v[i : i + size] for k, v in rows.items()}, **self.shared(unet, z_t)).sample.float()
                for i in range(0, n * len(z_t), size)
            ]
        return tuple(self.epsilon(o, z_t, t) for o in torch.cat(output).chunk(n))

    def clock(self, t: Tensor) -> Tensor:
        """Diffusion time as the denoiser counts it."""
        return timestep(t, len(self.noise()[0]))

    def rows(self, z_t: Tensor, time: Tensor, text: Tensor, labels: Tensor | None) -> dict[str, Tensor]:
        """What the denoiser is given, a row for each sample and text."""
        known = {"sample": z_t, "timestep": time, "encoder_hidden_states": text}
        return known if labels is None else known | {"class_labels": labels}

    def shared(self, denoiser: Any, z_t: Tensor) -> dict[str, Any]:
        """What it is given besides, the same for all rows."""
        return {}

    def epsilon(self, output: Tensor, z_t: Tensor, t: Tensor) -> Tensor:
        """ε̂ of what it answers, float32."""
        alpha, sigma = (a.to(z_t).view(-1, *[1] * (z_t.ndim - 1)) for a in self.schedule(t))
        return to_epsilon(output, z_t, alpha, sigma, self.noise()[1])
