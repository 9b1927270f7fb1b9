"""What this scene needs, what is left out, and why; decided before anything heavy starts.

A plan takes the composed components and the refined prompt, replaces every setting that was left open (``None``) by
what the scene needs, and says so line by line. The pipeline then runs the components *of the plan*: it is obeyed by
construction. What each part takes, and what leaving one out saves, is predicted (``cost``).
"""

import dataclasses
import logging
from collections.abc import Collection, Mapping, Sequence
from typing import Any

from diffuphy.artifact import Stage
from diffuphy.cost import Cost, predict
from diffuphy.plan.accuracy import error_lines, judged, refined
from diffuphy.plan.learning import loss_lines, model_lines
from diffuphy.plan.line import Line, Plan
from diffuphy.plan.materials import experts, mixture_lines, pruned_lines
from diffuphy.plan.pictures import film_lines, object_lines, sized
from diffuphy.plan.scenery import scene_lines, scheme_lines
from diffuphy.plan.scores import score_lines, scored
from diffuphy.plan.wording import prompt_lines
from diffuphy.types import Prompt

__all__ = ["Line", "Plan", "cost_lines", "make_plan", "predicted", "pruned_lines", "stage_lines"]

log = logging.getLogger(__name__)


def make_plan(
    components: dict[str, Any], prompt: Prompt, *, accuracy: float | None = None, device: str = "cpu"
) -> Plan:
    """Resolve the open settings of ``components`` for ``prompt``.

    Args:
        components: one component a stage, by stage name; see ``pipeline.stages``.
        accuracy: error that the film may have, over the size of the object; None keeps the grid of the components.
        device: where the run will be; costs depend on it.

    Raises:
        ValueError: an accuracy that no grid promises.
    """
    components, chosen = refined(components, prompt, accuracy, device)
    elastic, plastic, why = experts(components["material"], prompt.motion)
    material = dataclasses.replace(components["material"], elastic=elastic, plastic=plastic)
    resolved = components | {"material": material} | judged(components) | sized(components)
    resolved |= scored(resolved, prompt.motion)
    lines = [
        *prompt_lines(prompt),
        *chosen,
        Line("elastic experts", ", ".join(elastic), why),
        Line("plastic experts", ", ".join(plastic), why),
        *mixture_lines(resolved),
        *scene_lines(resolved, prompt.motion),
        *scheme_lines(resolved),
        *object_lines(resolved),
        *loss_lines(resolved, device),
        *model_lines(resolved),
        *film_lines(resolved),
        *error_lines(resolved),
        *score_lines(resolved),
    ]
    return Plan(resolved, tuple(priced(lines, resolved, prompt, device)))


def priced(lines: Sequence[Line], components: Mapping[str, Any], prompt: Prompt, device: str) -> list[Line]:
    """The same lines, with what each omission saves: the cost of a run that had the part, less that of this one."""
    now = predicted(components, prompt, device=device)

    def saved(line: Line) -> Line:
        if not line.would or now is None:
            return line
        other = predict({**components, **line.would}, prompt, device=device)
        more = [max(0.0, a - b) for a, b in ((other.seconds, now.seconds), (other.bytes / 1e6, now.bytes / 1e6))]
        return dataclasses.replace(line, seconds=more[0], megabytes=more[1])

    return [saved(line) for line in lines]


def predicted(components: Mapping[str, Any], prompt: Prompt, **known: Any) -> Cost | None:
    """What a run will cost (``cost.predict``); None for components of somebody else's making, whose work nobody knows
    how to count: the log names what they lack."""
    try:
        return predict(components, prompt, **known)
    except AttributeError as missing:
        log.info("the cost of this run is not predicted: %s", missing)
        return None


def stage_lines(
    stages: list[Stage], cached: Collection[str], until: str, force: list[str], cost: Cost | None = None
) -> list[Line]:
    """Which stages run. Keys are content-addressed, so what follows a stage that must run is known only afterwards."""
    lines = []
    known, last = True, [s.name for s in stages].index(until)
    for k, stage in enumerate(stages):
        price = cost.stages.get(stage.name) if cost is not None else None
        numbers = {} if price is None else {"seconds": price.seconds, "megabytes": price.bytes / 1e6}
        if k > last:
            lines.append(Line(f"stage {stage.name}", "left out", f"until={until}", seconds=numbers.get("seconds")))
            continue
        if stage.name in cached and stage.name not in force:
            lines.append(Line(f"stage {stage.name}", "cached", "same settings, same inputs"))
            continue
        if stage.name in force:
            why = "forced"
        else:
            why = "not in the store" if known else "unless its inputs come out unchanged"
        lines.append(Line(f"stage {stage.name}", "run", why, **numbers))
        known = False
    return lines


def cost_lines(lines: Sequence[Line], cost: Cost | None) -> list[Line]:
    """The whole of what the stages of ``stage_lines`` that run will take; a cached one takes nothing."""
    if cost is None:
        return []
    runs = [line for line in lines if line.decision == "run"]
    seconds = sum(line.seconds or 0.0 for line in runs)
    megabytes = max((line.megabytes or 0.0 for line in runs), default=0.0)
    return [Line("cost", "predicted", f"prices from {cost.machine}", seconds, megabytes)]
