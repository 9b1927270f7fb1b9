"""What happens on the nodes, written once more in numpy: sums over particles, and the sharpening."""

import itertools

import numpy as np


def nodes_of(x: np.ndarray, dx: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The 27 nodes of each particle, their weights and their places from it: (N, 27, 3), (N, 27), (N, 27, 3)."""
    base = np.floor(x / dx - 0.5).astype(int)
    f = x / dx - base
    w1 = np.stack([0.5 * (1.5 - f) ** 2, 0.75 - (f - 1) ** 2, 0.5 * (f - 0.5) ** 2], 1)  # (N, node, axis)
    ijk = np.stack(np.meshgrid(*[range(3)] * 3, indexing="ij"), -1).reshape(27, 3)
    w = w1[:, ijk[:, 0], 0] * w1[:, ijk[:, 1], 1] * w1[:, ijk[:, 2], 2]
    nodes = base[:, None] + ijk
    return nodes, w, nodes * dx - x[:, None]


def sharpened(m: np.ndarray, a: np.ndarray, strength: float) -> np.ndarray:
    """S a on a block of nodes with masses m (nx, ny, nz) and a (nx, ny, nz, 3).

    Edges: ±s min(m_i, m_j) (a_i − a_j)_x along x; cells: s min(m_r) (G + Gᵀ − tr G I − diag G) s_r, G = Σ a_r s_rᵀ.
    """
    out = np.zeros_like(a)
    for axis in range(3):
        low, high = ([slice(None)] * 3 for _ in range(2))
        low[axis], high[axis] = slice(None, -1), slice(1, None)
        i, j = tuple(low), tuple(high)
        F = strength * np.minimum(m[i], m[j]) * (a[i][..., axis] - a[j][..., axis])
        out[(*i, axis)] += F
        out[(*j, axis)] -= F
    corners = list(itertools.product((0, 1), repeat=3))
    parts = [tuple(slice(c, c - 1 or None) for c in corner) for corner in corners]
    signs = [(np.array(corner) - 0.5) / 2 for corner in corners]
    least = np.min([m[part] for part in parts], 0)
    G = sum(np.einsum("...a,b->...ab", a[part], s) for part, s in zip(parts, signs, strict=True))
    diagonal = np.einsum("...aa->...a", G)
    sigma = G + np.swapaxes(G, -1, -2) - diagonal.sum(-1)[..., None, None] * np.eye(3) - diagonal[..., None] * np.eye(3)
    for part, s in zip(parts, signs, strict=True):
        out[part] += strength * least[..., None] * (sigma @ s)
    return out
