"""Cameras look at the object, evenly from everywhere they may stand."""

import math

import pytest
import torch

from diffuphy.losses.guidance import view_words
from diffuphy.render import orbit
from diffuphy.text2gs.cameras import Orbits


def positions(camera):
    return -torch.einsum("cji,cj->ci", camera.viewmats[:, :3, :3], camera.viewmats[:, :3, 3])


def test_viewmats_are_rigid_and_look_at_the_origin():
    """Rᵀ R = I, det R = 1; the origin is on the optical axis at the given distance; world z points up in the picture
    (−y)."""
    camera = Orbits(bank=50, distance=3.0)()
    R = camera.viewmats[:, :3, :3]
    torch.testing.assert_close(R @ R.mT, torch.eye(3).expand_as(R), atol=1e-6, rtol=0)
    torch.testing.assert_close(torch.linalg.det(R), torch.ones(50), atol=1e-6, rtol=0)
    torch.testing.assert_close(
        camera.viewmats[:, :3, 3], torch.tensor([0.0, 0.0, 3.0]).expand(50, 3), atol=1e-6, rtol=0
    )
    torch.testing.assert_close(positions(camera).norm(dim=1), torch.full((50,), 3.0))
    assert (R[:, 1, 2] < 0).all()


def test_bank_covers_the_zone_evenly():
    """Equal areas: a bank of n has one camera in each n-th of sin(elevation), and no azimuth gap above 2.9 mean gaps.

    Gaps of a golden-angle sequence stay below 1 + 2/√5 = 1.9 mean gaps; the jitter adds at most one.
    """
    orbits = Orbits(bank=96)
    x = positions(orbits()) / orbits.distance
    lo, hi = (math.sin(math.radians(e)) for e in orbits.elevation)
    strata = ((x[:, 2].double() - lo) / (hi - lo) * 96).floor().clamp(0, 95)
    assert strata.unique().numel() >= 94  # float32 rounding may move a camera across a border
    azimuth = torch.atan2(x[:, 1], x[:, 0]).sort().values
    gaps = torch.diff(azimuth, append=azimuth[:1] + 2 * math.pi)
    assert gaps.max() < 2.9 * 2 * math.pi / 96


def test_seed_decides_the_bank():
    assert torch.equal(Orbits(seed=1)().viewmats, Orbits(seed=1)().viewmats)
    assert not torch.equal(Orbits(seed=1)().viewmats, Orbits(seed=2)().viewmats)


def test_rings_are_cameras_all_round_at_one_elevation():
    """Four consecutive cameras 90° apart; rings have the elevations and first azimuths of as many single cameras."""
    orbits = Orbits(bank=48, ring=4)
    x = positions(orbits()).unflatten(0, (12, 4))
    azimuth = torch.atan2(x[..., 1], x[..., 0]).rad2deg()
    turned = (azimuth - azimuth[:, :1]) % 360
    torch.testing.assert_close(turned, torch.tensor([0.0, 90.0, 180.0, 270.0]).expand(12, 4), atol=1e-3, rtol=0)
    torch.testing.assert_close(x[..., 2], x[:, :1, 2].expand(12, 4), atol=1e-6, rtol=0)
    torch.testing.assert_close(x[:, 0], positions(Orbits(bank=12)()), atol=1e-5, rtol=0)


def test_projection_follows_the_field_of_view():
    """A point at half the field of view falls on the border of the picture; +x looks at the front, +y is to its
    right."""
    camera = orbit([0.0], [0.0], 3.0, fov=40.0, width=64, height=64)
    point = torch.tensor([0.0, 3.0 * math.tan(math.radians(20)), 0.0, 1.0])
    p = camera.Ks[0] @ (camera.viewmats[0] @ point)[:3]
    torch.testing.assert_close(p[:2] / p[2], torch.tensor([64.0, 32.0]))


def test_view_words_name_the_side():
    camera = orbit(
        [0.0, 44.0, -90.0, 100.0, 170.0, 0.0], [0.0, 10.0, 0.0, 20.0, 0.0, 70.0], 3.0, fov=40.0, width=8, height=8
    )
    words = view_words(camera)
    assert words == ("front view", "front view", "side view", "side view", "back view", "overhead view")


@pytest.mark.parametrize(
    "wrong",
    [{"elevation": (75.0, -15.0)}, {"bank": 0}, {"bank": 6, "ring": 4}, {"ring": 0}, {"fov": 180.0}, {"distance": 0.0}],
)
def test_impossible_orbits_are_refused(wrong):
    with pytest.raises(ValueError, match="got"):
        Orbits(**wrong)
