"""Walls evaluated node by node, and what they should do, in numpy, for the tests of this folder."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import warp as wp

from diffuphy.mpm import Grid
from diffuphy.mpm.boundary import make_contact, sdf_samples, signature

HERE = Grid(1.0, (0, 0, 0), (4, 4, 4))
"""A block whose lowest node is the origin, with Δx = 1 m."""


@lru_cache
def kernels(walls, real):
    """The kernel that evaluates a list of walls, and its types."""
    contact = make_contact(walls, real)
    apply, adjoint, adjoint_rows, wall_t = contact.apply, contact.adjoint, contact.adjoint_rows, contact.wall_t
    vec3, vec4 = wp.types.vector(3, real), wp.types.vector(4, real)

    @wp.kernel(module="unique", enable_backward=False)
    def evaluate(
        v: wp.array[vec3], r: wp.array[vec3], e: wp.array[vec4], s: wp.array[wp.int32],
        row: wp.array2d[wall_t], sdf: wp.array[real],
        v_bar: wp.array[vec3], o: wp.array[vec3], o_bar: wp.array[vec3], same_bar: wp.array[vec3],
        e_bar: wp.array[vec4], row_bar: wp.array2d[wall_t],
    ):  # fmt: skip
        p = wp.tid()
        o[p] = apply(v[p], r[p], e[p], row, sdf, s[p])
        a, b = adjoint(v[p], r[p], e[p], row, sdf, s[p], v_bar[p])
        c, d = adjoint_rows(v[p], r[p], e[p], row, sdf, s[p], v_bar[p], row_bar)
        o_bar[p] = a
        same_bar[p] = c
        e_bar[p] = real(0.5) * (b + d)

    return evaluate, vec3, wall_t


def contact(walls: Sequence, v, r, s, row, v_bar=None, real=wp.float64):
    """Velocities after the walls, gradients in those before, and in the rows, all of M nodes at once."""
    o, o_bar, _, row_bar = elastic_contact(walls, v, r, np.zeros((len(v), 4)), s, row, v_bar, real, elastic=False)
    return o, o_bar, row_bar


def elastic_contact(walls: Sequence, v, r, e, s, row, v_bar=None, real=wp.float64, elastic=True):
    """The same of walls that may be elastic, and the gradients in what they read.

    Args:
        v, r, v_bar: shape (M, 3).
        e: shape (M, 4).
        s: row of each, shape (M,).
        row: from ``rows``.
    """
    evaluate, vec3, wall_t = kernels(signature(walls, elastic), real)
    row_bar = wp.zeros(row.shape[:2], dtype=wall_t, device="cpu")
    o, o_bar, same_bar = (wp.zeros(len(v), dtype=vec3, device="cpu") for _ in range(3))
    e_bar = wp.zeros(len(v), dtype=wp.types.vector(4, real), device="cpu")
    v_bar = np.zeros_like(v) if v_bar is None else v_bar
    sdf = wp.array(sdf_samples(walls), dtype=real, device="cpu")
    wp.launch(
        evaluate,
        dim=len(v),
        inputs=[
            *(wp.array(a, dtype=vec3, device="cpu") for a in (v, r)),
            wp.array(e, dtype=wp.types.vector(4, real), device="cpu"),
            wp.array(s, dtype=wp.int32, device="cpu"),
            wp.array(row, dtype=wall_t, device="cpu"),
            sdf,
            wp.array(v_bar, dtype=vec3, device="cpu"),
            o,
            o_bar,
            same_bar,
            e_bar,
            row_bar,
        ],
        device="cpu",
    )
    assert np.array_equal(o_bar.numpy(), same_bar.numpy())
    return o.numpy(), o_bar.numpy(), e_bar.numpy(), row_bar.numpy()


def coulomb(v, n, S, kind, mu):
    """The law of contact: the velocity of a governed node, of M nodes at once, shape (M, 3)."""
    u = v - S
    u_n = (u * n).sum(1, keepdims=True)
    t = u - u_n * n
    if kind == "sticky":
        return S
    if kind == "slip":
        return S + t
    length = np.linalg.norm(t, axis=1, keepdims=True)
    return np.where(u_n >= 0, v, S + t * np.maximum(0, 1 - mu * np.abs(u_n) / length))


def box_mesh(size) -> tuple[np.ndarray, np.ndarray]:
    """Corners and triangles of a box about the origin."""
    x = 0.5 * np.asarray(size) * np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return x, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])


def ball_mesh(n: int, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """A ball of n bands of latitude and 2 n of longitude, corners on its surface."""
    lat, lon = np.meshgrid(np.pi * np.arange(1, n) / n, np.pi * np.arange(2 * n) / n, indexing="ij")
    ring = np.stack([np.sin(lat) * np.cos(lon), np.sin(lat) * np.sin(lon), np.cos(lat)], -1).reshape(-1, 3)
    x = radius * np.concatenate([[[0.0, 0.0, 1.0]], ring, [[0.0, 0.0, -1.0]]])
    m, south, faces = 2 * n, len(x) - 1, []
    for j in range(m):
        k = (j + 1) % m
        faces.append((0, 1 + j, 1 + k))
        for i in range(n - 2):
            a, b = 1 + i * m, 1 + (i + 1) * m
            faces += [(a + j, b + j, b + k), (a + j, b + k, a + k)]
        faces.append((1 + (n - 2) * m + j, south, 1 + (n - 2) * m + k))
    return x, np.array(faces)
