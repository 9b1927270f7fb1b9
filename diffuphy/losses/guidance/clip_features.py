"""What Point-E is told: embeddings and hidden patches of CLIP (Radford et al. 2021)."""

from collections.abc import Sequence
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from diffuphy.models import load_component

MEAN, STD = (0.48145466, 0.4578275, 0.40821073), (0.26862954, 0.26130258, 0.27577711)
"""Of the pictures that CLIP was trained on, red, green, blue (openai/CLIP, ``clip.py``)."""


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

    tokenizer = load_component(CLIPTokenizer.from_pretrained, model, "", "point_e", **where)
    network = load_component(CLIPModel.from_pretrained, model, "", "point_e", **where).eval().to(device)
    length = tokenizer.model_max_length
    words = tokenizer(list(texts), padding="max_length", max_length=length, truncation=True, return_tensors="pt")
    return F.normalize(network.get_text_features(words.input_ids.to(device)).pooler_output.float(), dim=-1)


@torch.no_grad()
def picture_features(rgb: Tensor, model: str, *, patches: bool, **where: Any) -> Tensor:
    """Unit embeddings (n, 768), or hidden patches (n, 256, 1024) before the last layer norm and without the class
    token, of pictures (n, S, S, 3) in [0, 1]."""
    from transformers import CLIPModel

    network = load_component(CLIPModel.from_pretrained, model, "", "point_e", **where).eval().to(rgb.device)
    x = prepared(rgb, network.config.vision_config.image_size)
    if patches:
        return network.vision_model(x).last_hidden_state[:, 1:].float()
    return F.normalize(network.get_image_features(x).pooler_output.float(), dim=-1)
