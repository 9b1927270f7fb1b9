"""The plan names what a scene needs, leaves the rest out, and is obeyed."""

import dataclasses
import json

import pytest
import torch

from diffuphy.artifact import Stage
from diffuphy.cost import predict
from diffuphy.learning.fit_material import FitMaterial
from diffuphy.losses.guidance.analytic import Analytic
from diffuphy.losses.takes import Takes
from diffuphy.losses.velocity import Velocity
from diffuphy.material.net import Net
from diffuphy.material.stated import Piece, StatedMaterial
from diffuphy.mpm import HalfSpace, Scheme
from diffuphy.mpm.sampling.sample import Sample
from diffuphy.mpm.stated import Stated
from diffuphy.mpm.trajectory import Simulate
from diffuphy.plan import cost_lines, make_plan, predicted, pruned_lines, stage_lines
from diffuphy.plan.learning import loss_lines
from diffuphy.render import Film
from diffuphy.text2gs.fit import FitGaussians
from diffuphy.text2gs.refine.rules import Rules
from diffuphy.text2gs.shape_prior import ShapePrior
from diffuphy.types import Look, MaterialField, Motion, Prompt


def components(**material):
    return {
        "prompt": Rules(prompt="a burger falling"),
        "gaussians": FitGaussians(guidance=Analytic(layout="views")),
        "particles": Sample(),
        "material": FitMaterial(guidance=Analytic(layout="clip", s=0.0), **material),
        "trajectory": Simulate(),
        "clip": Film(),
    }


def prompt(*words, verb="falling"):
    materials = {"": words[0]} | {f"part{i}": w for i, w in enumerate(words[1:])}
    return Prompt(Look("burger", "a burger"), Motion(verb, "x", materials))


def decision(plan, what):
    return next(line.decision for line in plan.lines if line.what == what)


def test_elastic_candidates_with_direct_forms_need_one_gradient_and_no_decomposition():
    plan = make_plan(components(elastic=("neo_hookean",), plastic=("identity",)), prompt("rubber"))
    assert decision(plan, "deformation gradients") == "one"
    assert decision(plan, "principal decomposition") == "left out"
    assert decision(plan, "return mapping") == "left out"
    assert decision(plan, "mixture weights") == "left out"


def test_given_material_leaves_learning_out():
    """Laws are those of the pieces, whatever the prompt says; there is nothing to train, and no prior of clips."""
    metal = Piece("hencky", "von_mises", 2500.0, {"E": 1e5, "nu": 0.3, "yield_stress": 1e3})
    given = components() | {"material": StatedMaterial((metal,)), "trajectory": Stated(boundaries=[HalfSpace()])}
    plan = make_plan(given, prompt("rubber"))
    assert decision(plan, "elastic experts") == "hencky" and decision(plan, "plastic experts") == "von_mises"
    assert decision(plan, "material") == "given" and decision(plan, "walls") == "kept"
    assert not [line for line in plan.lines if line.what in ("video SDS", "gradient", "enumeration")]
    assert plan.components["material"] == StatedMaterial((metal,))
    with pytest.raises(ValueError, match="accuracy"):  # without the price that nobody knows how to count
        make_plan(given, prompt("rubber"), accuracy=1e-6)


def test_sand_keeps_return_mapping_and_two_gradients():
    plan = make_plan(components(), prompt("sand"))
    assert "drucker_prager" in plan.components["material"].plastic
    assert decision(plan, "deformation gradients") == "two"
    assert decision(plan, "return mapping") == "kept"


def test_candidates_come_from_the_prompt_unless_the_configuration_names_them():
    assert make_plan(components(), prompt("jelly")).components["material"].plastic[0] == "identity"
    named = make_plan(components(plastic=("von_mises",)), prompt("jelly"))
    assert named.components["material"].plastic == ("von_mises",)


def test_melting_turns_a_solid_into_a_flow():
    assert "viscoplastic" in make_plan(components(), prompt("pancake", verb="melting")).components["material"].plastic


def test_the_plan_is_obeyed_by_replacing_open_settings_only():
    before = components()
    after = make_plan(before, prompt("rubber", "jelly")).components
    assert after["gaussians"] is before["gaussians"]
    changed = {
        f.name
        for f in dataclasses.fields(FitMaterial)
        if getattr(before["material"], f.name) != getattr(after["material"], f.name)
    }
    assert changed == {"elastic", "plastic"}


