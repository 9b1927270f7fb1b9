"""How wrong a film may be, and whether the run estimates how wrong it is."""

import dataclasses
from collections.abc import Mapping
from typing import Any

from diffuphy.accuracy import Unreachable, choose
from diffuphy.cost import predict
from diffuphy.plan.line import Line
from diffuphy.plan.materials import experts
from diffuphy.types import Prompt


def refined(
    components: dict[str, Any], prompt: Prompt, accuracy: float | None, device: str = "cpu"
) -> tuple[dict[str, Any], list[Line]]:
    """Grid, splines and precision for an accuracy that was asked for; None leaves everything as it is.

    Raises:
        ValueError: an accuracy that no measured curve promises, with the best there is and its price.
    """
    if accuracy is None:
        return components, []
    try:
        choice = choose(accuracy, prompt.motion)
    except Unreachable as beyond:
        elastic, plastic, _ = experts(components["material"], prompt.motion)
        material = dataclasses.replace(components["material"], elastic=elastic, plastic=plastic)
        try:
            cost = predict(beyond.best.applied(components) | {"material": material}, prompt, device=device)
        except AttributeError:  # a component whose work nobody knows how to count
            raise ValueError(str(beyond)) from None
        raise ValueError(
            f"{beyond}, in about {cost.seconds / 60:.0f} min and {cost.bytes / 1e9:.1f} GB of memory"
        ) from None
    why = f"an error of {choice.error:.1%} of the size, by the curves of {', '.join(choice.families)} matter"
    return choice.applied(components), [Line(f"accuracy {accuracy:g}", str(choice), why)]


def judged(components: Mapping[str, Any]) -> dict[str, Any]:
    """The error estimate, of the scene and the camera of the run that it judges."""
    if "errors" not in components:
        return {}
    estimate = components["errors"]
    scene, film = estimate.scene or components["trajectory"], estimate.film or components["clip"]
    return {"errors": dataclasses.replace(estimate, scene=scene, film=film)}


def error_lines(components: Mapping[str, Any]) -> list[Line]:
    if "errors" not in components:
        return []
    e = components["errors"]
    if e.error == "off":
        would = {"errors": dataclasses.replace(e, error="on")}
        return [Line("error estimate", "left out", "report.error=off", would=would)]
    drafts = ["twice the grid spacing", *["half the time step"] * e.time, *["the other precision"] * e.precision]
    return [Line("error estimate", "kept", f"coarse drafts with {', '.join(drafts)}")]
