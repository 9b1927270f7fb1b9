"""What is predicted for a material that is not found our way: counts are those of the stage itself."""

import dataclasses
from types import SimpleNamespace

import pytest
import torch

from diffuphy.cost import coefficients, predict
from diffuphy.cost.body import body
from diffuphy.cost.drop import Drop
from diffuphy.cost.matter import Matter
from diffuphy.cost.rivals import given, trained
from diffuphy.cost.rollouts import Laws
from diffuphy.cost.stages import STAGES
from diffuphy.learning.probe import table_field
from diffuphy.losses.takes import Takes
from diffuphy.material import wave_speed
from diffuphy.material.labelled import LabelledMaterial
from diffuphy.material.presets import lookup
from diffuphy.material.stated import Piece, StatedMaterial
from diffuphy.mpm.engine.solver import Solver
from diffuphy.plan import make_plan
from diffuphy.rivals.ablations import LAW, OneLaw
from diffuphy.rivals.physgaussian import PhysGaussian
from diffuphy.rivals.substep import LastSubstep
from diffuphy.workspace import Workspace
from tests.cost.test_cost import DROP, cache, components
from tests.rivals.test_rivals import LOOK, PROBE, RIVALS, ball, case, moving

__all__ = ["cache"]

CLAY = Piece("hencky", "von_mises", 1800.0, {"E": 2e5, "nu": 0.4, "yield_stress": 4e3})
HARD = Piece("fixed_corotated", "identity", 1000.0, {"E": 3e6, "nu": 0.3}, low=(-9.0, -9.0, 0.0))


def labelled():
    """Two words by label, for the Gaussians of ``ball``."""
    gaussians, _ = ball()
    kinds = (gaussians.means[:, 2] > 0).long()
    return LabelledMaterial(SimpleNamespace(materials={0: "jelly", 1: "clay"}, kinds=lambda: kinds))


GIVEN = {
    "physgaussian": PhysGaussian(),
    "told": PhysGaussian(values="table"),
    "stated": StatedMaterial((CLAY, HARD)),
    "labelled": labelled(),
}
LEARN = {name: rival for name, rival in RIVALS.items() if hasattr(rival, "steps") and name != "one law"}


def planned(material):
    return make_plan(components() | {"material": material}, DROP).components


@pytest.mark.parametrize("name", [*GIVEN, *RIVALS])
def test_every_way_of_finding_a_material_is_predicted(name):
    """All stages have a price; what is given takes no time to speak of, what is learnt takes some."""
    found = predict(planned((GIVEN | RIVALS)[name]), DROP)
    assert list(found.stages) == list(STAGES)
    seconds = found.stages["material"].seconds
    assert seconds < 0.5 if name in GIVEN else seconds > coefficients()["seconds"]["material"]
    assert all(s.bytes > 0 for s in found.stages.values()) and found.stages["trajectory"].seconds > 0


@pytest.mark.parametrize("name", GIVEN)
def test_the_matter_of_a_given_material_is_that_of_its_particles(name):
    """Laws and fastest wave of the forecast are those of the field that the stage makes, whatever its particles."""
    motion = moving("clay")
    made = GIVEN[name](LOOK, motion, *ball(), work=Workspace())
    told = Matter.of(GIVEN[name].expected(motion))
    assert set(told.laws.elastic) == set(made.elastic) and told.laws == Laws.of(
        told.laws.elastic, tuple(made.plastic), made.branches
    )
    wave = wave_speed(made.elastic, made.w_e, made.theta, made.rho, made.branches)
    assert told.wave == pytest.approx(float(wave.max()), rel=1e-6)  # float32


@pytest.mark.parametrize("name", ["dreamphysics", "physics3d"])
def test_a_step_of_fixed_length_makes_the_stiffest_particle_as_stiff_as_said(name):
    """One step of MinMax moves one particle of every field up by half a step, whatever the clip."""
    rival = dataclasses.replace(RIVALS[name], steps=1)
    motion = moving()
    made = rival(LOOK, motion, *ball(), work=Workspace())
    row = rival.expected(motion)
    # the film's particles take theirs from the draft's, whose stiffest one need not be among those taken
    for p in (p for p in rival.learnt if p.name in ("E", "E_N")):
        assert float(made.theta[p.name].max()) == pytest.approx(float(row.theta[p.name]), rel=1e-4)
    wave = wave_speed(made.elastic, made.w_e, made.theta, made.rho, made.branches)
    assert float(wave.max()) <= Matter.of(row).wave * (1 + 1e-6)


def test_what_no_rival_can_pass_bounds_the_forecast():
    """E is never above the program's largest, however many steps there are."""
    rival = dataclasses.replace(RIVALS["dreamphysics"], steps=100)
    assert float(rival.expected(moving()).theta["E"]) == pytest.approx(rival.high)
    assert float(rival.expected(moving(), 0.01).theta["E"]) == pytest.approx(rival.start * 10**0.5, rel=1e-5)


