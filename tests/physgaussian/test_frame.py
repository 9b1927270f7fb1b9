"""The box of a scene file in the frame of a film."""

import numpy as np
import pytest

from diffuphy.physgaussian.frame import Frame

AXES = [tuple(s * e) for e in np.eye(3) for s in (1.0, -1.0)]


@pytest.mark.parametrize("up", AXES)
def test_turn_is_a_rotation_that_takes_their_vertical_to_z(up):
    """Qᵀ Q = 1, det Q = 1, Q up = e_z; exactly, since every entry is 0 or ±1."""
    Q = Frame(up).turn
    assert np.array_equal(Q.T @ Q, np.eye(3)) and np.linalg.det(Q) == 1.0
    assert np.array_equal(Q @ np.asarray(up), [0.0, 0.0, 1.0])


def test_z_up_is_left_as_it_is():
    assert np.array_equal(Frame((0.0, 0.0, 2.5)).turn, np.eye(3))


@pytest.mark.parametrize("up", AXES)
def test_a_point_is_in_a_box_here_as_there(up):
    """|x − point| < half along every axis there ⟺ low < x' < high here."""
    frame, rng = Frame(up, 0.7), np.random.default_rng(0)
    point, half = (1.2, 0.8, 1.1), (0.3, 0.2, 0.1)
    low, high = frame.corners(point, half)
    points = rng.uniform(0.5, 1.5, (500, 3))
    there = (np.abs(points - point) < half).all(1)
    here = np.array([all(a < c < b for a, b, c in zip(low, high, frame.point(tuple(p)), strict=True)) for p in points])
    assert there.any() and np.array_equal(there, here)


def test_middle_of_the_object_is_at_its_height():
    assert Frame((0.0, 1.0, 0.0), 0.5).point((1.0, 1.0, 1.0)) == (0.0, 0.0, 0.5)
    assert Frame((0.0, 1.0, 0.0), 0.5).vector((0.0, 3.0, 0.0)) == (0.0, 0.0, 3.0)
