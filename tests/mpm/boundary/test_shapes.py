"""Settings of walls: what is refused, and the box of six."""

import math

import numpy as np
import pytest

from diffuphy.mpm import Box, Cylinder, HalfSpace, Scene, Schedule, Sphere, container

MOVES = Schedule(times=(0.0, 1.0), offsets=((0.0, 0.0, 0.0), (1.0, 0.0, 0.0)))


@pytest.mark.parametrize(
    "shape, wrong, message",
    [
        (Box, dict(size=(1.0, 0.0, 1.0)), "every edge in size must be positive and finite, got 0.0 m"),
        (Box, dict(size=(1.0, math.inf, 1.0)), "size must be three finite numbers"),
        (Box, dict(rotation=(0.0, math.nan, 0.0)), "rotation"),
        (Cylinder, dict(axis=(0.0, 0.0, 0.0)), "axis must not be zero"),
        (Cylinder, dict(radius=-1.0), "radius must be positive"),
        (Cylinder, dict(height=math.nan), "height must be positive"),
        (Sphere, dict(angular_velocity=(0.0, math.inf, 0.0)), "angular_velocity"),
        (Sphere, dict(schedule=MOVES, velocity=(1.0, 0.0, 0.0)), "a wall with a schedule has no velocity"),
        (HalfSpace, dict(reset=0.1), "reset = 0.1 s counts from end"),
        (HalfSpace, dict(end=1.0, reset=-0.1), "reset must be finite and not negative"),
        (HalfSpace, dict(start=-math.inf), "start"),
        (HalfSpace, dict(start=math.nan), "start"),
        (HalfSpace, dict(friction=math.nan), "friction"),
    ],
)
def test_walls_that_cannot_be_are_refused(shape, wrong, message):
    with pytest.raises(ValueError, match=message):
        shape(**wrong)


def test_a_container_faces_inwards_on_all_six_sides():
    """φ_k(x) = distance of an inner point from each side; the product of the sides is the box."""
    low, high = (-1.0, 0.0, 2.0), (1.0, 3.0, 4.0)
    walls = container(low, high, friction=0.2)
    inside = np.array([0.2, 1.0, 3.5])
    phi = [float((inside - w.point) @ np.asarray(w.normal)) for w in walls]
    np.testing.assert_allclose(sorted(phi), sorted([1.2, 0.8, 1.0, 2.0, 1.5, 0.5]), rtol=1e-14)
    assert all(w.friction == 0.2 and w.kind == "separate" and w.still for w in walls)
    with pytest.raises(ValueError, match="low < high"):
        container((0.0, 0.0, 0.0), (1.0, 0.0, 1.0))


def test_shapes_that_slip_between_nodes_are_refused():
    """A solid thinner than 3 Δx, named with its place in the list; half-spaces have no thickness."""
    for thin in (
        Sphere(radius=0.14),
        Box(size=(1.0, 0.29, 1.0)),
        Cylinder(radius=1.0, height=0.29),
        Cylinder(radius=0.1),
    ):
        with pytest.raises(ValueError, match=rf"boundaries\[1\], a {type(thin).__name__} .* at least 3 dx = 0.3 m"):
            Scene(dx=0.1, boundaries=(HalfSpace(), thin))
    Scene(dx=0.1, boundaries=(HalfSpace(),) * 20)


def test_axes_of_a_cylinder_are_orthonormal():
    """Third column: its axis; a right-handed frame for any axis."""
    for axis in [(0, 0, 1), (0, 0, -2), (1, 0, 0), (0, -1, 0), (1, 1, 1), (1e-9, 1, 0)]:
        R = Cylinder(axis=axis).frame
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-15)
        np.testing.assert_allclose(R[:, 2], np.asarray(axis) / np.linalg.norm(axis), rtol=0, atol=1e-15)
        assert np.linalg.det(R) == pytest.approx(1.0, rel=1e-14)
