"""What is enclosed: by flood, and by rays as in PhysGaussian."""

import dataclasses
import math

import pytest
import torch
from torch import Tensor

from diffuphy.mpm.sampling.fill import Lattice, column, outside
from diffuphy.mpm.sampling.filling import MOST_CELLS, Flood, Rays
from diffuphy.mpm.sampling.sample import Sample
from diffuphy.types import Gaussians, Look, Motion
from diffuphy.workspace import Workspace


def shell(hole: tuple[slice, ...] | None = None, n: int = 16) -> Tensor:
    """A box of walls one cell thick, from 4 to 12."""
    box = torch.zeros(n, n, n, dtype=torch.bool)
    box[4:12, 4:12, 4:12] = True
    box[5:11, 5:11, 5:11] = False
    if hole is not None:
        box[hole] = False
    return box


def lattice(n: int = 16) -> Lattice:
    """n³ cells of side 1 about the origin."""
    return Lattice(torch.full((3,), -n / 2, dtype=torch.float64), 1.0, (n, n, n))


INSIDE = torch.zeros(16, 16, 16, dtype=torch.bool)
INSIDE[5:11, 5:11, 5:11] = True


@pytest.mark.parametrize("seal", [0, 1, 2])
def test_a_closed_box_is_filled_to_the_last_cell(seal):
    assert torch.equal(~(shell() | outside(shell(), seal)), INSIDE)


def test_a_crevice_is_not_filled():
    """A groove two cells wide and six deep, as wide at its bottom as at its mouth, is outside although seal = 2 closes
    holes twice as wide; a room behind a hole of that width is not."""
    block = torch.zeros(24, 24, 24, dtype=torch.bool)
    block[6:18, 6:18, 6:18] = True
    block[11:13, 6:18, 12:18] = False
    assert bool(outside(block, 2)[11:13, 6:18, 12:18].all())
    room = torch.zeros(24, 24, 24, dtype=torch.bool)
    room[4:20, 4:20, 4:20] = True
    room[5:19, 5:19, 5:19] = False
    room[11:13, 11:13, 19] = False
    assert not bool(outside(room, 2)[5:19, 5:19, 5:18].any())


def test_beginnings_are_counted_along_a_ray():
    """Looking up from cell 0 at ..##.#.. are two beginnings; from inside the first run only one; looking down from the
    end two."""
    wall = torch.tensor([0, 0, 1, 1, 0, 1, 0, 0], dtype=torch.bool)[:, None, None]
    assert column(wall, 0, 1).flatten().tolist() == [2, 2, 1, 1, 1, 0, 0, 0]
    assert column(wall, 0, -1).flatten().tolist() == [0, 0, 0, 0, 1, 1, 2, 2]


def test_rays_fill_a_closed_box_and_nothing_else():
    assert torch.equal(Rays().inside(shell()), INSIDE)


def test_an_open_underside_wants_its_direction_excluded():
    """Without the floor of the box rays down meet nothing: condition 1 fails everywhere, and holds once −z is
    excluded."""
    wall = shell((slice(5, 11), slice(5, 11), slice(4, 5)))
    assert not bool(Rays().inside(wall).any())
    filled = Rays(exclude=("-z",)).inside(wall)
    assert bool(filled[INSIDE].all()) and not bool(filled[:, :, :4].any())