@pytest.mark.parametrize(("weight", "expected"), [(0.0, "left out"), (0.1, "literal")])
def test_velocity_loss_of_weight_zero_is_left_out(weight, expected):
    plan = make_plan(components(velocity=Velocity("literal", weight)), prompt("rubber"))
    assert decision(plan, "velocity loss") == expected


def test_an_encoder_that_was_trained_before_is_told(tmp_path):
    """Weights of a file have a line, drawn ones have none."""
    (tmp_path / "encoder.safetensors").touch()
    net = Net(pretrained=str(tmp_path / "encoder.safetensors"))
    plan = make_plan(components(net=net), prompt("rubber"))
    assert decision(plan, "encoder") == "pre-trained"
    assert not any(line.what == "encoder" for line in make_plan(components(), prompt("rubber")).lines)


def test_a_clip_is_blurred_first_only_where_no_scan_came_before():
    """And hypotheses go in one launch where there is a GPU."""
    plan = make_plan(components(), prompt("rubber"))
    assert decision(plan, "low-pass") == "left out" and decision(plan, "hypotheses") == "one by one"
    alone = make_plan(components(stiffness_steps=0), prompt("rubber"))
    assert "0.125, 0.0625 of the picture" in next(line.why for line in alone.lines if line.what == "low-pass")
    assert not any(line.what == "hypotheses" for line in alone.lines)
    on_gpu = loss_lines(plan.components, "cuda:0")
    assert next(line.decision for line in on_gpu if line.what == "hypotheses") == "batched"


def test_frames_of_a_clip_have_no_common_graph_unless_the_prior_cannot_cut_it():
    class Causal(Analytic):
        frames_alone = False

    plan = make_plan(components(), prompt("rubber"))
    assert decision(plan, "graph of the clip") == "left out"
    assert decision(plan, "clip of a step") == "all 12 frames"
    fit = FitMaterial(guidance=Causal(layout="clip"), takes=Takes("window", count=5, views=3, background="white"))
    plan = make_plan(components() | {"material": fit}, prompt("rubber"))
    assert decision(plan, "graph of the clip") == "autoencoder alone"
    line = next(line for line in plan.lines if line.what == "clip of a step")
    assert line.decision == "5 of 12 frames, from a random start"
    assert line.why == "one of 3 cameras, a white background"
    untrained = make_plan(components(steps=0), prompt("rubber"))
    assert not any(line.what == "clip of a step" for line in untrained.lines)


def test_embedded_prior_leaves_diffusion_models_out():
    assert decision(make_plan(components(), prompt("rubber")), "diffusion models") == "left out"


def test_a_shape_prior_is_kept_with_its_weight_and_time_or_left_out():
    class Points(Analytic):
        pass

    assert decision(make_plan(components(), prompt("rubber")), "shape prior") == "left out"
    for stop, says in ((2000, "before step 2000"), (0.25, "in the first 25% of the run")):
        shape = ShapePrior(Points(layout="points"), weight=0.2, stop=stop)
        made = components() | {"gaussians": FitGaussians(guidance=Analytic(layout="views"), shape=shape)}
        plan = make_plan(made, prompt("rubber"))
        line = next(line for line in plan.lines if line.what == "shape prior")
        assert line.decision == "Points" and line.why == f"weight 0.2, {says}"
        assert "Points" in {line.decision for line in plan.lines if line.what == "diffusion model"}


def test_unknown_material_is_a_one_line_error_with_the_nearest_words():
    with pytest.raises(ValueError, match=r"ruber.*rubber"):
        make_plan(components(), prompt("ruber"))


def test_plan_is_printed_and_stored(tmp_path):
    plan = make_plan(components(), prompt("rubber"))
    plan.save(tmp_path / "plan.json")
    lines = json.loads((tmp_path / "plan.json").read_text())
    assert len(lines) == len(plan.lines) == str(plan).count("\n")
    assert all(line["why"] for line in lines)


def test_making_a_plan_draws_no_random_number():
    state = torch.get_rng_state()
    make_plan(components(), prompt("rubber"))
    assert torch.equal(state, torch.get_rng_state())


