"""Sharpening as an operator on the grid: what it is, what it keeps, that it is its own transpose."""

import numpy as np
import pytest
import warp as wp

from diffuphy.material import make_mixture
from diffuphy.mpm import Scheme
from diffuphy.mpm.substep.places import make_places
from diffuphy.mpm.substep.sharpen import make_sharpening
from diffuphy.mpm.substep.variant import Variant
from tests.mpm.lattice import sharpened

N = (6, 5, 7)


@pytest.fixture(scope="module")
def S():
    """S of the default scheme as the kernels compute it: f(m, a) on a block of nodes."""
    v = Variant(make_mixture(("neo_hookean",), ("identity",), wp.float64), wp.float64, Scheme())
    parts, index, node_t, vec3 = make_sharpening(v), make_places().index, v.node_t, v.vec3
    of_node = parts.sharpened

    @wp.kernel(module="unique", enable_backward=False)
    def apply(acc: wp.array[node_t], sigma: wp.array[node_t], n: wp.vec3i, out: wp.array[vec3]):
        o = wp.tid()
        out[o] = of_node(acc, acc, sigma, 0, index(o, n), n)

    def operator(m: np.ndarray, a: np.ndarray) -> np.ndarray:
        rows = np.zeros((m.size, 8))
        rows[:, 3], rows[:, 4:7] = m.ravel(), a.reshape(-1, 3)
        acc, sigma = (wp.array(r, dtype=node_t, device="cpu") for r in (rows, np.zeros_like(rows)))
        out = wp.zeros(m.size, dtype=vec3, device="cpu")
        n = wp.vec3i(*m.shape)
        nobody = wp.zeros(0, dtype=wp.int32, device="cpu")  # no list of active nodes
        wp.launch(parts.cells, dim=m.size, inputs=[acc, n, 0, nobody, sigma], device="cpu")
        wp.launch(apply, dim=m.size, inputs=[acc, sigma, n, out], device="cpu")
        return out.numpy().reshape(*m.shape, 3)

    return operator


def nodes(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Uneven masses with empty nodes among them and at the faces of the block, and values where there is mass."""
    rng = np.random.default_rng(seed)
    m = rng.uniform(0.1, 2.0, N) * (rng.uniform(size=N) > 0.3)
    return m, rng.normal(size=(*N, 3)) * (m > 0)[..., None]


def test_it_is_edges_and_cells(S):
    """Against the definition in numpy; S a is zero where there is no mass."""
    m, a = nodes(0)
    np.testing.assert_allclose(S(m, a), sharpened(m, a, 0.2), rtol=0, atol=1e-14)  # sums of 30 terms of size 1
    assert not S(m, a)[m == 0].any()


def test_it_keeps_momentum_and_angular_momentum(S):
    """Σ S a = 0 and Σ x × S a = 0, whatever the masses: central forces and a symmetric stress."""
    m, a = nodes(1)
    b = S(m, a)
    x = np.stack(np.meshgrid(*map(np.arange, N), indexing="ij"), -1).astype(float)
    assert np.abs(b).max() > 0.1
    assert np.abs(b.sum((0, 1, 2))).max() < 1e-12 and np.abs(np.cross(x, b).sum((0, 1, 2))).max() < 1e-12


def test_it_is_its_own_transpose_and_sharpens(S):
    """⟨b, S a⟩ = ⟨a, S b⟩: its adjoint is itself. Where the mass is even, S a = −s Δx² m Δa of a smooth field to
    O(Δx²)."""
    (m, a), (_, b) = nodes(2), nodes(3)
    assert float((b * S(m, a)).sum()) == pytest.approx(float((a * S(m, b)).sum()), rel=1e-12)
    x = np.stack(np.meshgrid(*map(np.arange, N), indexing="ij"), -1)
    q = np.array([0.3, 0.2, -0.25])
    smooth = np.sin(x @ q)[..., None] * np.array([1.0, -0.5, 0.3])
    inner = np.s_[1:-1, 1:-1, 1:-1]
    expected = 0.2 * (q @ q) * smooth
    # the next term of the differences, (q Δx)² / 6 of the first
    assert np.abs(S(np.ones(N), smooth) - expected)[inner].max() < 0.25 * (q @ q) * np.abs(expected).max()


def test_a_rigid_acceleration_is_left_alone(S):
    """S (A + W x) = 0 for constant A and skew W: gravity and rotation pass."""
    m, _ = nodes(4)
    x = np.stack(np.meshgrid(*map(np.arange, N), indexing="ij"), -1).astype(float)
    a = np.array([0.3, -1.0, 9.8]) + np.cross([0.5, 0.2, -0.7], x)
    assert np.abs(S(m, a)).max() < 1e-13
