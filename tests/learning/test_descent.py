"""The training loop, with a model and a world that need no simulation."""

import math
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from diffuphy.learning.descent import Descent, Model, descend
from diffuphy.types import MaterialField, SimulationDiverged
from diffuphy.workspace import Workspace

N, GOAL = 6, 5.0


class Free(Model):
    """A log10 E of each particle's own: no network."""

    def __init__(self, start: float, lr: float = 0.1):
        super().__init__()
        self.log_E, self.lr = torch.nn.Parameter(torch.full((N,), start)), lr

    def forward(self) -> MaterialField:
        one = torch.ones(N, 1)
        return MaterialField(("neo_hookean",), ("identity",), one, one, {"E": 10**self.log_E}, torch.full((N,), 1e3))

    def groups(self) -> list[dict[str, Any]]:
        return [{"params": [self.log_E], "lr": self.lr}]


def world(goal=GOAL, broken=None, torn=-math.inf) -> Any:
    """Films log10 E; the clip wants ``goal``. ``broken``: step whose gradient is not a number; softer than ``torn``
    nothing can be simulated."""
    seen = []

    def simulate(field, frames=None, **options):
        log_E = field.theta["E"].log10()
        if float(log_E.detach().mean()) < torn:
            raise SimulationDiverged("turned inside out")
        return log_E

    def distil(drop, take, **settings):
        seen.append(1)
        loss = (drop - goal).square().mean()
        return loss * float("nan") if len(seen) - 1 == broken else loss

    cond = SimpleNamespace(distil=distil, score=lambda drop, weight: float((drop - goal).square().mean()))
    bench = SimpleNamespace(probe=SimpleNamespace(frames=4), simulate=simulate)
    return SimpleNamespace(bench=bench, cond=cond)


def test_whatever_means_a_field_can_be_trained():
    """A field of free particles, without a network, reaches the goal: 60 steps of 0.05 are 1.6 with their schedule, 0.8
    are needed, and the last steps are a tenth of the first."""
    model = Free(4.2, lr=0.05)
    run = descend(world(), model, Descent(steps=60, patience=0), Workspace())
    assert run.step == 60 and float((model.log_E.detach() - GOAL).abs().max()) < 0.05


def test_the_best_field_is_kept_not_the_last():
    """With steps ten times too long the loss rises: what is left is the least of all that were scored."""
    model = Free(GOAL + 0.01, lr=1.0)
    run = descend(world(), model, Descent(steps=10, patience=0), Workspace())
    assert run.at == 0 and run.score == pytest.approx(1e-4, rel=1e-2)  # float32 of 10^5.01
    assert torch.equal(model.log_E, torch.full((N,), GOAL + 0.01))


def test_a_run_without_progress_ends_after_its_patience():
    """Scores every 5 steps; the first sets the mark, three more without 1 % end the run at step 15."""
    run = descend(world(), Free(GOAL), Descent(steps=40, check=5, patience=3), Workspace())
    assert run.step == 15 and "less than 1%" in run.why
    assert descend(world(), Free(GOAL), Descent(steps=20, patience=0), Workspace()).step == 20


def test_patience_waits_for_the_whole_clip():
    """While the curriculum shows 2 of 4 frames no score counts: half of 40 steps, then three scores."""
    run = descend(world(), Free(GOAL), Descent(steps=40, curriculum=(2, 4), patience=3), Workspace())
    first = next(s for s in range(40) if Descent(steps=40, curriculum=(2, 4)).shown(s, 4) == 4)
    assert first > 10 and run.step == 5 * math.ceil(first / 5) + 10


def test_a_gradient_that_is_not_finite_ends_the_run_and_is_named(caplog):
    """Nothing is zeroed, nothing moves: the best so far remains, and the log names parameter and step."""
    model, same = Free(4.2), Free(4.2)
    run = descend(world(broken=7), model, Descent(steps=20), Workspace())
    assert run.step == 7 and run.at == 5
    assert "step 7: the gradient of log_E (6 of 6 numbers) is not finite" in caplog.text
    descend(world(), same, Descent(steps=20, patience=0), Workspace(), state=None)
    assert bool(model.log_E.isfinite().all())


def test_a_start_that_cannot_be_simulated_is_an_error_a_step_is_not(caplog):
    with pytest.raises(SimulationDiverged):
        descend(world(torn=4.5), Free(4.2), Descent(steps=5), Workspace())
    run = descend(world(goal=3.0, torn=4.0), Free(4.3), Descent(steps=20, check=2), Workspace())
    assert "turned inside out" in run.why and 0 < run.step < 20
    assert run.best["log_E"].mean() >= 4.0


def test_settings_that_mean_nothing_are_refused():
    with pytest.raises(ValueError, match="check ≥ 1"):
        Descent(check=0)


def test_the_clip_is_blurred_first_and_sharp_in_the_end():
    """Two low-passes and 12 steps: three parts, the last of twice the length; patience waits for the sharp ones."""
    settings, seen = Descent(steps=12, blur=(0.2, 0.1), check=2, patience=1), []
    case = world()
    distil = case.cond.distil
    case.cond.distil = lambda drop, take, **given: seen.append(take.blur) or distil(drop, take, **given)
    run = descend(case, Free(GOAL), settings, Workspace())
    assert seen == [0.2] * 3 + [0.1] * 3
    assert run.step == 6 and "less than 1%" in run.why
