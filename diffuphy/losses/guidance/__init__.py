"""Priors that know what things look like or how they move; all answer one question: which noise is in this?"""

from collections.abc import Sequence
from typing import Any, Literal, Protocol, runtime_checkable

import torch
from torch import Tensor

from diffuphy.models import MissingWeights as MissingWeights
from diffuphy.types import Camera, Look, Motion

Layout = Literal["image", "views", "clip", "points"]
Part = Literal["positive", "negative", "empty"]
"""The words of a prompt, the words that are not wanted, no words."""


class Guidance(Protocol):
    """A diffusion prior. ε-, v- and flow-models all answer in ε; classifier-free guidance happens inside."""

    @property
    def layout(self) -> Layout:
        """What the caller renders: independent images, views judged together, one clip, or points."""
        ...

    # A prior of clips may declare ``frames_alone = True``: its ``encode`` treats every frame by itself, and keeps the
    # graph of one at a time. Without it, as for a causal video autoencoder, clips are encoded whole (``losses.video``).

    def condition(
        self, words: Look | Motion, camera: Camera, background: Tensor, *, generator: torch.Generator | None = None
    ) -> Any:
        """Everything ``predict_noise`` needs besides z_t and t.

        Args:
            words: what the sample should show.
            camera: the cameras of the sample.
            background: colour behind it, shape (3,).
            generator: source of a random part of the condition, if it has one.
        """
        ...

    def encode(self, sample: Tensor) -> Tensor:
        """z of a sample, differentiable, float32: images (B, H, W, 3) or a clip (1, T, H, W, 3) in [0, 1], or clouds
        (B, N, 6) of positions in the object's frame and colours in [0, 1]."""
        ...

    def schedule(self, t: Tensor) -> tuple[Tensor, Tensor]:
        """α_t and σ_t of z_t = α_t z + σ_t ε, each of shape (B,), for t in (0, 1)."""
        ...

    def predict_noise(self, z_t: Tensor, t: Tensor, cond: Any) -> Tensor:
        """ε̂(z_t; y, t), the shape of z_t."""
        ...


@runtime_checkable
class TextGuidance(Guidance, Protocol):
    """A prior that reads text, and can be asked for its answers to several texts apart: what CSD and ISM need."""

    def predict_parts(self, z_t: Tensor, t: Tensor, cond: Any, parts: Sequence[Part]) -> tuple[Tensor, ...]:
        """ε̂(z_t; ·, t) for each of the named texts, each the shape of z_t, in one call of the network."""
        ...


def view_words(camera: Camera) -> tuple[str, ...]:
    """Words for where each camera stands: "front view", "side view", "back view" or "overhead view".

    The front of an object faces +x. Overhead above 60° of elevation, front within 45° of azimuth, back beyond 135°:
    the limits of gsgen and threestudio (``prompt_processors/base.py``).
    """
    position = -torch.einsum("cji,cj->ci", camera.viewmats[:, :3, :3], camera.viewmats[:, :3, 3])
    azimuth = torch.atan2(position[:, 1], position[:, 0]).rad2deg().abs()
    elevation = torch.asin(position[:, 2] / position.norm(dim=1).clamp_min(1e-12)).rad2deg()
    words = []
    for a, e in zip(azimuth.tolist(), elevation.tolist(), strict=True):
        words.append("overhead view" if e > 60 else "front view" if a < 45 else "back view" if a > 135 else "side view")
    return tuple(words)
