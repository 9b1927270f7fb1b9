"""The inside of a body, drawn where it opens."""

import dataclasses
import math

import torch

from diffuphy.geometry import rotations
from diffuphy.mpm.sampling.sample import Sample
from diffuphy.render import Film, Skin
from diffuphy.render.film.fillers import PARTED, Fillers, with_fillers
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
    skin, fillers = with_fillers(Skin.bind(gaussians, particles), particles)
    assert fillers is not None and fillers.first == len(gaussians)
    return skin, particles, fillers


def test_fillers_have_the_volume_of_their_particle_and_look_like_their_neighbours() -> None:
    """r³ 4π/3 = V; opacity that of the shell, which is the same everywhere; red above, blue below."""
    skin, particles, f = bound()
    g = Gaussians(**{n: v[f.first :] for n, v in vars(skin.gaussians).items()})
    radius = g.log_scales.exp()
    torch.testing.assert_close(4 / 3 * math.pi * radius.prod(1), particles.vol[f.index])
    torch.testing.assert_close(g.logit_opacities, torch.full((len(f.index),), 2.2), rtol=1e-4, atol=0)
    red = g.sh[:, 0, 0] > g.sh[:, 0, 2]
    high, low = (s * particles.x[f.index][:, 2] > 0.05 for s in (1, -1))
    assert bool(red[high].all()) and not bool(red[low].any())
    assert int(high.sum()) > 10 and bool((particles.gaussian[f.index] < 0).all())


def test_nothing_is_shown_of_a_body_that_has_not_opened() -> None:
    """At rest, turned, and sheared: x = A X + b with F = A parts no neighbours; the Gaussians are the skin's own."""
    skin, particles, f = bound()
    for A in (torch.eye(3), TURN, TURN @ SHEAR):
        x, F = particles.x @ A.mT + 0.3, A.expand(len(particles), 3, 3)
        assert not bool(f.exposed(x, F).any())
        means, F_g = skin(x, F)
        left = f.drawn(skin.gaussians, means, F_g, x, F)
        assert len(left[0]) == f.first and torch.equal(left[1], means[: f.first])
        torch.testing.assert_close(means[f.first :], x[f.index])


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
    gaussians, means, F_g = f.drawn(skin.gaussians, *skin(x, F), x, F)
    assert len(gaussians) == len(means) == len(F_g) == f.first + int(shown.sum())
    assert torch.equal(means[f.first :], x[f.index[shown]])


def test_what_is_shown_keeps_volume_and_rotation() -> None:
    """A torn filler sheared by F = R S is drawn with det(S)^{1/3} R: a ball as large as its matter, turned."""
    skin, particles, f = bound()
    A = TURN @ SHEAR
    x = particles.x @ A.mT + 0.4 * (particles.x[:, :1] > 0)
    F = A.expand(len(x), 3, 3)
    *_, F_g = f.drawn(skin.gaussians, *skin(x, F), x, F)
    U, S, V = torch.linalg.svd(A.double())
    expected = (S.prod() ** (1 / 3) * U @ V).float()
    assert len(F_g) > f.first
    torch.testing.assert_close(F_g[f.first :], expected.expand(len(F_g) - f.first, 3, 3), rtol=1e-5, atol=1e-5)
    assert torch.equal(F_g[: f.first], F[: f.first])


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
    bare = dataclasses.replace(particles, gaussian=torch.arange(len(particles)).clamp_max(len(gaussians) - 1))
    skin = Skin.bind(gaussians, bare)
    assert with_fillers(skin, bare) == (skin, None)
