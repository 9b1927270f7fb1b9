"""A scene that is written out is played as it stands."""

import pytest
import torch

from diffuphy.artifact import describe
from diffuphy.mpm import Box, HalfSpace, InBox
from diffuphy.mpm.stated import Push, Stated
from diffuphy.types import Motion, Particles

MOTION = Motion("falling", "", {}, 1.0)


def body(n=4, off=0.0):
    """n³ particles of side 1/n m."""
    g = (torch.arange(n) + 0.5) / n - 0.5 + off
    x = torch.cartesian_prod(g, g, g)
    return Particles(x, torch.full((len(x),), n**-3), torch.zeros(len(x), dtype=torch.long), 1.0, (0, 0, 0), 1 / n)


class Spaced:
    """What a plan knows before there are particles."""

    spacing = 0.05


@pytest.mark.parametrize("off", [0.0, 0.125])
def test_middle_begins_at_its_height(off):
    """The origin of the particles is lifted to (0, 0, height): the underside, half a particle below the lowest centre,
    to height − ½ + off."""
    scene = Stated(height=0.7).scene(MOTION, body(off=off))
    assert scene.lift == pytest.approx(0.7 - 0.5 + off, abs=1e-6)  # in float32
    assert Stated().scene(MOTION, body(off=off)).lift == 0.0


def test_push_is_that_of_the_particles_it_meets_where_they_begin():
    """J = each · n · of/N, n counted after the lift."""
    top = InBox(low=(-1.0, -1.0, 2.0), high=(1.0, 1.0, 3.0))
    push = Push(each=(2.0, 0.0, 0.0), where=top, start=0.1, duration=0.2)
    (drive,) = Stated(height=2.0, pushes=[push]).scene(MOTION, body()).drives
    assert drive.impulse == (64.0, 0.0, 0.0) and (drive.start, drive.duration, drive.where) == (0.1, 0.2, top)
    (drive,) = Stated(height=2.0, pushes=[Push(each=(2.0, 0.0, 0.0), where=top, of=640)]).scene(MOTION, body()).drives
    assert drive.impulse == (640.0, 0.0, 0.0)


def test_plan_sees_the_scene_without_particles():
    scene = Stated(pushes=[Push(each=(2.0, 0.0, 0.0))], boundaries=[HalfSpace()]).scene(MOTION, Spaced())
    assert scene.dx == pytest.approx(0.1) and len(scene.drives) == 1 and len(scene.boundaries) == 1


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"size": 0.6}, "refine.default_size=0.6"),
        ({"pushes": [Push(each=(1, 0, 0), where=InBox(low=(5, 5, 5), high=(6, 6, 6)))]}, r"pushes\[0\] meets none"),
        ({"boundaries": [Box(size=(1.0, 1.0, 0.1))]}, r"a Box 0.1 m thick, .* set sample.cells=30"),
    ],
)
def test_scene_that_does_not_fit_the_object_is_refused(settings, says):
    with pytest.raises(ValueError, match=says):
        Stated(**settings).scene(MOTION, body())


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"size": -1.0}, "size must be positive"),
        ({"height": float("nan")}, "height must be finite"),
        ({"cfl": 0.9}, "cfl must be in"),
        ({"gravity": (0.0, 1.0)}, "gravity must be three finite numbers"),
        ({"drives": [3]}, r"drives\[0\] must be one of"),
        ({"seconds": 0.0}, "must be positive"),
    ],
)
def test_settings_are_refused_before_anything_runs(settings, says):
    with pytest.raises(ValueError, match=says):
        Stated(**settings)


@pytest.mark.parametrize(
    "settings", [{"each": (1.0, 0.0)}, {"each": (1, 0, 0), "of": 0}, {"each": (1, 0, 0), "duration": 0}]
)
def test_push_that_means_nothing_is_refused(settings):
    with pytest.raises(ValueError):
        Push(**settings)


def test_every_setting_is_part_of_the_key():
    """Walls, drives and pushes are plain data, so that a changed one makes another film."""
    keys = {str(describe(Stated(pushes=[Push(each=(j, 0.0, 0.0))], boundaries=[HalfSpace()]))) for j in (1.0, 2.0)}
    assert len(keys) == 2
