"""The studio: floor, shadow."""

import math

import pytest
import torch

from diffuphy.render import orbit
from diffuphy.render.film.floor import Shadow, backdrop, rays, square
from diffuphy.types import Camera


def camera(width: int = 64, height: int = 48) -> Camera:
    c = orbit([-60.0], [15.0], 3.0, fov=32.0, width=width, height=height, at=(0.0, 0.0, 0.4))
    return Camera(c.viewmats.double(), c.Ks.double(), width, height)


def slab(height: float, side: float = 0.4, n: int = 20) -> tuple[torch.Tensor, torch.Tensor]:
    """Particles of a square plate at a height, a fifth as thick as wide."""
    a = ((torch.arange(n, dtype=torch.float64) + 0.5) / n - 0.5) * side
    layers = height + (torch.arange(n // 5, dtype=torch.float64) + 0.5) * side / n
    return torch.cartesian_prod(a, a, layers), torch.full((n * n * (n // 5),), (side / n) ** 3, dtype=torch.float64)


def test_ground_projects_back_to_its_pixel() -> None:
    """The point where a pixel's ray meets z = 0 projects to the centre of that pixel."""
    c = camera()
    studio = backdrop(c, torch.zeros(2, dtype=torch.float64), 1.0)
    _, d = rays(c)
    below = d[..., 2] < -1e-3
    points = torch.cat([studio.ground, torch.zeros(48, 64, 1, dtype=torch.float64)], dim=-1)[below]
    p = points @ c.viewmats[0, :3, :3].T + c.viewmats[0, :3, 3]
    xy = (p @ c.Ks[0].T)[:, :2] / p[:, 2:]
    y, x = torch.meshgrid(torch.arange(48) + 0.5, torch.arange(64) + 0.5, indexing="ij")
    # the camera was made in float32: its axes are orthonormal to 1e-7, of 100 px
    torch.testing.assert_close(xy, torch.stack([x, y], -1)[below].double(), rtol=0, atol=1e-4)
    assert below.any() and not below.all()


def test_the_floor_fades_into_the_horizon_without_an_edge() -> None:
    """Above the horizon no floor; below it neighbouring rows differ by a few grey levels at most besides the lines."""
    studio = backdrop(camera(64, 200), torch.zeros(2, dtype=torch.float64), 0.5)
    _, d = rays(camera(64, 200))
    assert not studio.solid[d[..., 2] > 0.01].any()
    assert studio.solid.max() > 0.9
    assert studio.rgb.mean(dim=(1, 2)).diff().abs().max() < 0.04
    assert ((studio.rgb >= 0) & (studio.rgb <= 1)).all()


def test_squares_are_one_two_or_five() -> None:
    assert [square(s) for s in (1.0, 1.9, 2.1, 0.6, 0.049)] == pytest.approx([1.0, 1.0, 2.0, 0.5, 0.02])


def test_shadow_is_darkest_at_contact_and_pales_with_height() -> None:
    """The light under the middle of a plate is (1 - s) (1 - s / 2) at contact and returns to 1 as the plate rises
    and its penumbra spreads."""
    heights = (0.01, 0.2, 0.5, 1.0, 2.0)
    plates = [slab(h)[0] for h in heights]
    shadow = Shadow.over(torch.stack(plates), slab(0)[1], strength=0.5)
    under = torch.zeros(1, 1, 2, dtype=torch.float64)
    light = [shadow.cast(x, under).item() for x in plates]
    assert light[0] == pytest.approx(0.5 * 0.75, abs=0.03)
    assert light == sorted(light) and light[-1] > 0.9


def test_shadow_lies_below_the_body_and_nowhere_else() -> None:
    """The centroid of the darkness is that of the particles; far away there is none; the map moves with the body."""
    x, vol = slab(0.1)
    shift = torch.tensor([0.3, -0.2, 0.0], dtype=torch.float64)
    shadow = Shadow.over(torch.stack([x, x + shift]), vol)
    axis = (torch.arange(shadow.cells, dtype=torch.float64) + 0.5) * shadow.cell
    for moved, middle in ((x, torch.zeros(2)), (x + shift, shift[:2])):
        dark = 1 - shadow.light(moved)
        at = torch.stack([(dark.sum(0) * axis).sum(), (dark.sum(1) * axis).sum()]) / dark.sum() + shadow.origin
        torch.testing.assert_close(at, middle.double(), rtol=0, atol=0.1 * shadow.cell)
    assert shadow.cast(x, torch.full((1, 1, 2), 50.0, dtype=torch.float64)).item() == 1


def test_shadow_does_not_depend_on_the_number_of_particles() -> None:
    """The same plate of eight times as many, smaller particles casts the same shadow, up to their spacing."""
    coarse, fine = slab(0.3, n=15), slab(0.3, n=30)
    lights = []
    for x, vol in (coarse, fine):
        shadow = Shadow.over(x[None], vol)
        g = torch.linspace(-0.3, 0.3, 25, dtype=torch.float64)
        lights.append(shadow.cast(x, torch.stack(torch.meshgrid(g, g, indexing="xy"), dim=-1)))
    # the edge is blurred by half a spacing more, 0.4 / 15 / 4, of a penumbra 0.07 m wide, at strength 0.5: 0.05
    assert (lights[0] - lights[1]).abs().max() < 0.05


def test_deposited_area_is_the_particles_area() -> None:
    """Far above, where the cover is thin, the missing light integrates to s · Σ vol^⅔ · 2 of the exponential."""
    x = torch.tensor([[0.0, 0.0, 0.4], [0.2, 0.1, 0.4]], dtype=torch.float64)
    vol = torch.full((2,), 1e-9, dtype=torch.float64)
    wide = torch.tensor([[[-1.0, -1.0, 0.0], [1.0, 1.0, 0.4]], x.tolist()], dtype=torch.float64)
    shadow = Shadow.over(wide, vol, strength=0.5)
    missing = (1 - shadow.light(x)).sum().item() * shadow.cell**2
    cover = 2e-6 / shadow.cell**2  # of the cell; the exponential is linear to half of this
    assert cover < 0.05
    assert missing == pytest.approx(0.5 * 2 * 2e-6, rel=math.expm1(cover) + 0.02)
