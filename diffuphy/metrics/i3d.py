"""The feature network of FVD: the inflated Inception of Carreira & Zisserman (2017), trained on Kinetics-400.

Modules bear the names of the published PyTorch weights (``i3d_pretrained_400.pt``), which load strictly.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from diffuphy.models import missing_file, read

MIXED: dict[str, tuple[int, ...]] = {
    "3b": (64, 96, 128, 16, 32, 32),
    "3c": (128, 128, 192, 32, 96, 64),
    "4b": (192, 96, 208, 16, 48, 64),
    "4c": (160, 112, 224, 24, 64, 64),
    "4d": (128, 128, 256, 24, 64, 64),
    "4e": (112, 144, 288, 32, 64, 64),
    "4f": (256, 160, 320, 32, 128, 128),
    "5b": (256, 160, 320, 32, 128, 128),
    "5c": (384, 192, 384, 48, 128, 128),
}
"""Channels of each inception module: 1×1; 1×1 before 3×3, 3×3; the same again, small; 1×1 after pooling."""

POOLS = {"3b": ((1, 3, 3), (1, 2, 2)), "4b": ((3, 3, 3), (2, 2, 2)), "5b": ((2, 2, 2), (2, 2, 2))}
"""Window and stride of the pooling before a module."""


def same(x: Tensor, window: tuple[int, ...], stride: tuple[int, ...]) -> Tensor:
    """Zeros around (n, C, T, H, W) so that ⌈size/stride⌉ windows fit, the odd one at the end, as TensorFlow has it."""
    pads: list[int] = []
    for size, k, s in zip(reversed(x.shape[2:]), reversed(window), reversed(stride), strict=True):
        total = max((math.ceil(size / s) - 1) * s + k - size, 0)
        pads += [total // 2, total - total // 2]
    return F.pad(x, pads)


def pool(x: Tensor, window: tuple[int, int, int], stride: tuple[int, int, int]) -> Tensor:
    return F.max_pool3d(same(x, window, stride), window, stride)


class Unit(nn.Module):
    """Convolution, and unless it is the last one, batch normalisation and ReLU."""

    def __init__(self, channels: int, out: int, side: int = 1, stride: int = 1, *, last: bool = False):
        super().__init__()
        self.window, self.stride, self.last = (side,) * 3, (stride,) * 3, last
        self.conv3d = nn.Conv3d(channels, out, side, stride, bias=last)
        self.bn = None if last else nn.BatchNorm3d(out, eps=1e-3, momentum=0.01)

    def forward(self, x: Tensor) -> Tensor:
        x = self.conv3d(same(x, self.window, self.stride))
        return x if self.bn is None else F.relu(self.bn(x))


class Mixed(nn.Module):
    """Four branches side by side."""

    def __init__(self, channels: int, out: tuple[int, ...]):
        super().__init__()
        self.b0 = Unit(channels, out[0])
        self.b1a, self.b1b = Unit(channels, out[1]), Unit(out[1], out[2], 3)
        self.b2a, self.b2b = Unit(channels, out[3]), Unit(out[3], out[4], 3)
        self.b3b = Unit(channels, out[5])
        self.channels = out[0] + out[2] + out[4] + out[5]

    def forward(self, x: Tensor) -> Tensor:
        pooled = pool(x, (3, 3, 3), (1, 1, 1))
        return torch.cat([self.b0(x), self.b1b(self.b1a(x)), self.b2b(self.b2a(x)), self.b3b(pooled)], 1)


class InceptionI3d(nn.Module):
    """Logits of clips (n, 3, T, 224, 224) in [−1, 1], T ≥ 9, mean over time, shape (n, classes)."""

    def __init__(self, classes: int = 400, width: float = 1.0):
        super().__init__()

        def scaled(c: int) -> int:
            return max(1, round(c * width))

        self.Conv3d_1a_7x7 = Unit(3, scaled(64), 7, 2)
        self.Conv3d_2b_1x1 = Unit(scaled(64), scaled(64))
        self.Conv3d_2c_3x3 = Unit(scaled(64), scaled(192), 3)
        channels = scaled(192)
        for name, out in MIXED.items():
            module = Mixed(channels, tuple(map(scaled, out)))
            self.add_module(f"Mixed_{name}", module)
            channels = module.channels
        self.logits = Unit(channels, classes, last=True)

    def forward(self, x: Tensor) -> Tensor:
        x = pool(self.Conv3d_1a_7x7(x), (1, 3, 3), (1, 2, 2))
        x = self.Conv3d_2c_3x3(self.Conv3d_2b_1x1(x))
        for name in MIXED:
            if name in POOLS:
                x = pool(x, *POOLS[name])
            x = self.get_submodule(f"Mixed_{name}")(x)
        return self.logits(F.avg_pool3d(x, (2, 7, 7), 1)).mean((2, 3, 4))


@dataclass(frozen=True)
class I3D:
    """Features of FVD as it is published: 400 logits of frames resized to 224 px."""

    checkpoint: str = "i3d_pretrained_400.pt"
    """File of the weights, or the same as safetensors: a path, or a name of ``conf/models.yaml``."""
    sha256: str = ""
    """What the file must have; empty trusts it."""
    width: float = 1.0
    """Factor on all channels; the published weights have 1."""
    batch: int = 4
    """Clips at once."""

    frames = 16
    """Length of its clips; at least 9."""

    def __post_init__(self) -> None:
        if not self.width > 0 or self.batch < 1:
            raise ValueError(f"width must be positive and batch at least 1, got {self.width} and {self.batch}")

    def missing(self) -> str | None:
        return missing_file(self.checkpoint, "evaluate.video.checkpoint", self.sha256)

    @cached_property
    def _network(self) -> InceptionI3d:
        state = read(self.checkpoint, self.sha256)
        network = InceptionI3d(len(state["logits.conv3d.bias"]), self.width)
        network.load_state_dict(state)
        return network.eval().requires_grad_(False)

    @torch.no_grad()
    def __call__(self, clips: Tensor) -> Tensor:
        """Logits (n, 400) of clips (n, T, H, W, 3) in [0, 1]."""
        network = self._network.to(clips.device)
        return torch.cat([network(self.prepared(part)) for part in clips.split(self.batch)])

    def prepared(self, clips: Tensor) -> Tensor:
        """(n, 3, T, 224, 224) in [−1, 1], bilinear."""
        n, frames = clips.shape[:2]
        x = clips.float().flatten(0, 1).permute(0, 3, 1, 2)
        x = F.interpolate(x, (224, 224), mode="bilinear", align_corners=False)
        return 2 * x.view(n, frames, 3, 224, 224).movedim(2, 1) - 1
