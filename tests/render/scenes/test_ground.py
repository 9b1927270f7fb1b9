"""The ground of a scene."""

import math

import pytest
import torch

from diffuphy.geometry import rotations
from diffuphy.render.scenes.ground import THICKNESS, find_ground, given_ground

NOISE = 0.004


def scene(tilt: float = 0.0, *, ground: int = 600, things: int = 500, below: int = 10) -> torch.Tensor:
    """A ground z = 0.2 of 4 x 4, things up to 2 above it, a few floaters below; turned about x by ``tilt`` [deg]."""
    g = torch.Generator().manual_seed(1)

    def box(n: int, low: tuple, high: tuple) -> torch.Tensor:
        a, b = torch.tensor(low), torch.tensor(high)
        return a + (b - a) * torch.rand(n, 3, generator=g)

    flat = box(ground, (-2.0, -2.0, 0.2), (2.0, 2.0, 0.2)) + NOISE * torch.randn(ground, 3, generator=g)
    x = torch.cat(
        [flat, box(things, (-0.5, -0.5, 0.3), (0.5, 0.5, 2.0)), box(below, (-1.0, -1.0, -1.0), (1.0, 1.0, 0))]
    )
    c, s = math.cos(math.radians(tilt)), math.sin(math.radians(tilt))
    return x @ torch.tensor([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]]).mT


@pytest.mark.parametrize(("tilt", "upright"), [(0.0, True), (12.0, True), (115.0, False), (180.0, False)])
def test_the_ground_is_found_up_to_its_noise(tilt, upright):
    """Normal and height by least squares over n = 540 noisy points: σ/(√n · 1.15) rad, the spread of ±2 being 1.15, and
    σ/√n; here with a factor of five, and what of the things lies within its thickness."""
    found = find_ground(scene(tilt), upright=upright)
    t = math.radians(tilt)
    normal = torch.tensor([0.0, -math.sin(t), math.cos(t)], dtype=torch.float64)
    assert float(torch.linalg.cross(found.normal, normal).norm()) < 5 * NOISE / math.sqrt(540) / 1.15 + 1e-3
    assert float(found.normal @ normal) > 0.99, "it points to the things"
    assert found.height == pytest.approx(0.2, abs=5 * NOISE / math.sqrt(540) + 1e-3)
    assert found.share == pytest.approx(600 / 1110, abs=0.03)


def test_turned_level_the_normal_is_z():
    """R n = e_z to rounding, also for a scene upside down."""
    for tilt in (0.0, 40.0, 180.0):
        found = find_ground(scene(tilt), upright=False)
        e = rotations(found.quat) @ found.normal
        torch.testing.assert_close(e, torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64), rtol=0, atol=1e-12)


def test_the_same_seed_finds_the_same_ground():
    a, b = find_ground(scene(), seed=3), find_ground(scene(), seed=3)
    assert torch.equal(a.normal, b.normal) and a.height == b.height


def test_a_cloud_has_no_ground():
    """A slab of a fiftieth of a cube holds a fiftieth of it, and a table top has as much below it as above."""
    g = torch.Generator().manual_seed(0)
    with pytest.raises(ValueError, match=r"no ground found.*gaussians\.ground=-0\.3"):
        find_ground(torch.rand(3000, 3, generator=g))


def test_a_wall_and_a_ceiling_are_no_ground():
    """Upright, steep planes do not count; a plane with more than 5 % below it is none."""
    with pytest.raises(ValueError, match="no ground found"):
        find_ground(scene(80.0))
    with pytest.raises(ValueError, match="no ground found"):
        find_ground(-scene())


def test_few_points_and_one_point_are_refused():
    for x in (torch.zeros(2, 3), torch.zeros(50, 3)):
        with pytest.raises(ValueError, match="no ground found"):
            find_ground(x)


def test_a_given_ground_is_level_and_as_thick_as_a_found_one():
    x = scene()
    found, given = find_ground(x), given_ground(x, 0.2)
    assert given.normal.tolist() == [0.0, 0.0, 1.0] and given.height == 0.2
    # the extent leaves out a hundredth at each end: 4 · 0.98, of 600 points spread at random
    for plane in (found, given):
        assert plane.tolerance == pytest.approx(4 * 0.98 * THICKNESS, rel=0.03)
    assert given.above(torch.tensor([[0.0, 0.0, 0.3], [0.0, 0.0, 0.21], [0.0, 0.0, -1.0]])).tolist() == [
        True,
        False,
        False,
    ]
