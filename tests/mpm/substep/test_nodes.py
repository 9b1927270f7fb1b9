"""Walls whose nodes are set, and the sharpening beside them."""

import pytest
import torch

from diffuphy.material import kirchhoff
from diffuphy.mpm import Drag, HalfSpace, Scene, Scheme, simulate
from tests.mpm.bodies import block, field

DX, RHO, G, DAMPER = 0.01, 1500.0, 9.81, 0.01
E, NU = 1e5, 0.3


def at_rest(walls: tuple[HalfSpace, ...], scheme: Scheme) -> tuple[torch.Tensor, float]:
    """Lateral and vertical pressure in the middle of a block of 8 × 2 × 4 cells, 1.25 cells above its foot, of the four
    rows of particles across its width, shape (4, 2) [Pa], and the largest speed [m/s], after 20 times of a damper."""
    x, vol = block((8, 2, 4), DX)
    scene = Scene(
        gravity=(0.0, 0.0, -G), dx=DX, fps=1 / DAMPER, frames=20, boundaries=walls, lift=None, scheme=scheme,
        drives=(Drag(time=DAMPER),),
    )  # fmt: skip
    *_, end = simulate(scene, x, vol, field(len(x), E=E, nu=NU, rho=RHO))
    p = -kirchhoff(end.F, "neo_hookean", {"E": E, "nu": NU}).diagonal(dim1=1, dim2=2)[:, 1:]
    here = ((x[:, 0] / DX - 4).abs() < 1) & ((x[:, 2] / DX - 1.25).abs() < 0.1)
    rows = [p[here & ((x[:, 1] / DX - y).abs() < 0.1)].mean(0) for y in (0.25, 0.75, 1.25, 1.75)]
    return torch.stack(rows), float(end.v.norm(dim=1).max())


@pytest.mark.parametrize("kind", ["slip", "sticky"])
def test_the_pressure_on_a_wall_whose_nodes_are_set_stays_there(kind):
    """A body is at rest where the force on every free node is zero; then c = Π a = 0 and S c = 0: the stress is that
    without sharpening, also between a mirror and a wall two cells from it, which is none."""
    walls = (
        HalfSpace(kind="sticky"),
        HalfSpace(kind="slip", normal=(0.0, 1.0, 0.0)),
        HalfSpace(kind=kind, point=(0.0, 2 * DX, 0.0), normal=(0.0, -1.0, 0.0)),
    )
    (plain, _), (sharp, speed) = (at_rest(walls, Scheme(sharpen=s)) for s in (False, True))
    weight = RHO * G * 2.75 * DX
    # 2e-4 of the weight above is left of the ways on which the two came to rest; the pressure sharpened as it is makes
    # 0.45 of it beside the slip wall and 0.06 beside the sticky one, and a body that creeps at 2e-3 g times the damper
    torch.testing.assert_close(sharp, plain, rtol=0, atol=2e-3 * weight)
    assert speed < 1e-4 * G * DAMPER
