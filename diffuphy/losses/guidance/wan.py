"""Clips: Wan 2.1 text-to-video (Wan team 2025), a flow model with a permissive licence (Apache-2.0)."""

from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from diffuphy.losses.guidance.clip_transformer import ClipTransformer
from diffuphy.losses.schedules import rectified_flow


@dataclass(frozen=True)
class Wan(ClipTransformer):
    """Video prior of straight paths from picture to noise.

        z_σ = (1 − σ) z + σ ε,   v = ε − z   ⇒   ε̂ = z_σ + (1 − σ) v̂

    Lipman et al. (2023); Esser et al. (2024), §2. σ is the diffusion time shifted as in the model's scheduler.
    """

    vae_class: ClassVar[str] = "AutoencoderKLWan"
    unet_class: ClassVar[str] = "WanTransformer3DModel"
    text_class: ClassVar[str] = "UMT5EncoderModel"

    model: str = "Wan-AI/Wan2.1-T2V-1.3B-Diffusers"
    """Hub id or folder."""

    def _hidden(self, encoder: Any, ids: Tensor, mask: Tensor) -> Tensor:
        """States of the words, zero behind them: the transformer knows no mask."""
        return encoder(ids, mask).last_hidden_state * mask[..., None]

    def _scaled(self, vae: Any, z: Tensor) -> Tensor:
        mean, std = (torch.tensor(v, device=z.device).view(1, -1, 1, 1, 1) for v in (
            vae.config.latents_mean, vae.config.latents_std
        ))  # fmt: skip
        return (z - mean) / std

    def shift(self) -> float:
        """s of σ = s t/(1 + (s − 1) t), from the model's scheduler."""
        if "shift" not in self._memory:
            from diffusers import FlowMatchEulerDiscreteScheduler

            known = self._load(FlowMatchEulerDiscreteScheduler.load_config, "scheduler")
            self._memory["shift"] = float(known.get("flow_shift", known.get("shift", 1.0)))
        return self._memory["shift"]

    def schedule(self, t: Tensor) -> tuple[Tensor, Tensor]:
        """α = 1 − σ and σ = s t/(1 + (s − 1) t)."""
        return rectified_flow(t, self.shift())

    def clock(self, t: Tensor) -> Tensor:
        """1000 σ: the network counts training steps."""
        return 1000 * self.schedule(t)[1]

    def epsilon(self, output: Tensor, z_t: Tensor, t: Tensor) -> Tensor:
        """ε̂ = z_σ + (1 − σ) v̂."""
        return z_t + self.schedule(t)[0].to(z_t).view(-1, 1, 1, 1, 1) * output

    def latents(self, count: int) -> tuple[int, ...]:
        """(1, 16, (T + 3)/4, size/8, size/8)."""
        side = self.size // 8
        return (1, self.settings("vae")["z_dim"], (count + 3) // 4, side, side)
