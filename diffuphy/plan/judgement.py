"""How right the film is to be, and who says how right it is."""

import dataclasses
from typing import Any

from diffuphy.accuracy import choose
from diffuphy.plan.line import Line
from diffuphy.types import Prompt


def refined(components: dict[str, Any], prompt: Prompt, accuracy: float | None) -> tuple[dict[str, Any], list[Line]]:
    """Grid, spline and precision for an accuracy that was asked for."""
    if accuracy is None:
        return components, []
    choice = choose(accuracy, prompt.motion)
    why = f"an error of {choice.error:.1%} of the size, from the curves for {', '.join(choice.families)} matter"
    return choice.applied(components), [Line(f"accuracy {accuracy:g}", str(choice), why)]


def judged(components: dict[str, Any]) -> dict[str, Any]:
    """The error estimate, made of the run that it judges."""
    if "errors" not in components:
        return {}
    estimate = components["errors"]
    scene, film = estimate.scene or components["trajectory"], estimate.film or components["clip"]
    return {"errors": dataclasses.replace(estimate, scene=scene, film=film)}


def error_lines(components: dict[str, Any]) -> list[Line]:
    """The error estimate and its drafts."""
    if "errors" not in components:
        return []
    e = components["errors"]
    if e.error == "off":
        return [Line("error estimate", "left out", "report.error=off")]
    drafts = ["twice the grid spacing", *["half the time step"] * e.time, *["the other precision"] * e.precision]
    return [Line("error estimate", "kept", f"coarse drafts with {', '.join(drafts)}")]