def omitted(plan):
    return {line.what: line for line in plan.lines if line.decision == "left out"}


def test_every_part_that_a_scene_could_have_has_a_line():
    """The features of the elimination matrix, and those of learning and film."""
    parts = {
        "return mapping", "deformation gradients", "principal decomposition", "mixture weights", "memory",
        "viscous branch", "gravity", "walls", "friction", "moving walls", "drives", "half kick", "mirror walls",
        "sharpening", "retention", "elastic contact", "cubic splines", "double precision", "diagnostics",
        "spherical harmonics", "shape prior", "densification", "interior fill", "video SDS", "gradient",
        "velocity loss", "gathered sums", "enumeration", "diffusion models", "floor", "shadow", "supersampling",
    }  # fmt: skip
    plan = make_plan(components(), prompt("rubber"))
    assert parts <= {line.what for line in plan.lines}
    assert all(line.why for line in plan.lines)


def test_the_scene_decides_which_walls_move():
    assert decision(make_plan(components(), prompt("rubber")), "moving walls") == "left out"
    assert decision(make_plan(components(), prompt("rubber", verb="squashed")), "moving walls") == "kept"


@pytest.mark.parametrize(
    ("what", "changed"),
    [
        ("video SDS", {"material": {"steps": 0}}),
        ("enumeration", {"material": {"stiffness_steps": 0}}),
        ("shadow", {"clip": {"shadow": 0.0}}),
        ("half kick", {"trajectory": {"scheme": Scheme(half_kick=False)}}),
        ("sharpening", {"trajectory": {"scheme": Scheme(sharpen=False, mirror=False)}}),
    ],
)
def test_an_omission_saves_what_the_part_would_cost(what, changed):
    """saved = cost of a run with the part − cost of this one, in seconds and megabytes; never less than nothing."""
    made = components()
    made |= {stage: dataclasses.replace(made[stage], **settings) for stage, settings in changed.items()}
    plan = make_plan(made, prompt("rubber"))
    line = omitted(plan)[what]
    other = predict({**plan.components, **line.would}, prompt("rubber"))
    assert line.seconds == pytest.approx(other.seconds - predict(plan.components, prompt("rubber")).seconds)
    assert line.seconds > 0 and line.megabytes >= 0
    assert "saves" in line.because


def test_costs_of_stages_add_up_and_a_cached_stage_costs_nothing():
    made = make_plan(components(), prompt("rubber")).components
    cost = predict(made, prompt("rubber"))
    names = [Stage(name, None, None) for name in cost.stages]
    lines = stage_lines(names, [], "clip", [], cost)
    (total,) = cost_lines(lines, cost)
    assert total.seconds == pytest.approx(cost.seconds) and total.megabytes == pytest.approx(cost.bytes / 1e6)
    cached = stage_lines(names, ["prompt", "gaussians"], "material", [], cost)
    (rest,) = cost_lines(cached, cost)
    assert rest.seconds == pytest.approx(cost.stages["particles"].seconds + cost.stages["material"].seconds)
    assert [line.decision for line in cached] == ["cached", "cached", "run", "run", "left out", "left out"]


def test_pruned_experts_are_said_with_what_it_changed():
    one = torch.ones(3, 1)
    field = MaterialField(("hencky",), ("von_mises",), one, one, {}, one[:, 0])
    candidates = {"elastic": ("hencky",), "plastic": ("identity", "von_mises")}
    (line,) = pruned_lines(field, candidates, {"pruning_change": 2e-7})
    assert line.what == "plastic experts of the film" and line.decision == "von_mises"
    assert "identity" in line.why and "2.0e-07" in line.why
    assert pruned_lines(field, {"elastic": ("hencky",)}, {}) == []


def test_components_that_nobody_can_count_leave_the_cost_out():
    """A stage of somebody's own: the plan is made without prices, and the log says what is missing."""

    @dataclasses.dataclass(frozen=True)
    class Mine:
        sh_degree: int = 0
        densify: None = None
        guidance: Analytic = Analytic(layout="views")

    plan = make_plan(components() | {"gaussians": Mine()}, prompt("rubber"))
    assert all(line.seconds is None for line in plan.lines)
    assert predicted(plan.components, prompt("rubber")) is None and cost_lines([], None) == []
