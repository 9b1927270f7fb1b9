"""What video diffusion transformers share: text of a T5 encoder, an autoencoder that sees the clip as a whole."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import torch
from torch import Tensor

from diffuphy.losses.guidance import Layout, embeddings
from diffuphy.losses.guidance.latent import LatentDiffusion, Texts
from diffuphy.losses.guidance.recompute import Recomputed
from diffuphy.types import Camera, Look, Motion


@dataclass(frozen=True)
class ClipTransformer(LatentDiffusion):
    """Base of video priors with a transformer in latents of a 3D autoencoder, causal in time.

    The autoencoder turns 4 k + 1 frames into k + 1 latent ones; frames cannot be encoded one by one.
    """

    layout: ClassVar[Layout] = "clip"
    unet_folder: ClassVar[str] = "transformer"
    text_length: ClassVar[int | None] = 226
    """Tokens of a text, what the pipelines of diffusers pad to."""
    stride: ClassVar[int] = 16
    """Sides of a clip are multiples of this [px]: 8 of the autoencoder times 2 of the patches."""

    cfg: float = 30.0
    """Classifier-free guidance scale; between the 5 of sampling and the 100 of distillation, not tuned on real
    weights."""
    dtype: Literal["float32", "float16", "bfloat16"] = "bfloat16"
    """Of transformer and text encoder: they were trained in bfloat16, float16 overflows in T5."""
    size: int = 256
    """Side the frames are resized to [px], a multiple of 16."""
    embeddings: str | None = field(default=None, metadata={"runtime": True})
    """Folder where embedded texts are kept from run to run, so that the text encoder (about 10 GB) is loaded once for
    each text; None keeps them in memory only."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.size % self.stride:
            raise ValueError(f"size must be a positive multiple of {self.stride} px, got {self.size}")

    # ------------------------------------------------------------------ text
    def condition(
        self, words: Look | Motion, camera: Camera, background: Tensor, *, generator: torch.Generator | None = None
    ) -> Texts:
        """Embedding of the words; one clip is one sample, from one camera."""
        return self.texts([words.text], words.negative, background.device)

    def embed(self, texts: Sequence[str], device: torch.device) -> Tensor:
        """Last hidden states of the T5 encoder for each text, shape (n, text_length, D), float32; remembered, on the
        disk too if a folder is set."""
        known: dict[str, Tensor] = self._memory.setdefault("texts", {})
        assert self.text_length is not None
        store = embeddings.Folder(self.embeddings, self.model, self.revision, self.dtype, self.text_length)
        for text in set(texts) - known.keys():
            if (found := store.get(text)) is not None:
                known[text] = found
        if new := sorted(set(texts) - known.keys()):
            for text, states in zip(new, self._encode_text(new, device), strict=True):
                known[text] = states
                store.put(text, states)
        return torch.stack([known[t].to(device) for t in texts])

    @torch.no_grad()
    def _encode_text(self, texts: list[str], device: torch.device) -> Tensor:
        """Hidden states (n, text_length, D), float32, on the host; the encoder is freed afterwards."""
        import transformers

        tokenizer = self._load(transformers.AutoTokenizer.from_pretrained, "tokenizer")
        encoder = self._load(
            getattr(transformers, self.text_class).from_pretrained, "text_encoder", dtype=getattr(torch, self.dtype)
        )
        encoder = encoder.eval().requires_grad_(False).to(device)
        tokens = tokenizer(
            texts, padding="max_length", max_length=self.text_length, truncation=True, return_tensors="pt"
        )
        return self._hidden(encoder, tokens.input_ids.to(device), tokens.attention_mask.to(device)).float().cpu()

    def _hidden(self, encoder: Any, ids: Tensor, mask: Tensor) -> Tensor:
        """Hidden states as the model was trained with them, shape (n, text_length, D)."""
        raise NotImplementedError

    # ------------------------------------------------------------------ noise
    def rows(self, z_t: Tensor, time: Tensor, text: Tensor, labels: Tensor | None) -> dict[str, Tensor]:
        """What the transformer is given, a row for each sample and text."""
        return {"hidden_states": z_t, "timestep": time, "encoder_hidden_states": text}

    # ------------------------------------------------------------------ latents
    def encode(self, sample: Tensor) -> Tensor:
        """Latents of a clip (1, 4 k + 1, H, W, 3) in [0, 1], float32, differentiable.

        Raises:
            ValueError: not one clip, or a number of frames that the autoencoder cannot take.
        """
        name = type(self).__name__
        if sample.ndim != 5 or len(sample) != 1:
            raise ValueError(f"{name} takes one clip of shape (1, T, H, W, 3), got {tuple(sample.shape)}")
        frames = sample.shape[1]
        if frames % 4 != 1:
            fewer = 4 * ((frames - 1) // 4) + 1
            raise ValueError(
                f"{name} takes clips of 4 k + 1 frames (its autoencoder is causal, four frames to a latent one), got "
                f"{frames}; show it {fewer} or {fewer + 4}"
            )
        x = sample[0].float().permute(0, 3, 1, 2).contiguous()
        if x.shape[-2:] != (self.size, self.size):
            x = torch.nn.functional.interpolate(
                x, (self.size, self.size), mode="bilinear", align_corners=False, antialias=True
            )
        if not self.offload:
            return self._encoded(self.networks(sample.device).vae, x.movedim(0, 1))[None]
        return Recomputed.apply(x.movedim(0, 1)[None], self._encoded, lambda: self.use("vae", x.device))

    def _encoded(self, vae: Any, clip: Tensor) -> Tensor:
        """Latents of one clip (3, T, H, W) in [0, 1]."""
        return self._scaled(vae, vae.encode(2 * clip[None] - 1).latent_dist.mode())[0]

    def sight(self, count: int) -> tuple[int, ...]:
        """Shape of what the autoencoder sees at a time: the clip."""
        return (1, 3, 4 * ((count - 1) // 4) + 1, self.size, self.size)

    def _scaled(self, vae: Any, z: Tensor) -> Tensor:
        """Latents of the autoencoder in the units, and the order of axes, of the transformer."""
        raise NotImplementedError
