"""Clips: CogVideoX (Yang et al. 2024). The 2b model is Apache-2.0, the 5b models have a licence of their own."""

from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from diffuphy.losses.guidance.clip_transformer import ClipTransformer


@dataclass(frozen=True)
class CogVideoX(ClipTransformer):
    """Video prior that predicts v on a schedule with shifted signal-to-noise ratio and no signal at its end."""

    vae_class: ClassVar[str] = "AutoencoderKLCogVideoX"
    unet_class: ClassVar[str] = "CogVideoXTransformer3DModel"
    text_class: ClassVar[str] = "T5EncoderModel"

    model: str = "zai-org/CogVideoX-2b"
    """Hub id or folder."""

    def _hidden(self, encoder: Any, ids: Tensor, mask: Tensor) -> Tensor:
        """All states: the model was trained without a mask."""
        return encoder(ids)[0]

    def _scaled(self, vae: Any, z: Tensor) -> Tensor:
        """Latents (1, F, C, h, w): the transformer has frames before channels."""
        return z.transpose(1, 2) * vae.config.scaling_factor

    def noise(self) -> tuple[Tensor, str]:
        """ᾱ_k of the model's scheduler, shape (n,), float64, and what its network predicts."""
        if "noise" not in self._memory:
            from diffusers import CogVideoXDDIMScheduler

            scheduler = self._load(CogVideoXDDIMScheduler.from_pretrained, "scheduler")
            self._memory["noise"] = (scheduler.alphas_cumprod.double(), scheduler.config.prediction_type)
        return self._memory["noise"]

    def shared(self, denoiser: Any, z_t: Tensor) -> dict[str, Any]:
        """Rotary angles of the 5b models; the 2b one has none."""
        if not denoiser.config.use_rotary_positional_embeddings:
            return {}
        known = self._memory.setdefault("rotary", {})
        if (key := (z_t.shape[1], z_t.device)) not in known:
            known[key] = self._rotary(denoiser.config, *key)
        return {"image_rotary_emb": known[key]}

    def latents(self, count: int) -> tuple[int, ...]:
        """(1, (T + 3)/4, C, size/8, size/8)."""
        channels, height, width = self.latent_shape(self.size)
        return (1, (count + 3) // 4, channels, height, width)

    def _rotary(self, config: Any, frames: int, device: torch.device) -> tuple[Tensor, Tensor]:
        """Cosines and sines of the angles of all patches."""
        from diffusers.models.embeddings import get_3d_rotary_pos_embed

        p, p_t = config.patch_size, config.patch_size_t
        side, width, height = self.size // (8 * p), config.sample_width // p, config.sample_height // p
        if p_t is not None:  # 1.5: the first part of the largest clip
            if frames % p_t:
                raise ValueError(
                    f"{self.model} joins {p_t} latent frames in a patch and was given {frames}; "
                    f"show it {4 * p_t * (frames // p_t + 1) - 3} frames"
                )
            where = {"temporal_size": -(-frames // p_t), "grid_type": "slice", "max_size": (height, width)}
            corners = None
        else:  # a square as high as the clips of the training, in their middle
            where, left = {"temporal_size": frames}, round((width - height) / 2)
            corners = ((0, left), (height, left + height))
        angles: Any = get_3d_rotary_pos_embed(
            embed_dim=config.attention_head_dim, crops_coords=corners, grid_size=(side, side), device=device, **where
        )
        return angles
