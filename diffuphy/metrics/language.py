"""Does the film show what the words say? CLIPSIM, and the check for faces on every side."""

import torch
from torch import Tensor

from diffuphy.metrics.encoder import Encoder

TEMPERATURE = 100.0
"""Scale of cosines before the softmax: CLIP's own, at the end of its training (Radford et al. 2021, §2.3)."""

SIDES = ("front", "side", "back")


def clipsim(encoder: Encoder, rgb: Tensor, text: str) -> Tensor:
    """cos(CLIP(frame), CLIP(text)) of each frame, shape (T,); its mean is CLIPSIM.

    Neither times 100 nor cut at 0. Wu et al., GODIVA (2021); DiffuPhyGS, eq. 29.

    Args:
        rgb: frames in [0, 1], shape (T, H, W, 3).
    """
    return encoder.pictures(rgb) @ encoder.texts([text], rgb.device)[0]


def janus(encoder: Encoder, views: Tensor, subject: str) -> Tensor:
    """How likely CLIP takes each view for one from the front, the side and the back, shape (n, 3), rows sum to 1.

    Args:
        views: pictures (n, H, W, 3) in [0, 1].
        subject: the object, a noun phrase.
    """
    words = encoder.texts([f"a photo of the {side} of {subject}" for side in SIDES], views.device)
    return torch.softmax(TEMPERATURE * encoder.pictures(views) @ words.T, dim=1)


def front_everywhere(likely: Tensor, azimuth: Tensor) -> float:
    """Share of the views from behind that look most like the front; an object with one face has 0.

    Args:
        likely: of ``janus``, shape (n, 3).
        azimuth: where each view stands from the front [deg], shape (n,).

    Raises:
        ValueError: no view from behind (more than 135° from the front).
    """
    behind = (torch.remainder(azimuth + 180, 360) - 180).abs() > 135
    if not behind.any():
        raise ValueError(f"no view is from behind among the azimuths {azimuth.tolist()}")
    return float((likely[behind].argmax(1) == SIDES.index("front")).double().mean())
