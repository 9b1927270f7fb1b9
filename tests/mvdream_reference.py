"""The denoiser of MVDream written out from its architecture, with the parameter names of the published file.

Shi et al. (2024), section 3; the UNet is that of Rombach et al. (2022) as Stable Diffusion 2 uses it. It makes the tiny
checkpoints of the tests and is what the stock class with mapped names must equal.
"""

import math
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F

FULL: dict[str, Any] = {
    "_class_name": "MultiViewUNetModel", "image_size": 32, "in_channels": 4, "out_channels": 4, "model_channels": 320,
    "attention_resolutions": [4, 2, 1], "num_res_blocks": 2, "channel_mult": [1, 2, 4, 4], "num_head_channels": 64,
    "transformer_depth": 1, "context_dim": 1024, "use_checkpoint": False, "camera_dim": 16,
}  # fmt: skip
"""Settings of the published model (``sd-v2-base.yaml`` of its repository)."""
TINY = FULL | {"model_channels": 32, "num_res_blocks": 1, "channel_mult": [1, 2], "num_head_channels": 16,
               "attention_resolutions": [2], "context_dim": 32}  # fmt: skip


class ResBlock(nn.Module):
    """h = conv(silu(norm(conv(silu(norm x)) + W silu(emb)))) + skip(x)."""

    def __init__(self, channels: int, out: int, embedding: int):
        super().__init__()
        self.in_layers = nn.Sequential(nn.GroupNorm(32, channels), nn.SiLU(), nn.Conv2d(channels, out, 3, padding=1))
        self.emb_layers = nn.Sequential(nn.SiLU(), nn.Linear(embedding, out))
        self.out_layers = nn.Sequential(
            nn.GroupNorm(32, out), nn.SiLU(), nn.Dropout(0), nn.Conv2d(out, out, 3, padding=1)
        )
        self.skip_connection = nn.Identity() if channels == out else nn.Conv2d(channels, out, 1)

    def forward(self, x: Tensor, emb: Tensor, text: Tensor, views: int) -> Tensor:
        h = self.in_layers(x) + self.emb_layers(emb)[:, :, None, None]
        return self.skip_connection(x) + self.out_layers(h)


class Attention(nn.Module):
    """softmax(Q Kᵀ/√d) V in every head, written out."""

    def __init__(self, dim: int, context: int, width: int):
        super().__init__()
        self.width = width
        self.to_q, self.to_k, self.to_v = (nn.Linear(d, dim, bias=False) for d in (dim, context, context))
        self.to_out = nn.Sequential(nn.Linear(dim, dim), nn.Dropout(0))

    def forward(self, x: Tensor, context: Tensor) -> Tensor:
        q, k, v = (
            m.unflatten(-1, (-1, self.width)).transpose(1, 2)
            for m in (self.to_q(x), self.to_k(context), self.to_v(context))
        )
        weights = torch.softmax(q @ k.mT / math.sqrt(self.width), -1)
        return self.to_out((weights @ v).transpose(1, 2).flatten(2))


class GEGLU(nn.Module):
    def __init__(self, dim: int):
        super().__init__()
        self.proj = nn.Linear(dim, 8 * dim)

    def forward(self, x: Tensor) -> Tensor:
        x, gate = self.proj(x).chunk(2, -1)
        return x * F.gelu(gate)


class Block(nn.Module):
    """Self-attention over the tokens of all views of an object, attention of each view to its text, two layers."""

    def __init__(self, dim: int, context: int, width: int):
        super().__init__()
        self.attn1, self.attn2 = Attention(dim, dim, width), Attention(dim, context, width)
        self.ff = nn.ModuleDict({"net": nn.ModuleList([GEGLU(dim), nn.Dropout(0), nn.Linear(4 * dim, dim)])})
        self.norm1, self.norm2, self.norm3 = (nn.LayerNorm(dim) for _ in range(3))

    def forward(self, x: Tensor, text: Tensor, views: int) -> Tensor:
        joined = self.norm1(x).unflatten(0, (-1, views)).flatten(1, 2)
        x = self.attn1(joined, joined).unflatten(1, (views, -1)).flatten(0, 1) + x
        x = self.attn2(self.norm2(x), text) + x
        h = self.norm3(x)
        for layer in self.ff["net"]:
            h = layer(h)
        return h + x


