"""What the network sees of a Gaussian, and the encoder that turns patches of Gaussians into tokens.

Point-BERT (Yu et al. 2022): a small PointNet makes one token of each patch, a position embedding says where the patch
is, and transformer blocks let the patches look at each other.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

N_FEATURES = 11
"""Features besides the position: 6 of the covariance, 1 opacity, 3 colour, 1 sheen."""


@dataclass(frozen=True)
class Points:
    """Points a material is asked for, with the appearance {X, Σ, α, c} of the Gaussians they carry."""

    x: Tensor
    """Positions at rest, shape (N, 3) [m]."""
    f: Tensor
    """Log covariance (6), opacity (1), colour (3), sheen (1), shape (N, 11)."""

    def __len__(self) -> int:
        return self.x.shape[0]

    @property
    def color(self) -> Tensor:
        """rgb in [0, 1], shape (N, 3)."""
        return self.f[:, 7:10]

    def seen_from(self, origin: Tensor, axes: Tensor) -> "Points":
        """The same points in another frame: x' = Aᵀ (x − o), (ln Σ)' = Aᵀ (ln Σ) A.

        Args:
            origin: o, shape (3,) [m].
            axes: orthonormal columns A, shape (3, 3).
        """
        log_cov = axes.mT @ _matrix(self.f[:, :6]) @ axes
        return Points((self.x - origin) @ axes, torch.cat([_upper(log_cov), self.f[:, 6:]], 1))


def features(x: Tensor, colors: Tensor, opacities: Tensor, log_cov: Tensor, sheen: Tensor | None = None) -> Points:
    """Points from what is known of their Gaussians.

        f = [ln Σ (upper triangle, off-diagonal √2), α, c, sheen]

    The norm of the logarithm of a covariance does not depend on the axes (``geometry.log_covariances``). Its unit only
    shifts the diagonal, which the network's standardisation removes.

    Args:
        x: positions at rest, shape (N, 3) [m].
        colors: rgb in [0, 1], shape (N, 3).
        opacities: shape (N,).
        log_cov: logarithms of the covariances, symmetric, shape (N, 3, 3) [ln m²].
        sheen: how much the colour changes with the direction it is seen from, shape (N,); None for not at all.

    Raises:
        ValueError: for a wrong shape, or a covariance without extent.
    """
    n = x.shape[0]
    sheen = torch.zeros_like(opacities) if sheen is None else sheen
    got = {"x": x, "colors": colors, "opacities": opacities, "log_cov": log_cov, "sheen": sheen}
    want = {"x": (n, 3), "colors": (n, 3), "opacities": (n,), "log_cov": (n, 3, 3), "sheen": (n,)}
    if wrong := [f"{k} {tuple(got[k].shape)}, not {want[k]}" for k in want if tuple(got[k].shape) != want[k]]:
        raise ValueError(f"features got {'; '.join(wrong)}; give one row per point")
    finite = log_cov.isfinite().all(2).all(1)
    if not bool(finite.all()):
        bad = int((~finite).nonzero()[0])
        raise ValueError(f"the logarithm of covariance {bad} is not finite; drop the point or give it an extent")
    f = torch.cat([_upper(log_cov), opacities[:, None], colors, sheen[:, None]], 1)
    return Points(x.detach(), f.detach().to(x.dtype))


def _upper(matrix: Tensor) -> Tensor:
    """Upper triangles of symmetric matrices (N, 3, 3) → (N, 6), off-diagonal √2, so that norms stay."""
    row, col = torch.triu_indices(3, 3, device=matrix.device)
    return matrix[:, row, col] * torch.where(row == col, 1, 2).to(matrix.dtype).sqrt()


def _matrix(upper: Tensor) -> Tensor:
    """The matrices that ``_upper`` was taken of."""
    row, col = torch.triu_indices(3, 3, device=upper.device)
    matrix = upper.new_zeros(len(upper), 3, 3)
    matrix[:, row, col] = matrix[:, col, row] = upper / torch.where(row == col, 1, 2).to(upper.dtype).sqrt()
    return matrix


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
