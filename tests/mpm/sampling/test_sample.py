"""Particles from Gaussians: volumes in closed form, determinism, what is dropped and what is filled."""

import dataclasses
import math

import pytest
import torch
from torch import Tensor

from diffuphy.mpm.sampling.fill import Lattice, density, outside, pieces
from diffuphy.mpm.sampling.sample import Sample
from diffuphy.types import Gaussians, Motion
from diffuphy.workspace import Workspace

MANY = Sample(cells=16, max_particles=10**6)


def motion(size: float = 1.0) -> Motion:
    return Motion("falling", "", size=size)


def cloud(means: Tensor, sigma: float, opacity: float = 0.9) -> Gaussians:
    n = len(means)
    quats = torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(n, 1)
    logits = torch.full((n,), math.log(opacity / (1 - opacity)))
    return Gaussians(means, quats, torch.full((n, 3), math.log(sigma)), logits, torch.zeros(n, 1, 3))


def sphere(n: int, radius: float = 1.0) -> Tensor:
    """n points spread evenly over a sphere (Fibonacci)."""
    k = torch.arange(n) + 0.5
    polar, azimuth = torch.acos(1 - 2 * k / n), math.pi * (1 + 5**0.5) * k
    return radius * torch.stack([azimuth.cos() * polar.sin(), azimuth.sin() * polar.sin(), polar.cos()], 1)


@pytest.mark.parametrize("n, sigma", [(10000, 0.006), (4000, 0.03), (1500, 0.06)])
def test_a_shell_becomes_a_solid_ball_of_its_volume(n, sigma):
    """V = 4π/3 (R + d)³ with d where the density of the sheet, o ν 2π s² e^(−d²/2s²), s² = max(σ², h²/12), falls to
    the threshold."""
    p = MANY(cloud(sphere(n), sigma), motion(2.0), work=Workspace())
    h = 2.0 / MANY.cells / 2
    s2 = max(sigma**2, h * h / 12)
    d = math.sqrt(2 * s2 * math.log(0.9 * n / (4 * math.pi) * 2 * math.pi * s2 / MANY.threshold))
    # cells counted by their centres: noise of about 0.1 cell in the radius; the sheet is curved: s²/R² = 0.4 % of
    # it; 3 · 0.1 h/R = 2 %
    assert float(p.vol.sum()) == pytest.approx(4 / 3 * math.pi * (1 + d) ** 3, rel=0.03)
    assert (p.gaussian < 0).sum() > len(p) / 2
    inside = p.x.norm(dim=1)
    assert float(inside.min()) < 2 * h and float(inside.max()) < 1 + d + 2 * h


def test_what_is_open_or_left_out_stays_hollow():
    """filling=None leaves a shell of its own thickness; a bowl has no inside to fill."""
    shell = sphere(4000)
    solid = MANY(cloud(shell, 0.03), motion(2.0), work=Workspace())
    hollow = dataclasses.replace(MANY, filling=None)(cloud(shell, 0.03), motion(2.0), work=Workspace())
    assert float(hollow.x.norm(dim=1).min()) > 0.7 and float(hollow.vol.sum()) < 0.6 * float(solid.vol.sum())
    bowl = shell[shell[:, 2] < 0.0]
    p = MANY(cloud(bowl, 0.03), motion(2.0), work=Workspace())
    x = (p.x - torch.tensor(p.offset)) / p.scale
    assert not bool((x.norm(dim=1) < 0.5).any())


def test_particles_lie_where_the_gaussians_are():
    """x = scale · means + offset, longest side = size, the middle of the box at the origin; none carries two."""
    means = sphere(2000) * torch.tensor([1.0, 0.5, 0.3]) + torch.tensor([0.3, 0.1, -0.2])
    g = cloud(means, 0.03)
    p = MANY(g, motion(0.4), work=Workspace())
    moved = p.scale * means + torch.tensor(p.offset)
    torch.testing.assert_close(moved.amax(0) - moved.amin(0), 0.4 * torch.tensor([1.0, 0.5, 0.3]), rtol=1e-2, atol=0)
    torch.testing.assert_close(moved.amax(0), -moved.amin(0), rtol=0, atol=1e-6)
    carries = p.gaussian >= 0
    torch.testing.assert_close(p.x[carries], moved[p.gaussian[carries]], rtol=0, atol=1e-6)
    assert len(p.gaussian[carries].unique()) == int(carries.sum())
    assert p.spacing == pytest.approx((float(p.vol.sum()) / len(p)) ** (1 / 3), rel=1e-6)


