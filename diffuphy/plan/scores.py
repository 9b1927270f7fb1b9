"""What of the evaluation this machine can compute."""

import dataclasses
from collections.abc import Mapping
from typing import Any

from diffuphy.plan.line import Line
from diffuphy.plan.materials import experts
from diffuphy.types import Motion


def scored(components: Mapping[str, Any], motion: Motion) -> dict[str, Any]:
    """The evaluation, made of the run that it scores, without what cannot be computed here."""
    if "evaluate" not in components or components["evaluate"].score == "off":
        return {}
    evaluation = components["evaluate"]
    if evaluation.material is not None:  # it is not the run's own: nobody has chosen its experts yet
        elastic, plastic, _ = experts(evaluation.material, motion)
        material = dataclasses.replace(evaluation.material, elastic=elastic, plastic=plastic)
        evaluation = dataclasses.replace(evaluation, material=material)
    return {"evaluate": evaluation.planned(components)}


def score_lines(components: Mapping[str, Any]) -> list[Line]:
    """Scores that are left out, those of one reason together."""
    if "evaluate" not in components:
        return []
    evaluation = components["evaluate"]
    if evaluation.score == "off":
        on = dataclasses.replace(evaluation, score="on").planned(components)
        return [Line("scores", "left out", "evaluate.score=off", would={"evaluate": on})]
    reasons: dict[str, list[str]] = {}
    for name, why in evaluation.absent.items():
        reasons.setdefault(why, []).append(name)
    film = {"evaluate": dataclasses.replace(evaluation, references=(0,))}  # what one reference would cost
    left = [
        Line(", ".join(names), "left out", why, would=film if "Diff_SSIM" in names else {})
        for why, names in reasons.items()
    ]
    return [Line("scores", "kept", "physical checks, silhouettes and colours need no weights"), *left]
