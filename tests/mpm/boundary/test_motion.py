"""Poses: constant velocities and schedules move and turn walls consistently with the velocity of their surface."""

import math

import numpy as np
import pytest

from diffuphy.mpm import Box, Cylinder, HalfSpace, Schedule, Sphere
from diffuphy.mpm.boundary.layout import ACTS, ANGULAR_VELOCITY, FRAME, PIVOT, VELOCITY, rows
from diffuphy.mpm.boundary.motion import left_jacobian, rotation_matrix
from tests.mpm.walls import HERE

KNOTS = Schedule(
    times=(0.5, 1.0, 2.0, 2.5),
    offsets=((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 2.0, 0.0), (1.0, 2.0, 0.0)),
    rotations=((0.0, 0.0, 0.0), (0.3, -0.4, 1.0), (2.0, 1.0, 9.0), (2.0, 1.0, 9.0)),
)


def test_rotations_are_exponentials_with_the_left_jacobian():
    """exp [r]× is orthogonal and turns r onto itself; d exp [r + t a]× = [J(r) a]× exp [r]×, small to many turns."""
    rng = np.random.default_rng(0)
    for scale in (0.0, 1e-9, 1e-4, 1.0, 3.0, 20.0):
        r, a, h = scale * rng.normal(size=3), rng.normal(size=3), 1e-5
        R, J = rotation_matrix(r), left_jacobian(r)
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=4e-15)
        np.testing.assert_allclose(R @ r, r, rtol=1e-13, atol=1e-15)
        dR = (rotation_matrix(r + h * a) - rotation_matrix(r - h * a)) / (2 * h)
        W = dR @ R.T
        np.testing.assert_allclose([W[2, 1], W[0, 2], W[1, 0]], J @ a, rtol=0, atol=1e-8)


def motion(wall, t: float) -> tuple[np.ndarray, np.ndarray]:
    """Where a point of the wall is that was at (0.3, 0.2, 0.1) from its centre, and its velocity from V and ω."""
    row = rows((wall,), HERE, np.array([t]))[0, 0]
    arm = row[FRAME].reshape(3, 3) @ np.array([0.3, 0.2, 0.1])
    return row[PIVOT] + arm, row[VELOCITY] + np.cross(row[ANGULAR_VELOCITY], arm)


@pytest.mark.parametrize(
    "wall",
    [
        Box(velocity=(0.1, -0.2, 0.3), angular_velocity=(1.0, 2.0, -3.0), rotation=(0.2, 0.1, 0.0), start=-1.0),
        Box(schedule=KNOTS, rotation=(0.2, 0.1, 0.0)),
        Cylinder(axis=(1.0, 1.0, 0.0), angular_velocity=(0.0, 5.0, 0.0)),
    ],
    ids=["constant", "schedule", "cylinder"],
)
def test_velocities_are_the_rates_of_poses(wall):
    """dx/dt = V + ω × (x − c) for every point of a wall."""
    for t in (0.1, 0.7, 1.3, 1.9, 2.2, 3.0):
        h = 1e-5
        rate = (motion(wall, t + h)[0] - motion(wall, t - h)[0]) / (2 * h)
        # h² x'''/6 with |x'''| ≤ ω³ |arm| = 1e3 · 0.4
        np.testing.assert_allclose(motion(wall, t)[1], rate, rtol=0, atol=3e-8)


def test_a_schedule_reaches_its_knots_and_rests_outside_them():
    """c = c₀ + offset at each time; at rest before the first and after the last; at a knot the next piece rules."""
    row = rows((Sphere(center=(1.0, 1.0, 1.0), schedule=KNOTS),), HERE, np.array([0.0, *KNOTS.times, 9.0]))[:, 0]
    np.testing.assert_allclose(row[1:5, :3] - 1.0, KNOTS.offsets, rtol=0, atol=1e-15)
    np.testing.assert_allclose(row[[0, 5], :3] - 1.0, [KNOTS.offsets[0], KNOTS.offsets[-1]], rtol=0, atol=1e-15)
    assert not row[[0, 3, 4, 5], 4:7].any() and not row[[0, 3, 4, 5], 9:12].any()
    np.testing.assert_allclose(row[1:3, 4:7], [(2.0, 0.0, 0.0), (0.0, 2.0, 0.0)], rtol=1e-14)


