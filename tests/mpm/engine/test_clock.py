"""How long a substep is."""

from types import SimpleNamespace

import pytest
import torch

from diffuphy.mpm import Scene, simulate
from diffuphy.mpm.engine.clock import Clock
from tests.mpm.bodies import block, field

DX = 0.1


def frame(**scene):
    """Report of the first frame of a block of eight particles in the air."""
    x, vol = block((1, 1, 1), DX, dtype=torch.float32)
    report = []
    scene = Scene(**{"dx": DX, "lift": 1.0, "fps": 10.0, "frames": 1} | scene)
    list(simulate(scene, x, vol, field(len(x), dtype=torch.float32), report=report))
    return report[0]


def test_the_speed_of_a_frame_is_what_gravity_makes_of_it():
    """V = |v| + g T bounds the fastest particle of the frame; in a fall from rest it is reached."""
    assert frame().speed == pytest.approx(9.81 / 10.0, rel=1e-6)
    assert frame(velocity=(3.0, 0.0, -4.0)).speed == pytest.approx(5.0 + 9.81 / 10.0, rel=1e-6)


def test_the_substep_follows_wave_and_speed():
    """n = ⌈T (c + V)/(cfl Δx)⌉ with c² = (λ + 2μ)/ρ at rest."""
    E, nu = 1e5, 0.3
    c = (E * (1 - nu) / ((1 + nu) * (1 - 2 * nu)) / 1000.0) ** 0.5
    for v in (0.0, 30.0):
        n = 0.1 * (c + v + 0.981) / (0.4 * DX)
        assert abs(frame(velocity=(v, 0.0, 0.0)).n_sub - n) <= 1.0  # rounded up


def test_waves_outrun_a_substep_when_they_cross_more_than_a_cell_in_it():
    clock = object.__new__(Clock)
    clock.dt, clock.stiff = None, lambda state: 20.0
    for dt, outruns in ((0.99 * DX / 20.0, False), (1.01 * DX / 20.0, True)):
        assert clock.outrun(SimpleNamespace(dt=dt, grid=SimpleNamespace(dx=DX)), None) is outruns
    clock.dt = 1e-3  # the user insists
    assert not clock.outrun(SimpleNamespace(dt=1.0, grid=SimpleNamespace(dx=DX)), None)


def test_a_frame_whose_waves_outran_it_is_run_again_in_half_the_substep(monkeypatch):
    plain = frame()
    monkeypatch.setattr(Clock, "outrun", lambda self, span, end: span.n_sub < 2 * plain.n_sub)
    again = frame()
    assert (again.halvings, again.n_sub) == (1, 2 * plain.n_sub) and plain.halvings == 0
