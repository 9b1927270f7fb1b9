"""Signed distance of a triangle mesh on a regular grid of samples."""

import math

import numpy as np
import warp as wp

from diffuphy.compiling import LOCK

CHUNK = 2**18
"""Samples whose distances are computed at once: some 100 MB."""

REACH = 4.0
"""How far a closest point is searched for, in diagonals of the sampled box: further than any can be [-]."""


@wp.kernel(module="unique", enable_backward=False)
def _sample(
    mesh: wp.uint64,
    corner: wp.vec3,  # [m]  first sample
    h: wp.float32,  # [m]  spacing
    n: wp.vec3i,  # samples along each axis
    far: wp.float32,  # [m]  more than any distance
    face: wp.array[wp.int32],  # (nx ny nz,)  closest triangle   out
    side: wp.array[wp.float32],  # (nx ny nz,)  −1 inside, 1 outside   out
):
    o = wp.tid()
    yz = n[1] * n[2]
    i = o // yz
    j = (o - i * yz) // n[2]
    k = o - i * yz - j * n[2]
    q = wp.mesh_query_point_sign_winding_number(mesh, corner + h * wp.vec3(float(i), float(j), float(k)), far)
    face[o] = q.face
    side[o] = q.sign


def triangle_distance(p: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Distance of points from triangles, each of shape (M, 3), row by row, shape (M,) [m].

    The foot of the perpendicular if it lies in the triangle, else the nearest point of an edge.
    """
    n = np.cross(b - a, c - a)
    edges, inside = [], np.ones(len(p), dtype=bool)
    for s, e in ((a, b), (b, c), (c, a)):
        d, r = e - s, p - s
        inside &= np.einsum("mi,mi->m", np.cross(d, r), n) >= 0
        t = np.einsum("mi,mi->m", r, d) / np.maximum(np.einsum("mi,mi->m", d, d), np.finfo(float).tiny)
        edges.append(np.linalg.norm(r - np.clip(t, 0, 1)[:, None] * d, axis=1))
    length = np.linalg.norm(n, axis=1)
    height = np.abs(np.einsum("mi,mi->m", p - a, n)) / np.maximum(length, np.finfo(float).tiny)
    return np.where(inside & (length > 0), height, np.min(edges, axis=0))


def signed_distance(
    vertices: np.ndarray, faces: np.ndarray, corner: np.ndarray, h: float, shape: tuple[int, int, int]
) -> np.ndarray:
    """Signed distance φ at the samples corner + h (i, j, k), last axis fastest, shape (nx ny nz,) float64 [m].

    Closest triangle and sign are found in float32, in units of the box and from its middle; the distance from that
    triangle is computed in float64.
    """
    size = h * max(shape)
    middle = corner + 0.5 * h * (np.asarray(shape) - 1)
    count = math.prod(shape)
    with LOCK:  # the first launch builds the kernel
        mesh = wp.Mesh(
            points=wp.array((vertices - middle) / size, dtype=wp.vec3, device="cpu"),
            indices=wp.array(faces.reshape(-1), dtype=wp.int32, device="cpu"),
            support_winding_number=True,
        )
        face = wp.zeros(count, dtype=wp.int32, device="cpu")
        side = wp.zeros(count, dtype=wp.float32, device="cpu")
        inputs = [mesh.id, wp.vec3(*((corner - middle) / size)), h / size, wp.vec3i(*shape), REACH, face, side]
        wp.launch(_sample, dim=count, inputs=inputs, device="cpu")
    phi, face = side.numpy().astype(np.float64), face.numpy()
    for at in range(0, count, CHUNK):
        o = np.arange(at, min(at + CHUNK, count))
        points = corner + h * np.stack(np.unravel_index(o, shape), axis=1)
        phi[o] *= triangle_distance(points, *(vertices[faces[face[o], k]] for k in range(3)))
    return phi
