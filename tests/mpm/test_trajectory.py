"""The stage that sets particles in motion."""

import math

import pytest
import torch

from diffuphy.mpm.trajectory import SLOWEST, Simulate
from diffuphy.types import MaterialField, Motion, Particles
from diffuphy.workspace import Workspace
from tests.mpm.bodies import block, field


def ball() -> tuple[Motion, Particles, MaterialField]:
    """A rubber cube of four cells."""
    x, vol = block((4, 4, 4), 0.1, (-0.2, -0.2, -0.2), dtype=torch.float32)
    none = torch.full((len(x),), -1)
    motion = Motion("falling", "a cube falling", {"": "rubber"}, 0.4, "")
    return motion, Particles(x, vol, none, 1.0, (0.0, 0.0, 0.0), 0.05), field(len(x), E=2e4, dtype=torch.float32)


def test_a_frame_of_a_second_is_simulated_in_parts():
    """One frame a second is every fifth of five a second, to the last bit: as long, in blocks of nodes as small."""
    slow, fast = (Simulate(seconds=2.0, fps=fps)(*ball(), work=Workspace(progress=False)) for fps in (1.0, SLOWEST))
    step = round(SLOWEST)
    assert len(slow.x) == 3 and len(fast.x) == 2 * step + 1 and slow.fps == 1.0
    for a, b in ((slow.x, fast.x), (slow.v, fast.v), (slow.F, fast.F)):
        assert torch.equal(a, b[::step])


def test_a_slow_film_goes_on_where_it_stopped(tmp_path):
    """Killed after any frame, the rest is the same to the last bit."""
    scene = Simulate(seconds=3.0, fps=2.0)
    whole = scene(*ball(), work=Workspace(progress=False))

    class Killed(Exception):
        pass

    class Dies(Workspace):
        def save(self, state):
            super().save(state)
            if len(state["x"]) == 3:
                raise Killed

    with pytest.raises(Killed):
        scene(*ball(), work=Dies(tmp_path, interval=0.0, progress=False))
    again = scene(*ball(), work=Workspace(tmp_path, progress=False))
    assert torch.equal(again.x, whole.x) and torch.equal(again.F, whole.F)


@pytest.mark.parametrize("name", ["seconds", "fps", "particles_per_cell"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.inf, math.nan])
def test_a_film_without_end_is_refused(name, value):
    with pytest.raises(ValueError, match="seconds, fps and particles_per_cell must be positive and finite"):
        Simulate(**{name: value})