class Transformer(nn.Module):
    def __init__(self, dim: int, context: int, width: int, depth: int):
        super().__init__()
        self.norm = nn.GroupNorm(32, dim, eps=1e-6)
        self.proj_in, self.proj_out = nn.Linear(dim, dim), nn.Linear(dim, dim)
        self.transformer_blocks = nn.ModuleList([Block(dim, context, width) for _ in range(depth)])

    def forward(self, x: Tensor, emb: Tensor, text: Tensor, views: int) -> Tensor:
        h = self.proj_in(self.norm(x).flatten(2).mT)
        for block in self.transformer_blocks:
            h = block(h, text, views)
        return self.proj_out(h).mT.unflatten(2, x.shape[2:]) + x


class Down(nn.Module):
    def __init__(self, channels: int):
        super().__init__()
        self.op = nn.Conv2d(channels, channels, 3, stride=2, padding=1)

    def forward(self, x: Tensor, *_: Any) -> Tensor:
        return self.op(x)


class Up(nn.Module):
    def __init__(self, channels: int):
        super().__init__()
        self.conv = nn.Conv2d(channels, channels, 3, padding=1)

    def forward(self, x: Tensor, *_: Any) -> Tensor:
        return self.conv(x.repeat_interleave(2, 2).repeat_interleave(2, 3))


class First(nn.Conv2d):
    def forward(self, x: Tensor, *_: Any) -> Tensor:
        return super().forward(x)


class Denoiser(nn.Module):
    """ε̂(z_t; t, text, camera) of B rows, ``views`` of which are one object."""

    def __init__(self, config: dict[str, Any]):
        super().__init__()
        c = self.base = config["model_channels"]
        layers, width = config["num_res_blocks"], config["num_head_channels"]

        def two_layers(inputs: int) -> nn.Sequential:
            return nn.Sequential(nn.Linear(inputs, 4 * c), nn.SiLU(), nn.Linear(4 * c, 4 * c))

        def attention(dim: int) -> Transformer:
            return Transformer(dim, config["context_dim"], width, config["transformer_depth"])

        self.time_embed, self.camera_embed = two_layers(c), two_layers(config["camera_dim"])
        self.input_blocks = nn.ModuleList([nn.ModuleList([First(config["in_channels"], c, 3, padding=1)])])
        here, skips, last = c, [c], len(config["channel_mult"]) - 1
        for level, m in enumerate(config["channel_mult"]):
            for _ in range(layers):
                parts: list[nn.Module] = [ResBlock(here, m * c, 4 * c)]
                here = m * c
                if 2**level in config["attention_resolutions"]:
                    parts.append(attention(here))
                self.input_blocks.append(nn.ModuleList(parts))
                skips.append(here)
            if level != last:
                self.input_blocks.append(nn.ModuleList([Down(here)]))
                skips.append(here)
        self.middle_block = nn.ModuleList([ResBlock(here, here, 4 * c), attention(here), ResBlock(here, here, 4 * c)])
        self.output_blocks = nn.ModuleList()
        for level, m in reversed(list(enumerate(config["channel_mult"]))):
            for i in range(layers + 1):
                parts = [ResBlock(here + skips.pop(), m * c, 4 * c)]
                here = m * c
                if 2**level in config["attention_resolutions"]:
                    parts.append(attention(here))
                if level and i == layers:
                    parts.append(Up(here))
                self.output_blocks.append(nn.ModuleList(parts))
        self.out = nn.Sequential(
            nn.GroupNorm(32, here), nn.SiLU(), nn.Conv2d(here, config["out_channels"], 3, padding=1)
        )

    def forward(self, z: Tensor, t: Tensor, text: Tensor, camera: Tensor, views: int) -> Tensor:
        half = self.base // 2
        angle = t[:, None] * torch.exp(-math.log(10000) * torch.arange(half, dtype=z.dtype) / half)
        emb = self.time_embed(torch.cat([angle.cos(), angle.sin()], 1)) + self.camera_embed(camera)
        skips = []
        for block in self.input_blocks:
            for part in block:
                z = part(z, emb, text, views)
            skips.append(z)
        for part in self.middle_block:
            z = part(z, emb, text, views)
        for block in self.output_blocks:
            z = torch.cat([z, skips.pop()], 1)
            for part in block:
                z = part(z, emb, text, views)
        return self.out(z)
