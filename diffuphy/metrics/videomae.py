"""Another feature network of FVD: VideoMAE (Tong et al. 2022), which sees motion where I3D sees single frames.

Ge et al., On the content bias in Fréchet video distance (2024), argue for it.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from diffuphy.models import missing

MEAN, STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
"""Of the pictures that it was trained on."""


@dataclass(frozen=True)
class VideoMAE:
    """Mean over the last tokens of a VideoMAE encoder."""

    model: str = "MCG-NJU/videomae-base-finetuned-ssv2"
    """Hub id or folder of transformers; Something-Something is about what things do, Kinetics about scenes."""
    batch: int = 4
    """Clips at once."""

    frames = 16
    """Length of its clips."""

    def __post_init__(self) -> None:
        if self.batch < 1:
            raise ValueError(f"batch must be at least 1, got {self.batch}")

    def missing(self) -> str | None:
        return missing(self.model, {".": "transformers"}, "evaluate.video.model")

    @cached_property
    def _network(self) -> Any:
        from transformers import VideoMAEModel

        return VideoMAEModel.from_pretrained(self.model, local_files_only=True).eval().requires_grad_(False)

    @torch.no_grad()
    def __call__(self, clips: Tensor) -> Tensor:
        """Features (n, D) of clips (n, T, H, W, 3) in [0, 1].

        Raises:
            ValueError: another number of frames than the network takes.
        """
        network = self._network.to(clips.device)
        n, frames = clips.shape[:2]
        if frames != network.config.num_frames:
            raise ValueError(f"{self.model} takes clips of {network.config.num_frames} frames, got {frames}")
        side = network.config.image_size
        x = clips.float().flatten(0, 1).permute(0, 3, 1, 2)
        x = F.interpolate(x, (side, side), mode="bilinear", antialias=True, align_corners=False)
        mean, std = (x.new_tensor(c).view(3, 1, 1) for c in (MEAN, STD))
        x = ((x - mean) / std).view(n, frames, 3, side, side)
        return torch.cat([network(part).last_hidden_state.mean(1) for part in x.split(self.batch)])
