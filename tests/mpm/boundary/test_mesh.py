"""Signed-distance walls against the shapes they were made from."""

import numpy as np
import pytest
import warp as wp

from diffuphy.mpm import Grid, Mesh, Sphere
from diffuphy.mpm.boundary import N_WALL, rows, sdf_samples
from diffuphy.mpm.boundary.kernels_mesh import triangle_distance
from diffuphy.mpm.boundary.kernels_shapes import make_surface
from diffuphy.mpm.boundary.mesh import MAX_SAMPLES
from tests.mpm.walls import ball_mesh, box_mesh

FINE = Grid(1e-18, (0, 0, 0), (4, 4, 4))
"""A grid so fine that SLACK Δx is nothing."""
VEC3, WALL = wp.types.vector(3, wp.float64), wp.types.vector(N_WALL, wp.float64)
SURFACE = make_surface("Mesh", wp.float64)


@wp.kernel(module="unique", enable_backward=False)
def evaluate(
    r: wp.array[VEC3], row: wp.array2d[WALL], sdf: wp.array[wp.float64], b: wp.int32, phi: wp.array[wp.float64],
    normal: wp.array[VEC3],
):  # fmt: skip
    p = wp.tid()
    n, d = SURFACE(row[0, b], r[p], sdf)
    normal[p] = n
    phi[p] = d


def surface(meshes, r: np.ndarray, b: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """φ and n of mesh b at points (M, 3)."""
    phi, n = wp.zeros(len(r), dtype=wp.float64, device="cpu"), wp.zeros(len(r), dtype=VEC3, device="cpu")
    row = wp.array(rows(meshes, FINE, np.zeros(1)), dtype=WALL, device="cpu")
    sdf = wp.array(sdf_samples(meshes), dtype=wp.float64, device="cpu")
    wp.launch(evaluate, dim=len(r), inputs=[wp.array(r, dtype=VEC3, device="cpu"), row, sdf, b, phi, n], device="cpu")
    return phi.numpy(), n.numpy()


def shell(radius: float, m: int = 4000) -> np.ndarray:
    """Points within 10 % of a sphere."""
    rng = np.random.default_rng(1)
    e = rng.normal(size=(m, 3))
    return radius * rng.uniform(0.9, 1.1, (m, 1)) * e / np.linalg.norm(e, axis=1, keepdims=True)


def test_a_ball_of_triangles_converges_to_a_ball():
    """|φ − (|x| − R)| = O(h²) and |n − x/|x|| = O(h), triangles and samples refined together."""
    r, phi_error, n_error = shell(0.5), [], []
    for n in (8, 16, 32):
        x, f = ball_mesh(2 * n, 0.5)
        phi, normal = surface((Mesh(vertices=x, faces=f, resolution=n),), r)
        length = np.linalg.norm(r, axis=1)
        phi_error.append(np.sqrt(np.mean((phi - (length - 0.5)) ** 2)))
        n_error.append(np.sqrt(np.mean(np.sum((normal - r / length[:, None]) ** 2, 1))))
    orders = [np.log2(np.array(e[:-1]) / np.array(e[1:])) for e in (phi_error, n_error)]
    assert np.all(np.abs(orders[0] - 2.0) < 0.3), (phi_error, orders)
    assert np.all(np.abs(orders[1] - 1.0) < 0.3), (n_error, orders)
    # interpolation of a function with ∇²φ = 2/R errs by at most h²/8 · 2/R, edges of length e cut off e²/(8 R)
    h, e = 1 / 31, np.pi * 0.5 / 64
    assert phi_error[-1] < h * h / 4 / 0.5 + e * e / 8 / 0.5


def test_a_cube_of_triangles_is_exact_at_its_faces():
    """φ is linear within a cell of a face, away from edges: trilinear interpolation keeps it, and the sign is exact."""
    x, f = box_mesh((1.0, 1.0, 1.0))
    cube = (Mesh(vertices=x, faces=f, resolution=21),)
    rng = np.random.default_rng(2)
    r = rng.uniform(-0.3, 0.3, (600, 3))
    axis, side = rng.integers(0, 3, 600), rng.choice([-1.0, 1.0], 600)
    depth = rng.uniform(-0.09, 0.09, 600)
    r[np.arange(600), axis] = side * (0.5 + depth)
    phi, n = surface(cube, r)
    # samples are distances in float64: a few rounding errors of coordinates of size 1
    np.testing.assert_allclose(phi, depth, rtol=0, atol=1e-14)
    np.testing.assert_allclose(n[np.arange(600), axis], side, rtol=0, atol=1e-13)
    # and everywhere, also around edges, within the spacing of the samples of the exact distance
    r = rng.uniform(-0.55, 0.55, (4000, 3))
    q = np.abs(r) - 0.5
    exact = np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(1), 0)
    phi, _ = surface(cube, r)
    assert np.abs(phi - exact).max() < cube[0].spacing


