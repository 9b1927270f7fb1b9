"""Mirror walls are the other half of the body."""

import itertools

import pytest
import torch

from diffuphy.mpm import HalfSpace, Scene, Scheme, simulate
from diffuphy.mpm.substep.mirror import mirrors
from tests.mpm.bodies import block, field

DX = 0.05
G = (0.7, -0.4, -9.81)


def motion(x: torch.Tensor) -> torch.Tensor:
    """A velocity that strains the body near the walls, towards and away from them."""
    return 0.3 * torch.sin(torch.stack([9 * x[:, 1] + 4 * x[:, 0], 7 * x[:, 2], 8 * x[:, 0] - 3 * x[:, 2]], 1))


@pytest.mark.parametrize("axes", [(0,), (2,), (0, 2), (0, 1, 2)], ids=["wall", "floor", "edge", "corner"])
@pytest.mark.parametrize("side", [1.0, -1.0], ids=["lower", "upper"])
def test_a_slip_mirror_is_the_body_doubled_by_reflection(axes, side):
    """x, v, C and F of a body at slip walls are those of the one half (quarter, eighth) of the body with its images
    in free space; each particle is pulled by a force per mass that its image feels reflected."""
    x, vol = block((3, 2, 3), DX)
    x = side * x
    v, g = motion(x), x.new_tensor(G).expand_as(x)
    flips = [
        x.new_tensor([-1.0 if k in pick else 1.0 for k in range(3)])
        for r in range(len(axes) + 1)
        for pick in itertools.combinations(axes, r)
    ]
    free = Scene(gravity=(0.0, 0.0, 0.0), dx=DX, fps=50.0, frames=3, boundaries=(), lift=None)
    whole, pulls = torch.cat([f * x for f in flips]), torch.cat([f * g for f in flips])
    kicks = torch.cat([f * v for f in flips])
    *_, doubled = simulate(
        free, whole, vol.repeat(len(flips)), field(len(whole), E=2e4), velocity=kicks, body=lambda t: pulls, dt=1e-3
    )
    walls = tuple(HalfSpace(kind="slip", normal=tuple(side * (k == a) for k in range(3))) for a in axes)
    mirrored = Scene(gravity=(0.0, 0.0, 0.0), dx=DX, fps=50.0, frames=3, boundaries=walls, lift=None)
    *_, half = simulate(mirrored, x, vol, field(len(x), E=2e4), velocity=v, body=lambda t: g, dt=1e-3)
    assert float((half.x - x).norm(dim=1).max()) > 0.05 * DX  # it did move
    n = len(x)
    # 63 substeps of the same sums in another order, 1e-16 each; C is v/Δx and stiff bodies amplify a little
    torch.testing.assert_close(half.x, doubled.x[:n], rtol=0, atol=1e-12)
    torch.testing.assert_close(half.v, doubled.v[:n], rtol=0, atol=1e-11)
    torch.testing.assert_close(half.C, doubled.C[:n], rtol=0, atol=1e-11 / DX)
    torch.testing.assert_close(half.F, doubled.F[:n], rtol=0, atol=1e-11)


def test_the_lattice_goes_to_the_wall():
    """The same film, moved by a third of a cell together with its walls."""
    x, vol = block((3, 2, 3), DX)
    shift = 0.37 * DX
    ends = []
    for d in (0.0, shift):
        walls = tuple(
            HalfSpace(kind="slip", point=(d, d, d), normal=tuple(float(k == a) for k in range(3))) for a in range(3)
        )
        scene = Scene(gravity=G, dx=DX, fps=50.0, frames=3, boundaries=walls, lift=None)
        *_, end = simulate(scene, x + d, vol, field(len(x)), velocity=motion(x))
        ends.append(end.x - d)
    torch.testing.assert_close(ends[1], ends[0], rtol=0, atol=1e-12)  # rounding, as above


def test_only_walls_on_nodes_that_hold_always_and_keep_their_distance_are_mirrors():
    """Slip and sticky half-spaces along an axis, at rest; one opposite a whole number of cells away and more than
    twice the reach of a mirror, so that no node has two images along an axis."""
    up, down = (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)

    def planes(*walls: HalfSpace) -> tuple[float | None, float | None]:
        found, rest = mirrors(walls, 1.0)
        assert len(rest) == len(walls)
        return found.low[2], found.high[2]

    floor = HalfSpace(kind="slip", normal=up, point=(0.0, 0.0, 0.3))
    lid = lambda z, **more: HalfSpace(normal=down, point=(0.0, 0.0, z), **{"kind": "slip"} | more)  # noqa: E731
    assert planes(floor) == (0.3, None) and planes(lid(0.3)) == (None, 0.3)
    assert planes(floor, lid(5.3)) == (0.3, 5.3) and planes(lid(5.3), floor) == (0.3, 5.3)
    assert planes(floor, lid(5.4)) == (0.3, None)  # between nodes
    assert planes(floor, lid(4.3)) == (0.3, None) and planes(lid(4.3), floor) == (None, 4.3)
    assert planes(floor, lid(5.3, kind="sticky")) == (0.3, None)
    assert planes(floor, lid(5.3, kind="separate")) == (0.3, None)
    assert planes(lid(5.3, velocity=(0.0, 0.0, 0.1))) == (None, None)
    assert planes(HalfSpace(kind="slip", normal=(0.0, 0.1, 1.0))) == (None, None)


def test_a_narrow_slot_between_slip_walls_keeps_what_is_in_it():
    """Walls too close for two mirrors: one is a mirror, the other sets its nodes; a block that fills the slot and is
    thrown at the walls stays between them within a third of a cell."""
    x, vol = block((3, 2, 3), DX)
    walls = tuple(
        HalfSpace(kind="slip", normal=(0.0, s, 0.0), point=(0.0, 0.0 if s > 0 else 2 * DX, 0.0)) for s in (1.0, -1.0)
    )
    scene = Scene(
        gravity=(0.0, 0.0, 0.0), dx=DX, fps=50.0, frames=6, boundaries=walls, lift=None, velocity=(0.3, 1.0, 0.0),
        scheme=Scheme(),
    )  # fmt: skip
    *_, end = simulate(scene, x, vol, field(len(x)))
    assert float(end.x[:, 1].min()) > -DX / 3 and float(end.x[:, 1].max()) < 2 * DX + DX / 3
    # nothing acts along x; the walls do no work on it and carry no shear
    assert float((end.v[:, 0].mean() - 0.3).abs()) < 1e-12


def test_a_wall_with_matter_behind_it_is_no_mirror():
    """A body clamped by its end lies on both sides of the plane; a quarter of a cell is rounding of a sample."""
    wall = HalfSpace(kind="sticky")
    for low, mirror in ((0.0, True), (-0.2, True), (-0.3, False)):
        found, rest = mirrors((wall,), 1.0, ((0.0, 0.0, low), (1.0, 1.0, 1.0)))
        assert found.any is mirror and (rest[0].reach > 0.0) is mirror
