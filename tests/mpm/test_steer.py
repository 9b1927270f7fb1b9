"""Drives that change while a simulation runs."""

import pytest
import torch

from diffuphy.mpm import Acceleration, Attractor, Scene, Vortex, simulate
from tests.mpm.bodies import block, field

DX, FPS = 0.05, 50.0
FREE = Scene(gravity=(0.0, 0.0, 0.0), dx=DX, fps=FPS, frames=3, boundaries=(), lift=None)


def test_steered_accelerations_add_up_frame_by_frame():
    """A body that only a uniform acceleration acts on: v = Σ_t a_t T and the x of the parabolas, whatever a_t is."""
    x, vol = block((2, 2, 2), DX)
    pulls = {0: (1.0, 0.0, 0.0), 1: (0.0, -2.0, 0.0), 2: (0.0, 0.0, 3.0)}

    def steer(state):
        return (Acceleration(acceleration=pulls[round(state.time * FPS)]),)

    *_, end = simulate(FREE, x, vol, field(len(x)), steer=steer)
    T = 1 / FPS
    a = x.new_tensor(list(pulls.values()))
    v = torch.cat([x.new_zeros(1, 3), (a * T).cumsum(0)])
    # rounding of some 20 substeps a frame
    torch.testing.assert_close(end.v, v[-1].expand_as(x), rtol=0, atol=1e-12)
    torch.testing.assert_close(end.x - x, (v[:-1] * T + a * T * T / 2).sum(0).expand_as(x), rtol=0, atol=1e-12)


def test_steering_that_says_what_the_scene_says_changes_nothing():
    """Drives of the scene and the same ones handed out frame by frame give the same bits, on the same particles."""
    x, vol = block((2, 2, 2), DX)
    pull = Attractor(where=(0, 1, 2, 3), center=(0.1, 0.1, 0.3), strength=30.0, radius=0.1, falloff=0.0)
    stated = Scene(gravity=FREE.gravity, dx=DX, fps=FPS, frames=3, boundaries=(), lift=None, drives=(pull,))
    *_, one = simulate(stated, x, vol, field(len(x)))
    *_, other = simulate(FREE, x, vol, field(len(x)), steer=lambda state: (pull,))
    assert torch.equal(one.x, other.x) and torch.equal(one.v, other.v)
    assert float((one.x - x).abs().max()) > 1e-3  # it did act


def test_steering_to_another_kind_is_refused():
    """Kernels are compiled for kinds of drives, so another kind in the middle of a run is an error."""
    x, vol = block((2, 2, 2), DX)
    pull, swirl = (kind(center=(0.1, 0.1, 0.3), strength=1.0, radius=0.1) for kind in (Attractor, Vortex))
    states = simulate(FREE, x, vol, field(len(x)), steer=lambda state: (swirl if state.time > 0 else pull,))
    next(states), next(states)
    with pytest.raises(ValueError, match="steering must keep the kinds"):
        next(states)


@pytest.mark.parametrize("options", [{"grad": True}, {"scenes": 2}])
def test_what_cannot_be_steered_is_refused(options):
    """A backward pass runs frames again, with the drives they had."""
    x, vol = block((2, 2, 2), DX)
    with pytest.raises(ValueError, match="steer changes drives"):
        next(simulate(FREE, x, vol, field(len(x)), steer=lambda state: (), **options))