@pytest.mark.parametrize("order", [(0.9, 0.5), (0.5, 0.9)])
def test_a_particle_carries_the_most_opaque_gaussian_of_its_cell(order):
    """Two Gaussians at every place, of opacity 0.9 and 0.5, in either order: all that is carried has 0.9."""
    means = sphere(500)
    pair = [cloud(means, 0.05, opacity) for opacity in order]
    names = [f.name for f in dataclasses.fields(Gaussians)]
    both = Gaussians(**{name: torch.cat([getattr(g, name) for g in pair]) for name in names})
    carried = MANY(both, motion(2.0), work=Workspace()).gaussian
    carried = carried[carried >= 0]
    assert len(carried) > 300
    assert bool((carried // len(means) == order.index(0.9)).all())


def test_the_same_input_gives_the_same_bits_and_another_seed_other_points():
    g = cloud(sphere(1500), 0.05)
    a, b = (MANY(g, motion(), work=Workspace()) for _ in range(2))
    assert torch.equal(a.x, b.x) and torch.equal(a.vol, b.vol) and torch.equal(a.gaussian, b.gaussian)
    c = dataclasses.replace(MANY, seed=1)(g, motion(), work=Workspace())
    assert torch.equal(a.vol, c.vol) and not torch.equal(a.x, c.x)


def test_two_objects_are_kept_and_strays_are_not():
    """A second ball of half the size stays; three lone Gaussians far off do not, and do not change the size."""
    small = sphere(1500, 0.4) + torch.tensor([1.8, 0.0, 0.0])
    pair = torch.cat([sphere(3000, 0.8), small])
    lone = torch.tensor([[9.0, 0.0, 0.0], [0.0, -40.0, 0.0], [0.0, 0.0, 5.0]])
    alone = MANY(cloud(pair, 0.04), motion(3.0), work=Workspace())
    both = MANY(cloud(torch.cat([pair, lone]), 0.04), motion(3.0), work=Workspace())
    assert torch.equal(alone.x, both.x) and alone.scale == both.scale
    right = (alone.x - torch.tensor(alone.offset))[:, 0] / alone.scale > 1.2
    assert 0.05 < float(alone.vol[right].sum() / alone.vol.sum()) < 0.25  # (0.4/0.8)³ = 1/8 of the larger


def test_the_number_of_particles_is_bounded():
    """Coarser until it fits, with the volume kept to the accuracy of the coarser lattice; or an error that says what
    to do."""
    g = cloud(sphere(4000), 0.03)
    fine = MANY(g, motion(), work=Workspace())
    few = dataclasses.replace(MANY, max_particles=3000)(g, motion(), work=Workspace())
    assert 2000 < len(few) <= 3000
    # the lattice places the surface to half a cell: 3 (h/2)/R
    assert float(few.vol.sum()) == pytest.approx(float(fine.vol.sum()), rel=1.5 * few.spacing / 0.5)
    with pytest.raises(ValueError, match="more than 3000; raise max_particles"):
        dataclasses.replace(MANY, max_particles=3000, when_full="error")(g, motion(), work=Workspace())


@pytest.mark.parametrize("case", ["transparent", "empty", "point", "size", "nan"])
def test_nothing_to_make_particles_of_is_an_error(case):
    g = cloud(sphere(50), 0.1, opacity=0.05 if case == "transparent" else 0.9)
    size = 1.0
    if case == "empty":
        g = cloud(torch.zeros(0, 3), 0.1)
    elif case == "point":
        g = cloud(torch.ones(20, 3), 0.1)
    elif case == "size":
        size = 0.0
    elif case == "nan":
        g = dataclasses.replace(g, means=g.means * math.nan)
    with pytest.raises(ValueError):
        MANY(g, motion(size), work=Workspace())


def test_huge_and_tiny_gaussians_cannot_hang_it():
    """Reach is capped; a few thousand overgrown Gaussians cost no more than the cap allows."""
    g = cloud(sphere(500), 0.05)
    log_scales = g.log_scales.clone()
    log_scales[:5], log_scales[5:10] = 10.0, -50.0
    p = MANY(dataclasses.replace(g, log_scales=log_scales), motion(), work=Workspace())
    assert bool(torch.isfinite(p.x).all()) and float(p.x.norm(dim=1).max()) < 2.0


def test_density_is_the_sum_of_the_gaussians():
    """One turned ellipsoid on a fine lattice: its integral is o (2π)^{3/2} √det Σ, up to the 1 % beyond three
    deviations."""
    x = torch.tensor([[0.03, 0.01, -0.02]])
    quat = torch.tensor([[0.9, 0.1, -0.3, 0.2]])
    scales, h = torch.tensor([[0.04, 0.06, 0.05]]), 0.04
    lattice = Lattice.around(x, h, margin=8)
    d = density(lattice, x, quat, scales, torch.tensor([0.7]))
    expected = 0.7 * (2 * math.pi) ** 1.5 * float(scales.double().prod())
    assert float(d.sum()) * h**3 == pytest.approx(expected, rel=0.03)


def test_the_outside_does_not_leak_through_small_holes():
    """A box with a hole as wide as 2 seal: closed; one cell wider: open, and its inside is outside."""
    for hole, closed in ((2, True), (3, False)):
        box = torch.zeros(16, 16, 16, dtype=torch.bool)
        box[4:12, 4:12, 4:12] = True
        box[5:11, 5:11, 5:11] = False
        box[7 : 7 + hole, 7 : 7 + hole, 11] = False
        assert bool(outside(box, 1)[8, 8, 8]) != closed


def test_pieces_are_connected_across_corners():
    mask = torch.zeros(6, 6, 6, dtype=torch.bool)
    mask[0, 0, 0] = mask[1, 1, 1] = mask[4, 4, 4] = True
    label = pieces(mask)
    assert label[0, 0, 0] == label[1, 1, 1] != label[4, 4, 4] and label[2, 2, 2] == -1