def test_a_cell_between_six_bodies_is_not_filled():
    """From outside a ray enters a closed shell twice: condition 2 tells what condition 1 does not."""
    n, wall = 31, torch.zeros(31, 31, 31, dtype=torch.bool)
    for axis in range(3):
        for start in (2, 22):
            at: list[slice] = [slice(12, 19)] * 3
            core: list[slice] = [slice(13, 18)] * 3
            at[axis], core[axis] = slice(start, start + 7), slice(start + 1, start + 6)
            wall[tuple(at)] = True
            wall[tuple(core)] = False
    middle = (n // 2,) * 3
    assert bool(Rays(parity=None).inside(wall)[middle])
    for parity in ("+x", "-x", "+y", "-y", "+z", "-z"):
        assert not bool(Rays(parity=parity).inside(wall)[middle])


def test_rays_of_their_own_lattice_fill_what_lies_in_their_box():
    """With cells half as large over half of the box only that half is filled."""
    dense, here = shell(), lattice()

    def field(at: Lattice) -> Tensor:
        cells = torch.cartesian_prod(*map(torch.arange, at.shape))
        home = here.cell(at.center(cells))
        return dense[home[:, 0], home[:, 1], home[:, 2]].double().view(at.shape)

    half = Rays(n_grid=32, exclude=("+x",), box=(-8, 0, -8, 8, -8, 8))(here, dense, field, 8.0)
    assert torch.equal(half, INSIDE & (torch.arange(16) < 8)[:, None, None])
    with pytest.raises(ValueError, match=f"more than {MOST_CELLS}; lower it"):
        Rays(n_grid=5000)(here, dense, field, 8.0)


@pytest.mark.parametrize("wrong", [dict(exclude=("up",)), dict(parity="z"), dict(threshold=-1.0), dict(n_grid=0),
                                   dict(box=(0, 1, 0, 1, 1, 0))])  # fmt: skip
def test_settings_without_meaning_are_errors(wrong):
    with pytest.raises(ValueError):
        Rays(**wrong)
    with pytest.raises(ValueError, match=r"seal must be in \[0, 1\)"):
        Flood(seal=1.0)


def ball(n: int = 3000, sigma: float = 0.03) -> Gaussians:
    k = torch.arange(n) + 0.5
    polar, azimuth = torch.acos(1 - 2 * k / n), math.pi * (1 + 5**0.5) * k
    x = torch.stack([azimuth.cos() * polar.sin(), azimuth.sin() * polar.sin(), polar.cos()], 1)
    quats = torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(n, 1)
    return Gaussians(x, quats, torch.full((n, 3), math.log(sigma)), torch.full((n,), 2.2), torch.zeros(n, 1, 3))


def test_a_ball_is_the_same_by_flood_and_by_rays():
    """Of a closed convex shell both conditions and the flood say the same, up to cells that graze the wall: less than
    one layer of cells at half the radius, 2 % of the volume."""
    flood, rays = (
        float(Sample(cells=16, filling=f, max_particles=10**6)(ball(), Motion("", "", size=2.0), work=Workspace())
              .vol.double().sum())
        for f in (Flood(), Rays())
    )  # fmt: skip
    assert rays == pytest.approx(flood, rel=0.02)


def test_gaussians_fitted_to_coarse_pictures_get_their_width_back():
    """σ² + 0.3 pixel²: thin Gaussians fitted with a pixel are sampled as those that wide without, bit by bit."""
    pixel, sigma = 0.05, 0.02
    wide = math.sqrt(sigma**2 + 0.3 * pixel**2)
    sample, motion = Sample(cells=12, max_particles=10**6), Motion("", "", size=1.0)
    fitted = dataclasses.replace(sample, pixel=pixel)(ball(sigma=sigma), motion, work=Workspace())
    given = sample(ball(sigma=wide), motion, work=Workspace())
    assert float(fitted.vol.sum()) == pytest.approx(float(given.vol.sum()), rel=1e-3)
    assert float(fitted.vol.sum()) > 1.01 * float(sample(ball(sigma=sigma), motion, work=Workspace()).vol.sum())


@pytest.mark.slow
@pytest.mark.parametrize("name", ["duck", "donut"])
def test_a_fitted_object_has_its_volume(name):
    """Fitted as by default, the particles fill the object to 5 %."""
    from diffuphy.losses.guidance.analytic import Analytic
    from diffuphy.text2gs.fit import FitGaussians
    from diffuphy.text2gs.shapes import Library

    library = Library()
    fit = FitGaussians(Analytic(library))
    look = Look(name, f"a {name}")
    p = Sample(pixel=fit.cameras.pixel, max_particles=10**6)(fit(look), Motion("", ""), work=Workspace())
    at = (torch.arange(100) + 0.5) / 100 * 2.6 - 1.3
    true = float((library.object(look).sdf(torch.cartesian_prod(at, at, at))[0] < 0).double().mean()) * 2.6**3
    assert float(p.vol.double().sum()) / p.scale**3 == pytest.approx(true, rel=0.05)
