"""Scenes: each motion word does what it says, and settings that make no scene are refused."""

import math

import pytest
import torch

from diffuphy.mpm import SCENES, Scene, Sphere, scene_for, simulate
from tests.mpm.bodies import block, field

SIZE = 0.4


@pytest.fixture(scope="module")
def films():
    """Centre, top and lowest point of a soft cube in every scene, 20 frames of 1/20 s."""
    out = {}
    for verb in SCENES:
        scene = scene_for(verb, SIZE, cells=5, frames=20, fps=20.0)
        x, vol = block((5, 5, 5), scene.dx, dtype=torch.float32)
        x = x - (x.amin(0) + x.amax(0)) / 2
        E = 1e6 if verb == "sliding" else 1e5  # a soft cube tips and hops when it is stopped at a quarter of its c
        out[verb] = list(simulate(scene, x, vol, field(len(x), E=E, dtype=torch.float32)))
    return out


def heights(states) -> tuple[torch.Tensor, torch.Tensor]:
    z = torch.stack([s.x[:, 2] for s in states])
    return z.amin(1), z.amax(1)


def test_no_scene_lets_a_body_through_the_floor(films):
    """A particle may sink by part of a cell of 0.08 m, never by more."""
    for verb, states in films.items():
        assert float(heights(states)[0].min()) > -0.5 * SIZE / 5, verb


def test_things_fall_and_bounce(films):
    """The first landing comes after √(2 h/g), less what the wall reaches up; an elastic body rises again."""
    for verb, lift in (("falling", 0.8 * SIZE), ("bouncing", 1.2 * SIZE)):
        low, _ = heights(films[verb])
        assert float(low[0]) == pytest.approx(lift + 0.25 * SIZE / 5, abs=1e-6)  # half a particle above its underside
        landing = math.sqrt(2 * lift / 9.81) * 20
        assert low[: int(landing) - 1].min() > 0.1 * lift
        assert float(low[int(landing) + 2 :].max()) > 0.3 * lift


def test_thrown_and_sliding_things_travel_and_stop_by_friction(films):
    assert float(films["thrown"][-1].x[:, 0].mean()) > 2 * SIZE
    x = [float(s.x[:, 0].mean()) for s in films["sliding"]]
    assert x[-1] == pytest.approx(2 * SIZE, rel=0.1)  # v²/(2 μ g) = 2 sizes


def test_spinning_things_keep_their_axis(films):
    states = films["spinning"]
    assert float((states[-1].x.mean(0) - states[0].x.mean(0))[:2].norm()) < 0.05 * SIZE
    C = states[0].C[0]
    assert float(C[1, 0]) == pytest.approx(4 * math.pi, rel=1e-6) and float(C[0, 1]) == pytest.approx(
        -4 * math.pi, rel=1e-6
    )


def test_the_press_flattens_and_lets_go(films):
    _, high = heights(films["squashed"])
    assert float(high[9]) < 0.75 * float(high[0]) and float(high[10:].max()) > 0.95 * float(high[0])


def test_the_finger_dents(films):
    """The side it touches is compressed and moves in by more than half a cell, then comes back."""
    start, deep = films["poked"][0], films["poked"][9]
    side = start.x[:, 0] < start.x[:, 0].min() + 0.05
    at = side & (start.x[:, 1].abs() < 0.05) & ((start.x[:, 2] - 0.14).abs() < 0.05)
    moved = (deep.x - start.x)[at, 0].mean()
    assert float(moved) > 0.5 * SIZE / 5 and float(deep.He[:, 0, 0].min()) < -0.1


def test_unknown_words_and_impossible_settings_are_refused():
    with pytest.raises(ValueError, match=r"no scene for the motion 'flying'; known: falling"):
        scene_for("flying", SIZE)
    for wrong in (dict(size=0.0), dict(size=1.0, cells=3), dict(size=1.0, dx=0.5), dict(size=1.0, friction=-1.0)):
        with pytest.raises(ValueError):
            scene_for("falling", **wrong)
    for wrong in (
        dict(dx=0.0),
        dict(fps=math.inf),
        dict(frames=0),
        dict(cfl=0.9),
        dict(gravity=(0.0, 0.0)),
        dict(lift=math.nan),
        dict(dx=0.1, boundaries=(Sphere(radius=0.1),)),
    ):
        with pytest.raises(ValueError):
            Scene(**wrong)
