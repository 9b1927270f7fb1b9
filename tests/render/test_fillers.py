"""The inside of a body, drawn where it opens."""

import dataclasses
import math

import torch

from diffuphy.geometry import rotations
from diffuphy.mpm.sample import Sample
from diffuphy.render import Film, Skin
from diffuphy.render.fillers import PARTED, Fillers, drawn
from diffuphy.render.sh import from_rgb
from diffuphy.types import Gaussians, Motion, Particles, Trajectory
from diffuphy.workspace import Workspace

TURN = rotations(torch.tensor([0.8, 0.1, -0.4, 0.3]))
SHEAR = torch.tensor([[1.4, 0.3, 0.0], [0.0, 0.8, 0.2], [0.0, 0.0, 1.1]])


def shell(n: int = 1500) -> tuple[Gaussians, Particles]:
    """A ball's surface, red above and blue below, and its filled particles."""
    k = torch.arange(n) + 0.5
    polar, azimuth = torch.acos(1 - 2 * k / n), math.pi * (1 + 5**0.5) * k
    x = torch.stack([azimuth.cos() * polar.sin(), azimuth.sin() * polar.sin(), polar.cos()], 1)
    quats = torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(n, 1)
    rgb = torch.where(x[:, 2:] > 0, torch.tensor([0.9, 0.1, 0.1]), torch.tensor([0.1, 0.1, 0.9]))
    g = Gaussians(x, quats, torch.full((n, 3), math.log(0.06)), torch.full((n,), 2.2), from_rgb(rgb))
    return g, Sample(cells=10)(g, Motion("", "", size=0.4), work=Workspace())


def bound() -> tuple[Skin, Particles, Fillers]:
    gaussians, particles = shell()
    skin = Skin.bind(gaussians, particles)
    fillers = Fillers.of(skin.gaussians, particles)
    assert fillers is not None
    return skin, particles, fillers


def test_fillers_have_the_volume_of_their_particle_and_look_like_their_neighbours() -> None:
    """r³ 4π/3 = V; opacity that of the shell, which is the same everywhere; red above, blue below."""
    _, particles, f = bound()
    radius = f.gaussians.log_scales.exp()
    torch.testing.assert_close(4 / 3 * math.pi * radius.prod(1), particles.vol[f.index])
    torch.testing.assert_close(f.gaussians.logit_opacities, torch.full((len(f.index),), 2.2), rtol=1e-4, atol=0)
    red = f.gaussians.sh[:, 0, 0] > f.gaussians.sh[:, 0, 2]
    high, low = (s * particles.x[f.index][:, 2] > 0.05 for s in (1, -1))
    assert bool(red[high].all()) and not bool(red[low].any())
    assert int(high.sum()) > 10 and bool((particles.gaussian[f.index] < 0).all())


def test_nothing_is_shown_of_a_body_that_has_not_opened() -> None:
    """At rest, turned, and sheared: x = A X + b with F = A parts no neighbours; the Gaussians are the skin's own."""
    skin, particles, f = bound()
    for A in (torch.eye(3), TURN, TURN @ SHEAR):
        x, F = particles.x @ A.mT + 0.3, A.expand(len(particles), 3, 3)
        assert not bool(f.exposed(x, F).any())
        gaussians, _, _, count = drawn(skin, f, x, F)
        assert gaussians is skin.gaussians and count == 0


def test_what_a_cut_lays_open_is_shown() -> None:
    """Halves taken apart by more than PARTED spacings show the fillers at the cut, and only those: neighbours lie
    within two spacings."""
    skin, particles, f = bound()
    rest, right = particles.x, particles.x[:, 0] > 0
    F = torch.eye(3).expand(len(rest), 3, 3)
    for gap, opens in ((0.9 * PARTED, False), (1.1 * PARTED, True)):
        x = rest + torch.tensor([gap * particles.spacing, 0.0, 0.0]) * right[:, None]
        shown = f.exposed(x, F)
        assert bool(shown.any()) == opens
    near = rest[f.index][shown, 0].abs() / particles.spacing
    assert float(near.max()) < 2.5 and int(shown.sum()) > 20
    gaussians, means, F_g, count = drawn(skin, f, x, F)
    assert count == int(shown.sum()) and len(gaussians) == len(means) == len(F_g) == len(skin.gaussians) + count
    assert torch.equal(means[-count:], x[f.index[shown]])


def test_the_picture_of_a_body_that_has_not_opened_is_that_without_fillers() -> None:
    """To the last bit, in every frame of a rigid fall; and a body torn in two shows its inside."""
    gaussians, particles = shell()
    rest = particles.x + torch.tensor([0.0, 0.0, 0.4])
    fall = torch.stack([rest, rest @ TURN.mT])
    F = torch.stack([torch.eye(3).expand(len(rest), 3, 3), TURN.expand(len(rest), 3, 3)])
    torn = torch.stack([rest, rest + torch.tensor([0.15, 0.0, 0.0]) * (particles.x[:, :1] > 0)])
    for x, same in ((fall, True), (torn, False)):
        motion = Trajectory(x, torch.zeros_like(x), F if same else F[:1].expand(2, -1, 3, 3), 30.0)
        film = Film(width=48, height=48)
        with_, without = (
            dataclasses.replace(film, fillers=on)(gaussians, particles, motion, work=Workspace()).rgb
            for on in (True, False)
        )
        assert torch.equal(with_, without) == same
        assert torch.equal(with_[0], without[0])


def test_a_body_without_fillers_has_none() -> None:
    gaussians, particles = shell()
    bare = dataclasses.replace(particles, gaussian=torch.zeros_like(particles.gaussian))
    assert Fillers.of(gaussians, bare) is None