def test_adam_goes_towards_what_the_clip_shows_and_not_beyond():
    near, far = (dataclasses.replace(RIVALS["dreamphysics"], rule="adam", steps=n) for n in (2, 1000))
    goal, start = lookup("rubber").E, near.start
    assert float(far.expected(moving()).theta["E"]) == pytest.approx(goal, rel=1e-5)
    lo, hi = sorted((goal, start))
    assert lo < float(near.expected(moving()).theta["E"]) < hi


@pytest.mark.parametrize("name", LEARN)
def test_frames_of_a_rival_are_those_that_it_simulates(name, monkeypatch, tmp_path):
    """Prior, steps, scores between them, verdict: every frame of every drop is counted, and no other."""
    taken, advance = [], Solver.advance
    monkeypatch.setattr(Solver, "advance", lambda *a, **k: (taken.append(1), advance(*a, **k))[1])
    rival, motion = LEARN[name], moving()
    elastic, plastic, _ = rival.experts(motion)
    rival = dataclasses.replace(rival, elastic=elastic, plastic=plastic)
    work = Workspace(tmp_path, progress=False)
    rival(LOOK, motion, *ball(), work=work)
    made = components() | {"material": rival}
    counted = trained(made, motion, body(made, DROP, particles=len(ball()[1])))
    several = len(elastic) * len(plastic) > 1
    kept = several and "pruning_change" not in (tmp_path / "summary.json").read_text()
    assert counted.work["frame"] - 2 * PROBE.frames * kept == len(taken)


def test_rounds_of_a_truncated_gradient_are_those_that_it_takes(monkeypatch):
    """Beyond the rounds of the drop: a closing half for each frame, and its first frame once more; backward a substep
    and a closing half for each. Cut off are 0.9 of a substep, so one frame in ten may take one substep more."""
    forward, back = [], []
    advance, adjoint = Solver.advance, Solver.advance_adjoint
    monkeypatch.setattr(
        Solver, "advance", lambda self, state, matter, span, *a, **k: (
            forward.append(span.steps), advance(self, state, matter, span, *a, **k))[1],
    )  # fmt: skip
    monkeypatch.setattr(
        Solver, "advance_adjoint", lambda self, state, matter, span, *a, **k: (
            back.append(span.steps), adjoint(self, state, matter, span, *a, **k))[1],
    )  # fmt: skip
    bench = case().bench
    field = table_field(None, LOOK, moving(), bench.draft)
    with torch.no_grad():
        bench.simulate(field)
    whole, first = sum(forward), forward[0]
    forward.clear()
    E = field.theta["E"].clone().requires_grad_()
    film = LastSubstep.like(bench).simulate(dataclasses.replace(field, theta=field.theta | {"E": E}))
    film.x.sum().backward()
    made = components()
    drop = Drop(PROBE, Takes(), body(made, DROP), 0)
    wave = 10.0
    told, plain = (drop.clip(PROBE.frames, Laws.of(*LAW), wave, grad) for grad in ("substep", "none"))
    more = told["round"] - plain["round"] - plain["round"] / PROBE.frames
    assert 0 <= round(sum(forward) - whole - first - more) <= 1
    assert sum(back) == told["back.round"] == PROBE.frames * 2


def test_a_truncated_gradient_keeps_less_than_a_whole_one():
    made = components()
    drop = Drop(PROBE, Takes(), body(made, DROP), 0)
    laws = Laws.of(*LAW)
    assert drop.states(3, laws, 30.0, "substep") < 0.3 * drop.states(3, laws, 30.0, "full")


def test_labels_are_looked_for_pair_by_pair():
    """Particles at Gaussians times particles inside; a material that is stated looks for nothing."""
    made = planned(labelled())
    what = body(made, DROP, particles=10_000)
    few = dataclasses.replace(what, gaussians=100.0)
    assert given(made, DROP.motion, few).work["label.pair"] == 100 * 9900
    assert not given(planned(GIVEN["stated"]), DROP.motion, what).work["label.pair"]


def test_a_plan_of_one_law_pays_for_one_law():
    """Without the mixture there is one choice to scan, and none to refine."""
    prompt = dataclasses.replace(DROP, motion=dataclasses.replace(DROP.motion, materials={"": "clay"}))
    ours = components()["material"]
    fields = {f.name: getattr(ours, f.name) for f in dataclasses.fields(ours)}
    alone = OneLaw(**fields | {"elastic": (), "plastic": ()})
    free = dataclasses.replace(ours, elastic=(), plastic=())
    both = [make_plan(components() | {"material": m}, prompt).components for m in (free, alone)]
    full, one = (predict(c, prompt).stages for c in both)
    assert one["material"].seconds < full["material"].seconds
    assert not [u for u in one["trajectory"].work if "von_mises" in u] and [
        u for u in full["trajectory"].work if "von_mises" in u
    ]
