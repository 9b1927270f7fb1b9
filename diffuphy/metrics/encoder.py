"""Pictures and words in one space: CLIP (Radford et al. 2021) through open_clip."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import torch
import torch.nn.functional as F
from torch import Tensor

from diffuphy.models import missing


class Encoder(Protocol):
    """What embeds pictures and texts; equal directions mean the same."""

    def missing(self) -> str | None:
        """Why it cannot be loaded; None if it can."""
        ...

    def pictures(self, rgb: Tensor) -> Tensor:
        """Unit vectors (n, D) of pictures (n, H, W, 3) in [0, 1]."""
        ...

    def texts(self, texts: Sequence[str], device: torch.device) -> Tensor:
        """Unit vectors (n, D) of n texts."""
        ...


@dataclass(frozen=True)
class OpenClip:
    """A CLIP of open_clip, float32, frozen.

    OpenAI's weights were trained with x·σ(1.702 x) as activation; open_clip runs them with the usual GELU, and only
    warns, unless the model's name says ``-quickgelu``. Here the two must agree.
    """

    model: str = "ViT-B-32-quickgelu"
    """Architecture; or a path, beginning with ``/``, ``.`` or ``~``, of a folder with ``open_clip_config.json`` and
    weights."""
    pretrained: str = "openai"
    """Tag of the weights; not looked at with a folder. ViT-B-32 with laion2b_s34b_b79k works as well."""
    repo: str = "timm/vit_base_patch32_clip_224.openai"
    """Hub repository of the tag, where the plan looks for the weights."""
    batch: int = 32
    """Pictures at once."""

    def __post_init__(self) -> None:
        if self.batch < 1:
            raise ValueError(f"batch must be at least 1, got {self.batch}")
        if self.pretrained == "openai" and self._folder is None and "quickgelu" not in self.model:
            raise ValueError(
                f"the weights 'openai' need the activation QuickGELU, which {self.model!r} has not; "
                f"use {self.model + '-quickgelu'!r}"
            )

    @property
    def _folder(self) -> str | None:
        """Path of the weights, if the model is one."""
        return os.path.expanduser(self.model) if self.model.startswith(("/", ".", "~")) else None

    def missing(self) -> str | None:
        return missing(self._folder or self.repo, {".": "open_clip"}, "the encoder's model")

    @cached_property
    def _network(self) -> tuple[Any, Any]:
        """Network and tokeniser, loaded on first use."""
        import open_clip

        if self._folder is None:
            self._check_activation(open_clip)
            name, pretrained = self.model, self.pretrained
        else:
            name, pretrained = f"local-dir:{self._folder}", None  # open_clip's own word for a folder
        network = open_clip.create_model(name, pretrained=pretrained).eval().requires_grad_(False)
        return network, open_clip.get_tokenizer(name)

    def _check_activation(self, open_clip: Any) -> None:
        """Refuse weights that were trained with another activation than the model would run."""
        config = open_clip.get_model_config(self.model)
        tag = open_clip.pretrained.get_pretrained_cfg(self.model, self.pretrained)
        if config is None or not tag:
            raise ValueError(f"open_clip has no weights {self.pretrained!r} of a model {self.model!r}")
        runs, trained = bool(config.get("quick_gelu")), bool(tag.get("quick_gelu"))
        if runs != trained:
            other = self.model.removesuffix("-quickgelu") if runs else f"{self.model}-quickgelu"
            raise ValueError(
                f"{self.pretrained!r} was trained {'with' if trained else 'without'} QuickGELU and {self.model!r} "
                f"runs {'with' if runs else 'without'} it; use {other!r}"
            )

    def prepared(self, rgb: Tensor) -> Tensor:
        """Network input (n, 3, S, S): shorter side to S bicubically with antialiasing, middle square, normalised.

        On floats; open_clip's own way through 8-bit pictures differs by up to 0.05.
        """
        import open_clip

        config = open_clip.get_model_preprocess_cfg(self._network[0])
        side = config["size"] if isinstance(config["size"], int) else config["size"][0]
        x = rgb.float().permute(0, 3, 1, 2)
        height, width = (max(side, round(n * side / min(x.shape[-2:]))) for n in x.shape[-2:])
        if x.shape[-2:] != (height, width):
            x = F.interpolate(x, (height, width), mode="bicubic", antialias=True, align_corners=False).clamp(0, 1)
        top, left = (height - side) // 2, (width - side) // 2
        x = x[..., top : top + side, left : left + side]
        mean, std = (x.new_tensor(config[k]).view(3, 1, 1) for k in ("mean", "std"))
        return (x - mean) / std

    @torch.no_grad()
    def pictures(self, rgb: Tensor) -> Tensor:
        network = self._network[0].to(rgb.device)
        parts = [network.encode_image(self.prepared(part)) for part in rgb.split(self.batch)]
        return F.normalize(torch.cat(parts).float(), dim=-1)

    @torch.no_grad()
    def texts(self, texts: Sequence[str], device: torch.device) -> Tensor:
        network, tokenizer = self._network
        ids = tokenizer(list(texts)).to(device)
        return F.normalize(network.to(device).encode_text(ids).float(), dim=-1)
