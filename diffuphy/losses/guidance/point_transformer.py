"""The network of Point-E (Nichol et al. 2022): a transformer whose tokens are the points themselves.

Modules bear the names of the published checkpoints, which load strictly; a checkpoint says by its own shapes which of
the published networks it is.
"""

import math
from typing import Any, Literal

import torch
import torch.nn.functional as F
from torch import Tensor, nn

CHANNELS = 6
"""Numbers of a point: position and colour."""
HEAD = 64
"""Width of an attention head, the same in every published size."""
PATCHES = 256
"""Patches of a picture: 16 × 16 of CLIP ViT-L/14 at 224 px."""
STEPS = 1024
"""Diffusion steps that every published network was trained with."""
SCALES, BIASES = (2.0,) * 3 + (0.007843137255,) * 3, (0.0,) * 3 + (-1.0,) * 3
"""z = scale · x + bias of positions in [−½, ½] and colours in [0, 255]: every channel of z lies in [−1, 1]."""

Kind = Literal["none", "vector", "grid"]


def time_features(t: Tensor, width: int) -> Tensor:
    """cos(t ω_j), sin(t ω_j), ω_j = 10⁻⁴ʲᐟ⁽ʷⁱᵈᵗʰᐟ²⁾ (Vaswani et al. 2017, §3.5, as Ho et al. 2020 have it), (B, width).

    Args:
        t: steps, shape (B,).
    """
    half = width // 2
    omega = torch.exp(-math.log(1e4) / half * torch.arange(half, dtype=torch.float32, device=t.device))
    angle = t.float()[:, None] * omega
    return torch.cat([angle.cos(), angle.sin()], 1)


class MLP(nn.Module):
    """Four times as wide inside."""

    def __init__(self, width: int):
        super().__init__()
        self.c_fc, self.c_proj = nn.Linear(width, 4 * width), nn.Linear(4 * width, width)

    def forward(self, x: Tensor) -> Tensor:
        return self.c_proj(F.gelu(self.c_fc(x)))


class Attention(nn.Module):
    """Every token sees every other. The published weights keep q, k and v of each head together, head after head."""

    def __init__(self, width: int, heads: int):
        super().__init__()
        self.heads = heads
        self.c_qkv, self.c_proj = nn.Linear(width, 3 * width), nn.Linear(width, width)

    def forward(self, x: Tensor) -> Tensor:
        q, k, v = self.c_qkv(x).unflatten(-1, (self.heads, 3, -1)).permute(3, 0, 2, 1, 4)  # each (B, heads, L, HEAD)
        return self.c_proj(F.scaled_dot_product_attention(q, k, v).transpose(1, 2).flatten(2))


class Block(nn.Module):
    """x + attention(ln₁ x), then x + mlp(ln₂ x)."""

    def __init__(self, width: int, heads: int):
        super().__init__()
        self.attn, self.ln_1 = Attention(width, heads), nn.LayerNorm(width)
        self.mlp, self.ln_2 = MLP(width), nn.LayerNorm(width)

    def forward(self, x: Tensor) -> Tensor:
        x = x + self.attn(self.ln_1(x))
        return x + self.mlp(self.ln_2(x))


class Backbone(nn.Module):
    """The blocks."""

    def __init__(self, width: int, layers: int, heads: int):
        super().__init__()
        self.resblocks = nn.ModuleList([Block(width, heads) for _ in range(layers)])

    def forward(self, x: Tensor) -> Tensor:
        for block in self.resblocks:
            x = block(x)
        return x


