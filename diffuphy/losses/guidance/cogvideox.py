"""Clips: CogVideoX (Yang et al. 2024). The 2b model is Apache-2.0, the 5b models have a licence of their own."""

from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from diffuphy.losses.guidance.clip_transformer import ClipTransformer
from diffuphy.losses.guidance.latent import Texts, to_epsilon
from diffuphy.losses.schedules import timestep


@dataclass(frozen=True)
class CogVideoX(ClipTransformer):
    """Video prior that predicts v on a schedule with shifted signal-to-noise ratio and no signal at its end."""

    autoencoder_class: ClassVar[str] = "AutoencoderKLCogVideoX"
    transformer_class: ClassVar[str] = "CogVideoXTransformer3DModel"
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

    def _rotary(self, transformer: Any, frames: int, device: torch.device) -> tuple[Tensor, Tensor] | None:
        """Rotary angles of the 5b models, None for the 2b one."""
        config = transformer.config
        if not config.use_rotary_positional_embeddings:
            return None
        from diffusers.models.embeddings import get_3d_rotary_pos_embed

        side, p = self.size // (8 * config.patch_size), config.patch_size
        width, height = config.sample_width // p, config.sample_height // p
        if config.patch_size_t is not None:  # 1.5: a slice of the largest clip
            return get_3d_rotary_pos_embed(
                embed_dim=config.attention_head_dim,
                crops_coords=None,
                grid_size=(side, side),
                temporal_size=(frames + config.patch_size_t - 1) // config.patch_size_t,
                grid_type="slice",
                max_size=(height, width),
                device=device,
            )
        # a square as high as the clips of the training, in their middle
        left = round((width - height) / 2)
        return get_3d_rotary_pos_embed(
            embed_dim=config.attention_head_dim,
            crops_coords=((0, left), (height, left + height)),
            grid_size=(side, side),
            temporal_size=frames,
            device=device,
        )

    @torch.no_grad()
    def predict_noise(self, z_t: Tensor, t: Tensor, cond: Texts) -> Tensor:
        """ε̂ = ε̂_neg + cfg (ε̂_pos − ε̂_neg), combined in float32; one call of the network on both texts."""
        transformer = self.networks(z_t.device).unet
        alpha_bar, prediction = self.noise()
        dtype = getattr(torch, self.dtype)
        k = timestep(t, len(alpha_bar)).to(z_t.device)
        output = transformer(
            hidden_states=torch.cat([z_t, z_t]).to(dtype),
            timestep=torch.cat([k, k]),
            encoder_hidden_states=torch.cat([cond.negative, cond.positive]).to(z_t.device, dtype),
            image_rotary_emb=self._rotary(transformer, z_t.shape[1], z_t.device),
            return_dict=False,
        )[0].float()
        alpha, sigma = (a.to(z_t).view(-1, 1, 1, 1, 1) for a in self.schedule(t))
        negative, positive = (to_epsilon(o, z_t, alpha, sigma, prediction) for o in output.chunk(2))
        return negative + self.cfg * (positive - negative)