def test_start_stop_and_reset_are_honoured_to_the_step():
    """A wall acts in start ≤ t < end + reset; from end on it stands where it was then."""
    wall = Box(kind="sticky", velocity=(2.0, 0.0, 0.0), angular_velocity=(0.0, 0.0, 1.0), start=1.0, end=2.0, reset=0.5)
    dt = 1e-3
    times = dt * np.arange(3000)
    row = rows((wall,), HERE, times)[:, 0]
    np.testing.assert_array_equal(row[:, ACTS], (times >= 1.0) & (times < 2.5))
    assert row[1999, 4] == 2.0 and row[1999, 11] == 1.0
    assert not row[2000:, 4:7].any() and not row[2000:, 9:12].any()
    np.testing.assert_allclose(row[2000:, 0], 2.0, rtol=0, atol=1e-15)
    np.testing.assert_allclose(row[2499, FRAME], rotation_matrix(np.array([0.0, 0.0, 1.0])).ravel(), atol=1e-15)


def test_a_half_space_turns_about_its_point():
    """n(t) = exp(t [ω]×) n, and the plane goes on through its point."""
    point, spin = (0.5, 0.0, 2.0), 0.3
    row = rows((HalfSpace(point=point, angular_velocity=(0.0, spin, 0.0)),), HERE, np.array([0.0, 2.0]))[:, 0]
    np.testing.assert_allclose(row[1, :3], (math.sin(0.6), 0.0, math.cos(0.6)), rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(row[:, 3] - 1e-3, row[:, :3] @ np.asarray(point), rtol=1e-14)


def test_the_speed_of_a_wall_bounds_that_of_its_surface():
    """|V + ω × (x − c)| ≤ speed over the corners of a box and, of a half-space, over a region."""
    w, V = np.array([1.0, -2.0, 0.5]), np.array([0.3, 0.1, 0.0])
    box = Box(size=(1.0, 2.0, 0.5), velocity=tuple(V), angular_velocity=tuple(w))
    corners = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]) * [0.5, 1.0, 0.25]
    fastest = np.linalg.norm(V + np.cross(w, corners), axis=1).max()
    assert fastest <= box.speed < 1.5 * fastest
    table = HalfSpace(angular_velocity=(0.0, 0.0, 2.0))
    assert table.speed == 0.0
    assert table.speed_within((-3.0, 0.0, 0.0), (1.0, 4.0, 0.0), 0.0) == pytest.approx(2.0 * 5.0, rel=1e-14)
    assert Sphere(radius=0.5, schedule=KNOTS).speed == pytest.approx(2.0 + math.hypot(1.7, 1.4, 8.0) * 0.5, rel=1e-14)
    assert Sphere(velocity=(3.0, 4.0, 0.0)).speed == 5.0 and HalfSpace().still and not HalfSpace(schedule=KNOTS).still


@pytest.mark.parametrize(
    "wrong, message",
    [
        (dict(times=(0.0,), offsets=((0, 0, 0),)), "at least two"),
        (dict(times=(0.0, 0.0), offsets=((0, 0, 0),) * 2), "increase"),
        (dict(times=(0.0, math.inf), offsets=((0, 0, 0),) * 2), "finite"),
        (dict(times=(0.0, math.nan), offsets=((0, 0, 0),) * 2), "increase"),
        (dict(times=(0.0, 1.0)), "moves nothing"),
        (dict(times=(0.0, 1.0), offsets=((0, 0, 0),)), "one entry for each of the 2 times, got 1"),
        (dict(times=(0.0, 1.0), rotations=((0, 0, 0), (0, math.nan, 0))), r"rotations\[1\]"),
    ],
)
def test_schedules_that_cannot_be_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        Schedule(**wrong)
