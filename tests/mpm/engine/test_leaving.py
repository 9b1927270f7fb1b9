"""Particles that leave the bounds of a scene."""

import dataclasses
import itertools

import pytest
import torch

from diffuphy.mpm import FrameReport, Scene, rollout, simulate
from diffuphy.types import SimulationDiverged
from tests.mpm.bodies import block, field

DX = 0.05
BOX = ((-1.0, -1.0, -1.0), (0.5, 1.0, 1.0))
SCENE = Scene(gravity=(0.0, 0.0, 0.0), dx=DX, fps=50.0, frames=6, boundaries=(), lift=None, bounds=BOX)


def pair(dtype: torch.dtype = torch.float64):
    """Two cubes; the second, at x = 0.36 … 0.46 m, flies out through x = 0.5 m at 2 m/s."""
    x, vol = block((2, 2, 2), DX, (0.0, 0.0, 0.0), dtype=dtype)
    x = torch.cat([x, x + x.new_tensor([0.36, 0.0, 0.0])])
    v = torch.zeros_like(x)
    v[len(vol) :, 0] = 2.0
    return x, torch.cat([vol, vol]), field(len(x), dtype=dtype), v


def test_who_leaves_is_named_with_frame_and_place():
    """The layer at 0.4475 m is the first beyond 0.5 m, after 26 ms: frame 1 ends at 40 ms."""
    x, vol, f, v = pair()
    with pytest.raises(
        SimulationDiverged, match=r"particle \d+ .*left the bounds .* frame 1, .*x = .* bounds .*'freeze'"
    ):
        rollout(SCENE, x, vol, f, velocity=v)


@pytest.mark.parametrize("leaving", ["freeze", "remove"])
def test_who_left_stays_where_it_was_and_takes_no_part(leaving):
    """v = 0 from the frame on in which it is outside, the same place in all frames after; the other cube is that of a
    scene without the second, to the last bit of its velocities (0)."""
    x, vol, f, v = pair()
    n = len(x) // 2
    reports: list[FrameReport] = []
    out = rollout(dataclasses.replace(SCENE, leaving=leaving), x, vol, f, velocity=v, report=reports)
    assert reports[-1].gone == n and all(a.gone <= b.gone for a, b in itertools.pairwise(reports))
    assert not bool(out.v[-1, n:].any()) and bool((out.x[-1, n:, 0] > 0.5).all())
    for k in range(n, 2 * n):
        first = int((out.x[:, k, 0] > 0.5).nonzero()[0])
        assert bool((out.x[first:, k] == out.x[first, k]).all()) and not bool(out.v[first:, k].any())
    assert torch.equal(out.x[-1, :n], x[:n])
    mass = float((f.rho * vol)[n:].sum())
    assert reports[-1].removed == pytest.approx(mass if leaving == "remove" else 0.0, rel=1e-14)


def test_a_scene_without_leavers_does_not_change():
    """Bounds that nobody reaches leave every bit as it is."""
    x, vol, f, v = pair()
    wide = dataclasses.replace(SCENE, bounds=((-9.0,) * 3, (9.0,) * 3), leaving="freeze")
    none = dataclasses.replace(SCENE, bounds=None)
    assert torch.equal(rollout(wide, x, vol, f, velocity=v).x, rollout(none, x, vol, f, velocity=v).x)


def test_gradients_go_through_those_who_stay_and_end_where_others_left():
    """∂x_end/∂v_0 = I t of a cube in free flight, t until the end of the frame in which a particle left."""
    x, vol, f, v = pair()
    n, T = len(x) // 2, SCENE.frames / SCENE.fps
    v.requires_grad_()
    out = rollout(dataclasses.replace(SCENE, leaving="freeze"), x, vol, f, velocity=v, grad=True)
    (stay,) = torch.autograd.grad(out.x[-1, :n, 1].mean(), v, retain_graph=True)
    assert float(stay[:n, 1].sum()) == pytest.approx(T, rel=1e-12) and not bool(stay[n:].any())
    first = [int((out.x[:, k, 0] > 0.5).nonzero()[0]) for k in range(n, 2 * n)]
    soonest = min(range(n), key=lambda k: first[k])
    (gone,) = torch.autograd.grad(out.x[-1, n + soonest, 0], v)
    assert float(gone[n:, 0].sum()) == pytest.approx(first[soonest] / SCENE.fps, rel=1e-10)


def test_a_scene_goes_on_when_everybody_has_left():
    x, vol, f, _ = pair()
    scene = dataclasses.replace(SCENE, leaving="remove", velocity=(5.0, 0.0, 0.0), frames=8)
    reports: list[FrameReport] = []
    states = list(simulate(scene, x, vol, f, report=reports))
    assert len(states) == 9 and reports[-1].gone == len(x)
    assert states[-1].time == pytest.approx(8 / 50.0) and not bool(states[-1].v.any())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"bounds": None, "leaving": "freeze"}, "needs bounds"),
        ({"leaving": "delete"}, "'error', 'freeze' or 'remove'"),
        ({"bounds": ((0.0, 0.0, 0.0), (1.0, 0.0, 1.0))}, "low < high"),
        ({"bounds": ((0.0, 0.0), (1.0, 1.0))}, "three finite numbers"),
    ],
)
def test_bounds_without_a_meaning_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(SCENE, **change)
