"""Physical checks on motions in closed form, and on motions that break the law."""

import dataclasses
import math

import pytest
import torch

from diffuphy.metrics import physics
from diffuphy.metrics.physics import World
from diffuphy.types import Trajectory

G, DT = 9.81, 1 / 30
FLOOR = World((0.0, 0.0, -G), (((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)),), 0.05, True)


def thrown(frames=10, n=20, floor=1.0):
    """x = x₀ + v₀ t + g t²/2: a cloud in flight."""
    g = torch.Generator().manual_seed(0)
    x0, v0 = torch.rand(n, 3, generator=g) + torch.tensor([0, 0, floor]), torch.tensor([1.0, 0.0, 1.0])
    t, a = torch.arange(frames)[:, None, None] * DT, torch.tensor([0.0, 0.0, -G])
    x, v = x0 + v0 * t + a * t * t / 2, (v0 + a * t).expand(-1, n, -1)
    return Trajectory(x, v, torch.eye(3).expand(frames, n, 3, 3), 30.0)


MASS, VOL = torch.rand(20, generator=torch.Generator().manual_seed(1)) + 0.5, torch.ones(20)


def test_flight_keeps_momentum_and_energy():
    """Both in closed form; velocities are float32, 10⁻⁷ of 2 m/s over g Δt = 0.33 m/s."""
    film = thrown()
    assert len(physics.momentum(film, MASS, FLOOR)) == 9
    assert float(physics.momentum(film, MASS, FLOOR).max()) < 5e-6
    assert float(physics.energy(film, MASS, FLOOR, 1.0).abs().max()) < 1e-5


def test_a_drag_that_nobody_asked_for_is_found():
    """Velocities reduced by a share ε of g Δt each frame: the error is ε."""
    film = thrown()
    drag = 0.01 * G * DT * torch.arange(10)[:, None, None] * torch.tensor([0.0, 0.0, 1.0])
    found = physics.momentum(dataclasses.replace(film, v=film.v + drag), MASS, FLOOR)
    assert torch.allclose(found, torch.full_like(found, 0.01), rtol=1e-3)


def test_frames_near_a_wall_are_not_free():
    """From the height h the lowest particle is free while h + v t − g t²/2 > reach."""
    film = thrown(frames=30, floor=0.3)
    count = len(physics.momentum(film, MASS, FLOOR))
    low = film.x[..., 2].amin(1)
    assert 0 < count < int((low > 0.05).sum())


def test_energy_that_is_created_is_seen():
    """A body at rest that suddenly moves at v: v²/2 over |g| size."""
    film = thrown()
    still = torch.zeros_like(film.v)
    still[5:, :, 0] = 2.0
    x = film.x[:1].expand(10, -1, -1)
    energy = physics.energy(dataclasses.replace(film, x=x, v=still), MASS, FLOOR, 0.5)
    assert float(energy.max()) == pytest.approx(2.0 / (G * 0.5), rel=1e-6)


def test_depth_behind_an_inclined_wall():
    """The plane x = z: a point d below it is d/√2 behind it."""
    s = 1 / math.sqrt(2)
    slope = dataclasses.replace(FLOOR, walls=(((0.0, 0.0, 0.0), (-s, 0.0, s)),))
    film = thrown(frames=1, n=1)
    deep = dataclasses.replace(film, x=torch.tensor([[[1.0, 0.0, 0.8]]]))
    assert float(physics.penetration(deep, slope)) == pytest.approx(0.2 * s, rel=1e-5)
    assert float(physics.penetration(film, FLOOR)) == 0.0


def test_volume_and_strain_of_a_uniform_stretch():
    """F = diag(1.1, 1, 1): J = 1.1, |FᵀF − 1|/2 = 0.105. A mirrored particle, det F = −1, counts as inverted."""
    film = thrown(frames=2)
    F = film.F.clone()
    F[1] = torch.diag(torch.tensor([1.1, 1.0, 1.0]))
    film = dataclasses.replace(film, F=F)
    ratio, inverted = physics.volume(film, VOL)
    assert ratio.tolist() == pytest.approx([1.0, 1.1], rel=1e-6) and inverted == 0.0
    assert physics.strain(film, VOL).tolist() == pytest.approx([0.0, 0.105], rel=1e-5)
    F[1, 0] = torch.diag(torch.tensor([-1.0, 1.0, 1.0]))
    assert physics.volume(dataclasses.replace(film, F=F), VOL)[1] == pytest.approx(1 / 20)


def test_pace_is_the_root_of_the_mean_square_by_mass():
    film = thrown(frames=1, n=2)
    film = dataclasses.replace(film, v=torch.tensor([[[3.0, 0, 0], [0, 0, 0]]]))
    assert float(physics.pace(film, torch.tensor([1.0, 8.0]))) == pytest.approx(1.0)
