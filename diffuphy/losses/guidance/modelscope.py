"""Clips: ModelScope text-to-video (Wang et al. 2023), the video prior of the paper. Its weights are CC-BY-NC-4.0."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from diffuphy.losses.guidance import Layout
from diffuphy.losses.guidance.latent import LatentDiffusion, Texts
from diffuphy.types import Camera, Look, Motion


@dataclass(frozen=True)
class ModelScope(LatentDiffusion):
    """Video prior; frames are encoded one by one and denoised together."""

    layout: ClassVar[Layout] = "clip"
    frames_alone: ClassVar[bool] = True
    unet_class: ClassVar[str] = "UNet3DConditionModel"

    model: str = "ali-vilab/text-to-video-ms-1.7b"
    """Hub id or folder."""
    size: int = 256
    """Side the frames are resized to [px], a multiple of 8: what the model was trained on."""

    def condition(
        self, words: Look | Motion, camera: Camera, background: Tensor, *, generator: torch.Generator | None = None
    ) -> Texts:
        """Embedding of the words; one clip is one sample, from one camera."""
        return self.texts([words.text], words.negative, background.device)

    def encode(self, sample: Tensor) -> Tensor:
        """Latents (1, 4, T, size/8, size/8) of a clip (1, T, H, W, 3) in [0, 1], float32, differentiable."""
        if sample.ndim != 5 or len(sample) != 1:
            raise ValueError(f"ModelScope takes one clip of shape (1, T, H, W, 3), got {tuple(sample.shape)}")
        return self.encode_frames(sample[0], self.size).movedim(0, 1)[None]
