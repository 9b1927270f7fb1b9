"""What an evaluation is predicted to take."""

import pytest

from diffuphy.cost import predict
from diffuphy.evaluate import Evaluate
from diffuphy.plan import make_plan
from tests.cost.test_cost import DROP, cache, components

__all__ = ["cache"]


def planned(**settings):
    return make_plan(components() | {"evaluate": Evaluate(**settings)}, DROP)


def test_a_reference_costs_a_trajectory_and_a_film():
    """Work of n references: that of the evaluation without any, and n times that of the two stages."""
    work = [predict(planned(references=r).components, DROP).stages for r in ((), (0,), (0, 1))]
    for unit in work[0]["trajectory"].work | work[0]["clip"].work:
        film = work[0]["trajectory"].work.get(unit, 0) + work[0]["clip"].work.get(unit, 0)
        counts = [w["evaluate"].work.get(unit, 0) for w in work]
        assert counts[1] - counts[0] == pytest.approx(film) and counts[2] - counts[1] == pytest.approx(film)
    assert work[0]["evaluate"].seconds < 0.2 * work[1]["evaluate"].seconds


def test_rays_of_the_prior_are_those_of_the_turntable():
    """8 views of 128² pixels, 4 siblings, 2² rays a pixel."""
    found = predict(planned().components, DROP).stages["evaluate"].work
    assert found["ray"] == 8 * 4 * 128**2 * 4


def test_left_out_it_takes_nothing_and_the_plan_says_what_it_saves():
    plan = planned(score="off")
    assert "evaluate" not in predict(plan.components, DROP).stages
    line = next(line for line in plan.lines if line.what == "scores")
    assert line.decision == "left out" and line.seconds > 0
    kept = next(line for line in planned().lines if "Diff_SSIM" in line.what)
    assert kept.seconds > line.seconds, "a film more costs more than looking at one"