def test_a_mesh_is_placed_turned_and_found_among_others():
    """φ(x) = φ₀(Rᵀ (x − c)) and n = R n₀, for the second of two meshes of different size."""
    x, f = box_mesh((0.8, 0.6, 1.0))
    plain = Mesh(vertices=x, faces=f, resolution=17)
    placed = Mesh(vertices=x, faces=f, resolution=17, center=(1.0, 2.0, 3.0), rotation=(0.0, 0.0, np.pi / 2))
    ball = Mesh(vertices=(b := ball_mesh(6, 0.3))[0], faces=b[1], resolution=9)
    r = np.random.default_rng(4).uniform(-0.6, 0.6, (500, 3))
    there = np.stack([-r[:, 1], r[:, 0], r[:, 2]], 1) + np.array([1.0, 2.0, 3.0])
    (phi0, n0), (phi, n) = surface((plain,), r), surface((ball, placed), there, 1)
    inside = phi0 < 0.9  # elsewhere both say 1: beyond the samples
    # a point on the border of two cells of samples may be taken by either
    same = np.abs(n - np.stack([-n0[:, 1], n0[:, 0], n0[:, 2]], 1)).max(1) < 1e-12
    np.testing.assert_allclose(phi[inside], phi0[inside], rtol=0, atol=1e-14)
    assert same[inside].mean() > 0.99 and inside.sum() > 200


def test_everything_beyond_the_samples_is_outside():
    """Far points are never governed, whatever the size of the mesh."""
    x, f = ball_mesh(8, 1e3)
    phi, _ = surface((Mesh(vertices=x, faces=f, resolution=8),), np.array([[5e3, 0.0, 0.0], [0.0, -1e9, 0.0]]))
    assert (phi > 0).all()


def test_holes_and_overlaps_do_not_turn_a_mesh_inside_out():
    """The winding number of a ball with one small hole, joined with another that overlaps it, is right at every sample
    that is not at the hole."""
    x, f = ball_mesh(12, 0.5)
    other = x + np.array([0.4, 0.0, 0.0])
    both = Mesh(vertices=np.concatenate([x, other]), faces=np.concatenate([f[1:], f + len(x)]), resolution=24)
    nx, ny, nz = both.shape
    at = both.corner + both.spacing * np.stack(np.meshgrid(*map(np.arange, (nx, ny, nz)), indexing="ij"), -1)
    a, b = np.linalg.norm(at, axis=-1), np.linalg.norm(at - [0.4, 0.0, 0.0], axis=-1)
    sign = np.sign(both.samples.reshape(nx, ny, nz))
    away = np.linalg.norm(at - f_center(x, f[0]), axis=-1) > 0.2
    assert (sign[(np.minimum(a, b) < 0.45) & away] < 0).all() and (sign[(np.minimum(a, b) > 0.52) & away] > 0).all()


def f_center(x: np.ndarray, face: np.ndarray) -> np.ndarray:
    return x[face].mean(0)


def test_the_distance_from_a_triangle_is_the_smallest_to_its_points():
    """Against the minimum over a fine sampling of the triangle, above, beside and at its corners."""
    rng = np.random.default_rng(5)
    a, b, c = rng.normal(size=(3, 1, 3))
    p = 2 * rng.normal(size=(200, 3))
    u, v = np.meshgrid(np.linspace(0, 1, 401), np.linspace(0, 1, 401))
    u, v = u[u + v <= 1 + 1e-12], v[u + v <= 1 + 1e-12]
    points = a + u[:, None] * (b - a) + v[:, None] * (c - a)
    want = np.array([np.linalg.norm(points - q, axis=1).min() for q in p])
    got = triangle_distance(p, *(np.broadcast_to(t, p.shape) for t in (a, b, c)))
    size = max(np.linalg.norm(b - a), np.linalg.norm(c - a), np.linalg.norm(c - b)) / 400
    assert (got <= want + 1e-12).all() and (want <= np.sqrt(got**2 + size**2) + 1e-12).all()


@pytest.mark.parametrize(
    "change, message",
    [
        (dict(vertices=np.zeros((3, 2))), r"shape \(V, 3\)"),
        (dict(vertices=np.full((8, 3), np.nan)), "finite, got .* in row 0"),
        (dict(faces=np.zeros((12, 3))), "faces must be integers"),
        (dict(faces=box_mesh((1, 1, 1))[1] + 1), r"vertices 0 … 7, got \[.*8.*\] in row"),
        (dict(faces=box_mesh((1, 1, 1))[1][:, ::-1]), "counter-clockwise"),
        (dict(resolution=4), "resolution must be between 8 and 256"),
    ],
)
def test_meshes_that_cannot_be_are_refused(change, message):
    x, f = box_mesh((1.0, 1.0, 1.0))
    with pytest.raises(ValueError, match=message):
        Mesh(**{"vertices": x, "faces": f, **change})


def test_more_samples_than_a_row_counts_are_refused():
    x, f = box_mesh((1.0, 1.0, 1.0))
    with pytest.raises(ValueError, match=f"at most {MAX_SAMPLES} are allowed"):
        sdf_samples((Sphere(), Mesh(vertices=x, faces=f, resolution=255)))
