"""Asking for an accuracy: the curves are obeyed, the cheapest is taken, the unreachable refused."""

import dataclasses
import json

import pytest

from diffuphy.accuracy import BEYOND, CURVES, FAMILIES, FEWEST, Curve, Unreachable, ceiled, choose, curves, families
from diffuphy.learning.fit_material import FitMaterial
from diffuphy.losses.guidance.analytic import Analytic
from diffuphy.material.presets import PRESETS
from diffuphy.mpm.sampling.sample import Sample
from diffuphy.mpm.trajectory import Simulate
from diffuphy.plan import make_plan
from diffuphy.render.film.clip import Film
from diffuphy.text2gs.fit import FitGaussians
from diffuphy.types import Look, Motion, Prompt


def motion(*words, verb="falling"):
    return Motion(verb, "x", {"": words[0]} | {f"part{i}": w for i, w in enumerate(words[1:])})


def reachable(*words):
    """An accuracy between what the fewest cells give and the best there is."""
    mine = [curves()[f][2] for f in families(motion(*words))]
    return max(c.at(0.7 * c.most) for c in mine)


def test_every_material_of_the_table_has_a_curve():
    assert {FAMILIES[p.plastic] for p in PRESETS.values()} <= set(curves())
    assert all(set(of) == {2, 3} for of in curves().values())


def test_curve_and_its_inverse():
    """e(n) = e₀ (n₀/n)ᵖ: twice the cells, 2ᵖ less; needed(e(n)) = n."""
    c = Curve(error=0.1, order=1.2, cells=10, finest=20, price=1.0, rounding=1e-6)
    assert c.at(20) == pytest.approx(0.1 / 2**1.2)
    assert c.needed(c.at(33.0)) == pytest.approx(33.0)
    assert c.most == 20 * BEYOND


@pytest.mark.parametrize("words", [("rubber",), ("sand",), ("bread", "cheese", "honey")])
def test_what_is_chosen_is_accurate_enough_for_every_material(words):
    """e ≤ accuracy for all, and one cell less would not do: nothing finer than needed."""
    wanted = reachable(*words)
    choice = choose(wanted, motion(*words))
    of = [curves()[f][choice.order] for f in choice.families]
    assert max(c.at(choice.cells) for c in of) <= wanted
    assert choice.cells == FEWEST or max(c.at(choice.cells - 1) for c in of) > wanted


def test_the_cheapest_of_two_splines_is_taken(monkeypatch):
    """Cubic splines that need half of the cells cost (1/2)⁴ of the work a cell; at sixteen times the price neither
    wins, above it the quadratic does."""
    base = Curve(error=0.1, order=1.0, cells=20, finest=40, price=1.0, rounding=1e-9)
    for price, order in ((2.0, 3), (40.0, 2)):
        table = {"elastic": {2: base, 3: dataclasses.replace(base, error=0.05, price=price)}}
        monkeypatch.setattr("diffuphy.accuracy.curves", lambda table=table: table)
        assert choose(0.04, motion("rubber")).order == order


def test_rounding_that_takes_a_share_asks_for_float64(monkeypatch):
    base = Curve(error=0.1, order=1.0, cells=20, finest=40, price=1.0, rounding=1e-3)
    monkeypatch.setattr("diffuphy.accuracy.curves", lambda: {"elastic": {2: base, 3: base}})
    assert choose(0.05, motion("rubber")).double is False
    fine = dataclasses.replace(base, rounding=6e-3)
    monkeypatch.setattr("diffuphy.accuracy.curves", lambda: {"elastic": {2: fine, 3: fine}})
    assert choose(0.05, motion("rubber")).double is True


def test_what_no_curve_promises_is_refused_with_the_best():
    with pytest.raises(Unreachable, match="the best that can be promised is accuracy=") as refused:
        choose(1e-9, motion("jelly"))
    best = refused.value.best
    assert choose(ceiled(best.error), motion("jelly")).cells <= best.cells


@pytest.mark.parametrize("bad", [0.0, 1.0, -0.1, float("nan")])
def test_impossible_accuracies_are_refused(bad):
    with pytest.raises(ValueError, match=r"in \(0, 1\)"):
        choose(bad, motion("jelly"))


def test_melting_takes_the_curve_of_what_flows():
    assert families(motion("cheese", verb="melting")) == ("paste",)


# ---------------------------------------------------------------------- in the plan
def components():
    return {
        "gaussians": FitGaussians(guidance=Analytic(layout="views")),
        "particles": Sample(),
        "material": FitMaterial(guidance=Analytic(layout="clip", s=0.0)),
        "trajectory": Simulate(),
        "clip": Film(),
    }


PROMPT = Prompt(Look("jelly", "a jelly"), motion("jelly"))


def test_no_accuracy_changes_nothing():
    """The very same components, but for what a plan fills in."""
    mine = components()
    plan = make_plan(mine, PROMPT, accuracy=None)
    assert all(plan.components[k] is mine[k] for k in ("gaussians", "trajectory"))
    assert dataclasses.replace(plan.components["particles"], pixel=mine["particles"].pixel) == mine["particles"]
    assert not any(line.what.startswith("accuracy") for line in plan.lines)


def test_the_plan_has_and_says_what_was_chosen():
    """Δx = spacing · particles_per_cell^⅓ = size / cells, and no lattice is made coarser for want of particles."""
    wanted = reachable("jelly")
    choice = choose(wanted, PROMPT.motion)
    plan = make_plan(components(), PROMPT, accuracy=wanted)
    sample, scene = plan.components["particles"], plan.components["trajectory"]
    assert sample.cells == choice.cells and scene.scheme.order == choice.order
    assert sample.max_particles >= sample.per_cell * choice.cells**3
    (line,) = (line for line in plan.lines if line.what.startswith("accuracy"))
    assert str(choice) == line.decision and f"{choice.error:.1%}" in line.why


def test_other_numbers_of_particles_a_cell_keep_the_grid():
    choice = choose(reachable("jelly"), PROMPT.motion)
    mine = components() | {"trajectory": Simulate(particles_per_cell=27.0)}
    sample = choice.applied(mine)["particles"]
    spacing = 1 / sample.cells / sample.per_cell ** (1 / 3)
    assert spacing * 27 ** (1 / 3) <= 1 / choice.cells


def test_curves_are_those_of_the_benchmark():
    """What the package goes by is what the documentation shows."""
    from benchmarks.errors import OUT, rounded

    shown = json.loads((OUT / "errors.json").read_text(encoding="utf-8"))["curves"]
    held = json.loads(CURVES.read_text(encoding="utf-8"))["curves"]
    assert held == {f: {k: rounded(c) for k, c in of.items()} for f, of in shown.items()}
