"""The denoiser of MVDream as the stock UNet of diffusers: its published names, and attention across views.

MVDream (Shi et al. 2024) is the UNet of Stable Diffusion 2.1 with two additions: a two-layer embedding of the camera
that is added to that of the time, which diffusers calls a class embedding by projection, and self-attention over the
tokens of all views of an object at once. The published file keeps the names of the original program; nothing of it is
run.
"""

import os
import re
from typing import Any

import torch
from torch import Tensor

from diffuphy.models import read

WEIGHTS = "diffusion_pytorch_model.safetensors"
"""File of the weights beside ``config.json``."""


class JoinedViews:
    """Attention processor that lets the tokens of ``views`` consecutive rows see each other; text stays each row's own.

    self-attention on (B/V, V L, C) instead of (B, L, C)
    """

    def __init__(self, views: int):
        from diffusers.models.attention_processor import AttnProcessor2_0

        self.views, self.attend = views, AttnProcessor2_0()

    def __call__(
        self, attn: Any, hidden_states: Tensor, encoder_hidden_states: Tensor | None = None, *args: Any, **kwargs: Any
    ) -> Tensor:
        if encoder_hidden_states is not None:
            return self.attend(attn, hidden_states, encoder_hidden_states, *args, **kwargs)
        b, length, channels = hidden_states.shape
        joined = hidden_states.reshape(b // self.views, self.views * length, channels)
        return self.attend(attn, joined, None, *args, **kwargs).reshape(b, length, -1)


def stock_config(config: dict[str, Any]) -> dict[str, Any]:
    """Settings of ``UNet2DConditionModel`` for the published settings of MVDream's own class.

    Raises:
        ValueError: a setting that the stock class has no counterpart for.
    """
    wanted = {"model_channels", "channel_mult", "num_res_blocks", "attention_resolutions", "num_head_channels",
              "context_dim", "camera_dim", "in_channels", "out_channels"}  # fmt: skip
    if missing := wanted - set(config):
        raise ValueError(f"the config of MVDream's UNet lacks {', '.join(sorted(missing))}; has {sorted(config)}")
    plain = {"ip_dim": 0, "num_classes": None, "use_scale_shift_norm": False, "resblock_updown": False, "dims": 2}
    for name, value in plain.items():
        if config.get(name, value) != value:
            raise ValueError(f"{name} of MVDream's UNet must be {value}, got {config[name]!r}: that is another model")
    channels = [config["model_channels"] * m for m in config["channel_mult"]]
    attends = [2**level in config["attention_resolutions"] for level in range(len(channels))]
    return {
        "in_channels": config["in_channels"],
        "out_channels": config["out_channels"],
        "block_out_channels": channels,
        "layers_per_block": config["num_res_blocks"],
        "down_block_types": ["CrossAttnDownBlock2D" if a else "DownBlock2D" for a in attends],
        "up_block_types": ["CrossAttnUpBlock2D" if a else "UpBlock2D" for a in reversed(attends)],
        "attention_head_dim": [c // config["num_head_channels"] for c in channels],  # diffusers' name for heads
        "transformer_layers_per_block": config.get("transformer_depth", 1),
        "cross_attention_dim": config["context_dim"],
        "use_linear_projection": True,
        "class_embed_type": "projection",
        "projection_class_embeddings_input_dim": config["camera_dim"],
    }


RESNET = {
    "norm1": "in_layers.0", "conv1": "in_layers.2", "time_emb_proj": "emb_layers.1", "norm2": "out_layers.0",
    "conv2": "out_layers.3", "conv_shortcut": "skip_connection",
}  # fmt: skip
"""Layers of a residual block: stock name, published name."""

ENDS = {
    "conv_in": "input_blocks.0.0", "conv_norm_out": "out.0", "conv_out": "out.2",
    "time_embedding.linear_1": "time_embed.0", "time_embedding.linear_2": "time_embed.2",
    "class_embedding.linear_1": "camera_embed.0", "class_embedding.linear_2": "camera_embed.2",
}  # fmt: skip
"""Layers before and after the blocks likewise."""


def published_name(name: str, layers: int, attends: dict[str, bool]) -> str:
    """What the published file calls a parameter of the stock class.

    The original numbers the blocks of both halves through: level i of the way down has ``layers`` blocks and a
    downsampling, level i of the way up ``layers + 1`` blocks, the last of which also upsamples.

    Args:
        layers: blocks of a level on the way down.
        attends: whether each level on the way up has attention, by its stock number.
    """
    module, leaf = name.rsplit(".", 1)
    if module in ENDS:
        return f"{ENDS[module]}.{leaf}"
    if found := re.fullmatch(r"mid_block\.(resnets|attentions)\.(\d)\.(.+)", name):
        kind, j, rest = found.groups()
        return f"middle_block.{2 * int(j) + (kind == 'attentions')}.{_inner(kind, rest)}"
    found = re.fullmatch(r"(down|up)_blocks\.(\d)\.(resnets|attentions|downsamplers|upsamplers)\.(\d)\.(.+)", name)
    if found is None:
        raise ValueError(f"parameter {name} of the stock UNet has no published name")
    way, level, kind, j, rest = found.groups()
    i, j = int(level), int(j)
    if kind == "downsamplers":
        return f"input_blocks.{(layers + 1) * (i + 1)}.0.{rest.replace('conv', 'op')}"
    if kind == "upsamplers":
        return f"output_blocks.{(layers + 1) * (i + 1) - 1}.{1 + attends[level]}.{rest}"
    number = 1 + (layers + 1) * i + j if way == "down" else (layers + 1) * i + j
    half = "input_blocks" if way == "down" else "output_blocks"
    return f"{half}.{number}.{int(kind == 'attentions')}.{_inner(kind, rest)}"


def _inner(kind: str, rest: str) -> str:
    """Name inside one block; attention is called the same in both."""
    if kind == "attentions":
        return rest
    layer, leaf = rest.rsplit(".", 1)
    return f"{RESNET[layer]}.{leaf}"


def published_names(unet: Any) -> dict[str, str]:
    """Published name of every parameter of a stock UNet, by its stock name."""
    attends = {str(i): kind.startswith("CrossAttn") for i, kind in enumerate(unet.config.up_block_types)}
    return {name: published_name(name, unet.config.layers_per_block, attends) for name in unet.state_dict()}


def build(config: dict[str, Any], views: int) -> Any:
    """The stock UNet with joined views, its weights not yet there (of the default device, "meta" included)."""
    from diffusers import UNet2DConditionModel

    unet = UNet2DConditionModel(**stock_config(config))
    unet.set_attn_processor(JoinedViews(views))
    return unet


def from_pretrained(model: str, *, subfolder: str, views: int, dtype: torch.dtype, **place: Any) -> Any:
    """MVDream's denoiser from a hub repository or a folder laid out the same way.

    Args:
        model: hub id or folder.
        place: ``revision``, ``local_files_only``.

    Raises:
        OSError: it is not there.
        ValueError: its parameters are not exactly those of the model.
    """
    from diffusers import UNet2DConditionModel

    config = UNet2DConditionModel.load_config(model, subfolder=subfolder, **place)
    with torch.device("meta"):
        unet = build(dict(config), views)
    weights = read(_file(model, subfolder, place))
    names = published_names(unet)
    if set(names.values()) != set(weights):
        odd = sorted(set(names.values()) ^ set(weights))
        raise ValueError(f"{model}/{subfolder}/{WEIGHTS} is not MVDream: {len(odd)} names differ, such as {odd[:3]}")
    state = {stock: weights[published].to(dtype) for stock, published in names.items()}
    unet.load_state_dict(state, strict=True, assign=True)
    return unet


def _file(model: str, subfolder: str, place: dict[str, Any]) -> str:
    if os.path.isdir(model):
        return os.path.join(model, subfolder, WEIGHTS)
    from huggingface_hub import hf_hub_download

    return hf_hub_download(model, f"{subfolder}/{WEIGHTS}", **place)
