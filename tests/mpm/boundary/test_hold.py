"""What walls that hold always leave of an acceleration, against what they do to velocities."""

import numpy as np
import pytest
import warp as wp

from diffuphy.mpm import Box, Cylinder, HalfSpace, Sphere
from diffuphy.mpm.boundary import make_contact, make_hold, rows, sdf_samples, signature
from tests.mpm.walls import HERE, contact

WALLS = (
    HalfSpace(point=(0.0, 0.0, 1.1), normal=(0.3, 0.0, 1.0), kind="slip", velocity=(0.4, 0.1, -0.2)),
    Sphere(center=(1.5, 1.5, 1.0), radius=0.9, kind="slip", angular_velocity=(0.0, 2.0, 1.0)),
    Box(center=(2.5, 1.0, 2.0), size=(1.0, 2.0, 1.0), kind="sticky", velocity=(0.0, 1.0, 0.0)),
    Cylinder(center=(0.5, 2.0, 2.0), axis=(0.0, 0.0, 1.0), radius=0.7, height=2.0, kind="slip", start=1.0),
)


def held(walls, which, a, r, row) -> np.ndarray:
    """Π a of every node."""
    sig = signature(walls)
    vec3, wall_t = wp.types.vector(3, wp.float64), make_contact(sig, wp.float64).wall_t
    hold = make_hold(sig, which, wp.float64)

    @wp.kernel(module="unique", enable_backward=False)
    def evaluate(
        a: wp.array[vec3], r: wp.array[vec3], row: wp.array2d[wall_t], sdf: wp.array[wp.float64], out: wp.array[vec3]
    ):
        p = wp.tid()
        out[p] = hold(a[p], r[p], row, sdf, 0)

    out = wp.zeros(len(a), dtype=vec3, device="cpu")
    given = [wp.array(t, dtype=vec3, device="cpu") for t in (a, r)]
    sdf = wp.array(sdf_samples(walls), dtype=wp.float64, device="cpu")
    wp.launch(evaluate, dim=len(a), inputs=[*given, wp.array(row, dtype=wall_t, device="cpu"), sdf, out], device="cpu")
    return out.numpy()


@pytest.fixture(scope="module")
def nodes():
    """Places inside, outside and in several walls at once, two vectors each, and the walls before the last begins."""
    rng = np.random.default_rng(0)
    r = rng.uniform(0.0, 3.0, (400, 3))
    return rng.normal(size=(400, 3)), rng.normal(size=(400, 3)), r, rows(WALLS, HERE, np.zeros(1))


def test_it_is_the_linear_part_of_the_contact(nodes):
    """Π a = contact(v + a) − contact(v) for every v, whatever the velocities of the walls; a wall that does not act yet
    leaves everything."""
    a, v, r, row = nodes
    left = held(WALLS, (0, 1, 2, 3), a, r, row)
    s = np.zeros(len(a), np.int32)
    after, before = (contact(WALLS, u, r, s, row)[0] for u in (v + a, v))
    # differences of velocities of about 5 m/s, each rounded to 1e-16 of that
    np.testing.assert_allclose(left, after - before, rtol=0, atol=1e-14)
    changed = np.abs(left - a).max(1) > 1e-3
    assert 0.2 < changed.mean() < 0.9 and (np.abs(left).max(1) == 0.0).any()  # some are free, some slide, some stick


def test_the_opposite_order_is_its_transpose(nodes):
    """⟨b, Π a⟩ = ⟨Πᵀ b, a⟩ node by node, Πᵀ = Π_1 Π_2 …; the orders differ where two slip walls meet."""
    a, b, r, row = nodes
    left, back = held(WALLS, (0, 1, 2), a, r, row), held(WALLS, (2, 1, 0), b, r, row)
    # products of three numbers of about 3
    np.testing.assert_allclose((b * left).sum(1), (back * a).sum(1), rtol=0, atol=1e-13)
    assert np.abs(held(WALLS, (2, 1, 0), a, r, row) - left).max() > 1e-2


def test_a_wall_that_separates_is_refused():
    with pytest.raises(ValueError, match="wall 1 separates"):
        make_hold(signature((HalfSpace(kind="slip"), HalfSpace())), (0, 1), wp.float64)