class PointTransformer(nn.Module):
    """ε̂ and a learned variance of noisy points, given CLIP features and, to upsample, a coarse cloud.

    Tokens, in this order: the condition if it is a vector, time, the condition if it is a grid, coarse points, points.
    Nothing says which point is which: the network answers the same for any order and any number of them.

    Args:
        width: of a token.
        layers: number of blocks.
        heads: number of attention heads; the published networks have width/64.
        kind: what the condition is: nothing, one CLIP embedding, or a grid of CLIP's hidden patches.
        features: length of the condition's vectors: 768 for embeddings and 1024 for patches of CLIP ViT-L/14.
        upsampler: takes a coarse cloud too.
    """

    def __init__(
        self, width: int, layers: int, heads: int, *, kind: Kind = "none", features: int = 0, upsampler: bool = False
    ):
        super().__init__()
        self.kind, self.features, self.upsampler = kind, features, upsampler
        self.time_embed, self.ln_pre = MLP(width), nn.LayerNorm(width)
        self.backbone, self.ln_post = Backbone(width, layers, heads), nn.LayerNorm(width)
        self.input_proj, self.output_proj = nn.Linear(CHANNELS, width), nn.Linear(width, 2 * CHANNELS)
        if kind == "vector":
            self.clip_embed = nn.Linear(features, width)
        elif kind == "grid":
            self.clip_embed = nn.Sequential(nn.LayerNorm(features), nn.Linear(features, width))
        if upsampler:
            self.cond_point_proj = nn.Linear(CHANNELS, width)
            self.register_buffer("channel_scales", torch.tensor(SCALES))
            self.register_buffer("channel_biases", torch.tensor(BIASES))

    @classmethod
    def of(cls, state: dict[str, Tensor], head: int = HEAD) -> "PointTransformer":
        """The network that a checkpoint's tensors belong to, with them in it.

        Raises:
            ValueError: tensors of something else.
        """
        try:
            width = len(state["input_proj.weight"])
            layers = len({name.split(".")[2] for name in state if name.startswith("backbone.resblocks.")})
        except (KeyError, IndexError):
            raise ValueError(
                f"these are no weights of Point-E: no input_proj or backbone.resblocks among {sorted(state)[:3]}, …; "
                "give base_40m.pt, base_40m_textvec.pt, base_40m_imagevec.pt, base_40m_uncond.pt, base_300m.pt, "
                "base_1b.pt or upsample_40m.pt"
            ) from None
        settings: dict[str, Any] = {}
        if (weight := state.get("clip_embed.weight")) is not None:
            settings = {"kind": "vector", "features": weight.shape[1]}
        elif (weight := state.get("clip_embed.1.weight")) is not None:
            settings = {"kind": "grid", "features": weight.shape[1]}
        with torch.device("meta"):
            network = cls(width, layers, max(1, width // head), **settings, upsampler="cond_point_proj.weight" in state)
        network.load_state_dict(state, strict=True, assign=True)
        return network.eval().requires_grad_(False)

    def forward(self, x: Tensor, t: Tensor, condition: Tensor | None = None, coarse: Tensor | None = None) -> Tensor:
        """ε̂ and the variance's share, shape (B, N, 12).

        Args:
            x: noisy points, shape (B, N, 6).
            t: steps in [0, 1024), shape (B,).
            condition: unit CLIP embeddings (B, features), patches (B, L, features), or None. The unconditional answer
                is that to zeros.
            coarse: points to refine, shape (B, M, 6), positions in [−½, ½] and colours in [0, 255].

        Raises:
            ValueError: a condition or a coarse cloud that this network does not take, or none that it does.
        """
        if (condition is None) != (self.kind == "none") or (coarse is None) == self.upsampler:
            raise ValueError(
                f"this network wants a condition of kind {self.kind!r} and {'a' if self.upsampler else 'no'} coarse "
                f"cloud, got {condition is not None} and {coarse is not None}"
            )
        dtype = self.input_proj.weight.dtype
        points = self.input_proj(x.to(dtype))
        tokens = [self.time_embed(time_features(t, points.shape[-1]).to(dtype))[:, None]]
        if condition is not None and self.kind == "vector":
            tokens.insert(0, self.clip_embed(math.sqrt(self.features) * condition.to(dtype))[:, None])
        elif condition is not None:
            tokens.append(self.clip_embed(condition.to(dtype)))
        if coarse is not None:
            tokens.append(self.cond_point_proj((coarse * self.channel_scales + self.channel_biases).to(dtype)))
        h = self.ln_post(self.backbone(self.ln_pre(torch.cat([*tokens, points], 1))))
        return self.output_proj(h[:, -x.shape[1] :])
