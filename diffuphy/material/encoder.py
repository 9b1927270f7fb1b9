"""What the network sees of a Gaussian, and the encoder that turns patches of Gaussians into tokens.

Point-BERT (Yu et al. 2022): a small PointNet makes one token of each patch, a position embedding says where the patch
is, and transformer blocks let the patches look at each other.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

N_FEATURES = 10
"""Features besides the position: 6 of the covariance, 1 opacity, 3 colour."""

THINNEST = 1e-6
"""Least eigenvalue of a covariance relative to its trace: thinner than 1/1000 of its size is a disc to the network."""


@dataclass(frozen=True)
class Points:
    """Points a material is asked for, with the appearance {X, Σ, α, c} of the Gaussians they carry."""

    x: Tensor
    """Positions at rest, shape (N, 3) [m]."""
    f: Tensor
    """Log covariance (6), opacity (1), colour (3), shape (N, 10)."""

    def __len__(self) -> int:
        return self.x.shape[0]

    @property
    def color(self) -> Tensor:
        """rgb in [0, 1], shape (N, 3)."""
        return self.f[:, 7:10]


def features(x: Tensor, colors: Tensor, opacities: Tensor, cov: Tensor) -> Points:
    """Points from what is known of their Gaussians.

        f = [ln Σ (upper triangle, off-diagonal √2), α, c]

    The logarithm of the covariance (Arsigny et al. 2006) makes twice as large and half as large equally far, and its
    norm does not depend on the axes. Its unit only shifts the diagonal, which the network's standardisation removes.

    Args:
        x: positions at rest, shape (N, 3) [m].
        colors: rgb in [0, 1], shape (N, 3).
        opacities: shape (N,).
        cov: covariances, positive semidefinite and not zero, shape (N, 3, 3) [m²].

    Raises:
        ValueError: for a wrong shape, or a covariance without extent.
    """
    n = x.shape[0]
    got = {"x": x.shape, "colors": colors.shape, "opacities": opacities.shape, "cov": cov.shape}
    want = {"x": (n, 3), "colors": (n, 3), "opacities": (n,), "cov": (n, 3, 3)}
    if wrong := [f"{k} {tuple(got[k])}, not {want[k]}" for k in want if tuple(got[k]) != want[k]]:
        raise ValueError(f"features got {'; '.join(wrong)}; give one row per point")
    with torch.no_grad():
        trace = cov.diagonal(dim1=1, dim2=2).sum(1)
        if not bool((trace > 0).all()):
            bad = int((~(trace > 0)).nonzero()[0])
            raise ValueError(
                f"covariance {bad} has trace {float(trace[bad])}, not > 0; drop the point or give it an extent"
            )
        unit = cov / trace[:, None, None]
        s, axes = torch.linalg.eigh((unit + unit.mT) / 2)
        log_s = s.clamp(min=THINNEST).log() + trace.log()[:, None]
        log_cov = (axes * log_s[:, None, :]) @ axes.mT
        row, col = torch.triu_indices(3, 3, device=cov.device)
        upper = log_cov[:, row, col] * torch.where(row == col, 1, 2).to(cov.dtype).sqrt()
        return Points(x.detach(), torch.cat([upper, opacities[:, None], colors], 1).detach().to(x.dtype))


class PatchEmbedding(nn.Module):
    """One token per patch, whatever the order of its points (PointNet, Qi et al. 2017, twice).

        h_m = A(p_m),   token = max_m B(h_m ⊕ max_m' h_m')

    The linear layers act on the last axis of (G, M, C), so a feature never changes place with a point.
    """

    def __init__(self, channels: int, width: int):
        super().__init__()
        self.point = nn.Sequential(nn.Linear(channels, width // 2), nn.GELU(), nn.Linear(width // 2, width))
        self.patch = nn.Sequential(nn.Linear(2 * width, width), nn.GELU(), nn.Linear(width, width))

    def forward(self, groups: Tensor) -> Tensor:
        """Patches (G, M, channels) → tokens (G, width)."""
        h = self.point(groups)
        h = torch.cat([h, h.amax(1, keepdim=True).expand_as(h)], 2)
        return self.patch(h).amax(1)


class Block(nn.Module):
    """Pre-norm transformer block over the tokens of one object (Vaswani et al. 2017; Xiong et al. 2020).

    No bias on queries, keys and values: attention does not change when one vector is added to every key.
    """

    def __init__(self, width: int, heads: int):
        super().__init__()
        self.heads = heads
        self.norm_attention = nn.LayerNorm(width)
        self.qkv = nn.Linear(width, 3 * width, bias=False)
        self.out = nn.Linear(width, width)
        self.norm_mlp = nn.LayerNorm(width)
        self.mlp = nn.Sequential(nn.Linear(width, 2 * width), nn.GELU(), nn.Linear(2 * width, width))

    def forward(self, tokens: Tensor) -> Tensor:
        """(G, width) → (G, width)."""
        n, width = tokens.shape
        qkv = self.qkv(self.norm_attention(tokens)).view(n, 3, self.heads, width // self.heads)
        q, k, v = qkv.permute(1, 2, 0, 3)  # (heads, G, width / heads)
        # written out, because the backward pass of fused attention is not repeatable on CUDA
        mixed = torch.softmax(q @ k.mT / q.shape[-1] ** 0.5, -1) @ v
        tokens = tokens + self.out(mixed.transpose(0, 1).reshape(n, width))
        return tokens + self.mlp(self.norm_mlp(tokens))


class Encoder(nn.Module):
    """Patches of one object → one token each, in context.

    Args:
        channels: features per point of a patch, the relative position included.
        width: length of a token.
        depth: transformer blocks.
        heads: attention heads; divides ``width``.
    """

    def __init__(self, channels: int, width: int, depth: int, heads: int):
        super().__init__()
        self.patch = PatchEmbedding(channels, width)
        self.position = nn.Sequential(nn.Linear(3, width), nn.GELU(), nn.Linear(width, width))
        self.blocks = nn.ModuleList(Block(width, heads) for _ in range(depth))
        self.norm = nn.LayerNorm(width)

    def forward(self, groups: Tensor, centres: Tensor) -> Tensor:
        """Patches (G, M, channels) around centres (G, 3) → tokens (G, width)."""
        tokens = self.patch(groups) + self.position(centres)
        for block in self.blocks:
            tokens = block(tokens)
        return self.norm(tokens)
