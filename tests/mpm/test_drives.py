"""Drives within a whole simulation: what is held moves as a rigid body, whatever its neighbours do."""

import pytest
import torch

from diffuphy.mpm import Held, InBox, Release, Scene, Scheme, simulate
from tests.mpm.bodies import block, field, rotation

DX = 0.05


@pytest.mark.parametrize("scheme", [Scheme(), Scheme.mls()], ids=["default", "mls"])
def test_what_is_held_turns_as_a_rigid_body(scheme):
    """x = c + V t + R(ω t)(x₀ − c) and F = R(ω t) of the lower half of a block that is twisted; the upper half, which
    shares nodes with it, is strained and follows."""
    x, vol = block((2, 2, 4), DX)
    held, spin, V = x[:, 2] < 2 * DX, 8.0, (0.1, 0.0, 0.0)
    drive = Held(
        where=InBox(low=(-1.0, -1.0, -1.0), high=(1.0, 1.0, 2 * DX)), center=(DX, DX, 0.0), velocity=V,
        angular_velocity=(0.0, 0.0, spin),
    )  # fmt: skip
    scene = Scene(dx=DX, fps=50.0, frames=3, boundaries=(), lift=None, drives=(drive,), scheme=scheme)
    *_, end = simulate(scene, x, vol, field(len(x)))
    t, c = 3 / 50, x.new_tensor([DX, DX, 0.0])
    R = rotation((0.0, 0.0, 1.0), spin * t)
    # chords of the arc, in exact arithmetic on the circle: about 50 substeps of rounding
    torch.testing.assert_close(
        end.x[held], c + t * x.new_tensor(V) + (x[held] - c) @ R.T, rtol=0, atol=1e-12
    )  # fmt: skip
    torch.testing.assert_close(end.F[held], R.expand(int(held.sum()), 3, 3), rtol=0, atol=1e-12)
    strain = end.F[~held].mT @ end.F[~held] - torch.eye(3, dtype=x.dtype)
    assert float(strain.abs().max()) > 1e-2
    assert float((end.x[~held] - x[~held]).norm(dim=1).min()) > 1e-3


def test_what_is_not_yet_released_does_not_deform():
    """v = 0 and F = I until the plane has passed, however the body beside it moves."""
    x, vol = block((2, 2, 4), DX)
    drive = Release(point=(0.0, 0.0, 0.0), normal=(0.0, 0.0, 1.0), speed=1.2)
    scene = Scene(dx=DX, fps=50.0, frames=3, boundaries=(), lift=None, drives=(drive,))
    *_, end = simulate(scene, x, vol, field(len(x), E=2e4))
    still = x[:, 2] > 0.06 * 1.2 + DX / 4  # half of a particle and more above the plane at the end
    assert 0 < int(still.sum()) < len(x)
    assert torch.equal(end.x[still], x[still]) and not bool(end.He[still].any())
    assert float(end.x[~still][:, 2].mean() - x[~still][:, 2].mean()) < 0
