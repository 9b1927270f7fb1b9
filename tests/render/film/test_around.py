"""What stands around the object."""

import dataclasses
import math

import torch

from diffuphy.render import Film
from diffuphy.render.film.around import with_scenery
from diffuphy.render.film.rigs import Resting
from diffuphy.render.sh import from_rgb
from diffuphy.render.skin import Skin
from diffuphy.types import Gaussians, Particles, Trajectory
from diffuphy.workspace import Workspace


class Wall:
    """Gaussians at given places [object units], opaque, of one colour."""

    def __init__(self, means: torch.Tensor, rgb: tuple[float, float, float]):
        n = len(means)
        self.gaussians = Gaussians(
            means, torch.tensor([[1.0, 0, 0, 0]]).repeat(n, 1), torch.full((n, 3), math.log(0.1)),
            torch.full((n,), 6.0), from_rgb(torch.tensor(rgb)).repeat(n, 1, 1),
        )  # fmt: skip

    ground: float | None = None

    def rest(self) -> Gaussians | None:
        return self.gaussians if len(self.gaussians) else None

    def floor(self) -> float | None:
        return self.ground


def take(around, **settings):
    """Two frames of a blue ball at rest, 0.2 m across, that is lifted by its own length between them."""
    r = torch.Generator().manual_seed(0)
    d = torch.nn.functional.normalize(torch.randn(200, 3, generator=r), dim=1)
    ball = Wall(d, (0.1, 0.1, 0.9)).gaussians
    x = 0.1 * d
    particles = Particles(x, torch.full((200,), 1e-5), torch.arange(200), 0.1, (0.0, 0.0, 0.0), 0.02)
    paths = torch.stack([x, x + torch.tensor([0.0, 0.0, 0.2])]) + torch.tensor([0.0, 0.0, 0.1])
    F = torch.eye(3).expand(2, 200, 3, 3).contiguous()
    film = Film(
        width=64,
        height=64,
        camera=Resting(azimuth=0.0, elevation=0.0),
        around=around,
        shadow=0.0,
        floor=False,
        **settings,
    )
    clip = film(ball, particles, Trajectory(paths, torch.zeros_like(paths), F, 10.0), work=Workspace())
    return clip.rgb, film


def wall(x: float) -> Wall:
    """A sheet at ``x``, towards the camera, where the ball is at first: 2 x 2 object units, green."""
    a = torch.linspace(-1, 1, 21)
    return Wall(torch.cat([torch.full((441, 1), x), torch.cartesian_prod(a, a)], dim=1), (0.1, 0.9, 0.1))


def colour(rgb: torch.Tensor, k: int) -> torch.Tensor:
    others = [c for c in range(3) if c != k]
    return (rgb[..., k] > rgb[..., others[0]] + 0.3) & (rgb[..., k] > rgb[..., others[1]] + 0.3)


def test_a_wall_before_the_object_hides_it_and_one_behind_does_not() -> None:
    """The camera looks along −x at a ball that leaves its place: the wall stays, and stands on the ball's floor."""
    before, _ = take(wall(2.0))
    behind, _ = take(wall(-2.0))
    assert not colour(before[0], 2).any() and colour(before[1], 2).any()
    assert colour(behind[0], 2).any() and colour(behind[1], 2).any()
    for rgb in (before, behind):
        green = colour(rgb, 1)
        assert green[0].any() and (green[0] & ~green[1]).sum() <= colour(rgb[1], 2).sum()


def test_a_ground_of_the_scene_is_the_floor() -> None:
    """z = scale · (z_rest − ground), whatever the object's underside: at 0.1 m a unit, points at −1, 0, 1 over a ground
    at −0.5 end at −0.05, 0.05 and 0.15 m."""
    around = Wall(torch.tensor([[0.0, 0.0, -1.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), (0.0, 1.0, 0.0))
    x = torch.tensor([[0.0, 0.0, 0.3], [0.0, 0.0, 0.4]])
    particles = Particles(x, torch.full((2,), 1e-5), torch.arange(2), 0.1, (0.0, 0.0, 0.2), 0.02)
    skin = Skin.bind(Wall(x / 0.1, (0.0, 0.0, 1.0)).gaussians, particles)
    for ground, heights in ((-0.5, [-0.05, 0.05, 0.15]), (None, [-0.2, -0.1, 0.0])):
        around.ground = ground
        still = with_scenery(skin, around, particles).gaussians.means[2:]
        torch.testing.assert_close(still[:, 2], torch.tensor(heights), rtol=0, atol=1e-6)


def test_nothing_around_changes_no_bit() -> None:
    nothing, _ = take(None)
    empty, film = take(Wall(torch.zeros(0, 3), (0.0, 0.0, 0.0)))
    assert torch.equal(nothing, empty)
    assert dataclasses.replace(film, around=None) == Film(
        width=64, height=64, camera=Resting(azimuth=0.0, elevation=0.0), shadow=0.0, floor=False
    )
