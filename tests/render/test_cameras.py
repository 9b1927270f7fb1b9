"""Cameras."""

import pytest
import torch

from diffuphy.render import look_at, orbit
from diffuphy.render.cameras import fit, intrinsics


def test_look_at_is_a_rotation_that_centres_the_target() -> None:
    """R Rᵀ = 1, det R = 1; the target lies on the axis at its distance; up in the world is up in the image (-y)."""
    eye = torch.randn(20, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) * 3
    at = torch.tensor([0.3, -0.2, 0.1], dtype=torch.float64)
    view = look_at(eye, at)
    R = view[:, :3, :3]
    torch.testing.assert_close(R @ R.mT, torch.eye(3, dtype=torch.float64).expand(20, 3, 3), rtol=0, atol=1e-14)
    assert (torch.linalg.det(R) > 0).all()
    p = (R @ at) + view[:, :3, 3]
    torch.testing.assert_close(p[:, :2], torch.zeros(20, 2, dtype=torch.float64), rtol=0, atol=1e-14)
    torch.testing.assert_close(p[:, 2], (at - eye).norm(dim=1))
    assert (R[:, 1, 2] < 0).all() and torch.allclose(R[:, 0, 2], torch.zeros(20, dtype=torch.float64))


def test_orbit_stands_where_it_says() -> None:
    """Azimuth from +x towards +y, elevation above the horizon, distance from the target."""
    camera = orbit([0.0, 90.0], [0.0, 30.0], [2.0, 4.0], width=10, height=20, at=(1.0, 0.0, 0.0))
    eyes = -(camera.viewmats[:, :3, :3].mT @ camera.viewmats[:, :3, 3:])[..., 0]
    expected = torch.tensor([[3.0, 0.0, 0.0], [1.0, 4 * 0.75**0.5, 2.0]])
    torch.testing.assert_close(eyes, expected, rtol=1e-6, atol=1e-6)


def test_fit_is_the_nearest_camera_that_sees_all() -> None:
    """With margin 1 every point is inside and some point lies on the edge of the image."""
    points = torch.randn(50, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    for width, height in ((100, 100), (160, 90), (60, 200)):
        camera = fit(points, 40.0, 20.0, fov=35.0, width=width, height=height, margin=1.0)
        p = points @ camera.viewmats[0, :3, :3].T + camera.viewmats[0, :3, 3]
        xy = (p @ camera.Ks[0].to(p).T)[:, :2] / p[:, 2:]
        size = torch.tensor([width, height], dtype=torch.float64)
        assert (p[:, 2] > 0).all() and (xy >= -1e-4).all() and (xy <= size + 1e-4).all()
        assert torch.minimum(xy, size - xy).min() < 1e-4


def test_errors_say_what_is_allowed() -> None:
    with pytest.raises(ValueError, match="parallel to up"):
        look_at((0.0, 0.0, 2.0))
    with pytest.raises(ValueError, match="fov must be in"):
        intrinsics(180.0, 10, 10)
