"""The plan names what a scene needs, leaves the rest out, and is obeyed."""

import dataclasses
import json

import pytest
import torch

from diffuphy.fit_material import FitMaterial
from diffuphy.losses.guidance.analytic import Analytic
from diffuphy.losses.velocity import Velocity
from diffuphy.mpm.sample import Sample
from diffuphy.mpm.trajectory import Simulate
from diffuphy.plan import make_plan
from diffuphy.render import Film
from diffuphy.text2gs.fit import FitGaussians
from diffuphy.text2gs.refine.rules import Rules
from diffuphy.types import Look, Motion, Prompt


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


def test_embedded_prior_leaves_diffusion_models_out():
    assert decision(make_plan(components(), prompt("rubber")), "diffusion models") == "left out"


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
