"""What Point-E is told: embeddings and hidden patches of CLIP (Radford et al. 2021)."""

from collections.abc import Sequence
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from diffuphy.models import MissingWeights, absent, place, require
from diffuphy.models.files import kind_of

SETTING = "fit.shape.guidance.clip"
"""Where another CLIP is named."""

MEAN, STD = (0.48145466, 0.4578275, 0.40821073), (0.26862954, 0.26130258, 0.27577711)
"""Of the pictures that CLIP was trained on, red, green, blue (openai/CLIP, ``clip.py``)."""


def loaded(cls: Any, model: str, revision: str | None = None, local_files_only: bool = False) -> Any:
    """``cls.from_pretrained(model)``; absence is one line that says what to do.

    Raises:
        MissingWeights: it is not on this machine and cannot be fetched.
    """
    parts = {".": kind_of(cls.from_pretrained) or "transformers"}
    require(model, parts, SETTING, revision=revision, local_files_only=local_files_only)
    try:
        return cls.from_pretrained(model, revision=revision, local_files_only=local_files_only)
    except OSError:
        if place(model, revision) is not None:  # present but unreadable: the library's own words say more
            raise
        raise MissingWeights(absent(model, SETTING, parts, revision)) from None


def prepared(rgb: Tensor, side: int) -> Tensor:
    """Normalised network input (n, 3, side, side) of square pictures (n, S, S, 3) in [0, 1], resized bicubically.

    Raises:
        ValueError: pictures that are not square: CLIP would see their middle only.
    """
    if rgb.shape[1] != rgb.shape[2]:
        raise ValueError(f"pictures for CLIP must be square, got {rgb.shape[2]}×{rgb.shape[1]} px")
    x = rgb.float().permute(0, 3, 1, 2)
    if x.shape[-1] != side:
        x = F.interpolate(x, (side, side), mode="bicubic", antialias=True, align_corners=False).clamp(0, 1)
    mean, std = (x.new_tensor(v).view(3, 1, 1) for v in (MEAN, STD))
    return (x - mean) / std


@torch.no_grad()
def text_vectors(texts: Sequence[str], model: str, device: torch.device, **where: Any) -> Tensor:
    """Unit embeddings of texts, shape (n, 768) of CLIP ViT-L/14; the network is loaded for them and freed.

    Args:
        model: hub id or folder of a CLIP in the layout of transformers.
        where: ``revision`` and ``local_files_only``.
    """
    from transformers import CLIPModel, CLIPTokenizer

    tokenizer, network = loaded(CLIPTokenizer, model, **where), loaded(CLIPModel, model, **where).eval().to(device)
    length = tokenizer.model_max_length
    words = tokenizer(list(texts), padding="max_length", max_length=length, truncation=True, return_tensors="pt")
    return F.normalize(network.get_text_features(words.input_ids.to(device)).pooler_output.float(), dim=-1)


@torch.no_grad()
def picture_features(rgb: Tensor, model: str, *, patches: bool, **where: Any) -> Tensor:
    """Unit embeddings (n, 768), or hidden patches (n, 256, 1024) before the last layer norm and without the class
    token, of pictures (n, S, S, 3) in [0, 1]."""
    from transformers import CLIPModel

    network = loaded(CLIPModel, model, **where).eval().to(rgb.device)
    x = prepared(rgb, network.config.vision_config.image_size)
    if patches:
        return network.vision_model(x).last_hidden_state[:, 1:].float()
    return F.normalize(network.get_image_features(x).pooler_output.float(), dim=-1)
