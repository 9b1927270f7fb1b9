"""The work of the evaluation: silhouettes, a turntable, and for each reference another film."""

from collections.abc import Mapping
from typing import Any

from diffuphy.cost.body import Body
from diffuphy.cost.counted import Counted, pictures
from diffuphy.cost.rollouts import add, times
from diffuphy.cost.stages import clip, trajectory
from diffuphy.types import Motion


def judges(components: Mapping[str, Any]) -> bool:
    """Whether a run is evaluated."""
    return "evaluate" in components and components["evaluate"].score == "on"


def scores(components: Mapping[str, Any], motion: Motion, body: Body) -> Counted:
    """Work without that of networks, whose prices nobody has measured."""
    evaluation, play = components["evaluate"], components["trajectory"]
    side, frames = evaluation.side, max(1, round(play.seconds * play.fps)) + 1
    prior = evaluation.prior
    rays = evaluation.views * getattr(prior, "variants", 0) * (side * getattr(prior, "aa", 0)) ** 2
    filmed = clip(components, motion, body)
    work = add(
        pictures(frames + evaluation.views, body.gaussians, side),
        {"skin": frames * body.gaussians, "ray": rays, "ray.primitive": rays * body.crowd},
    )
    if not evaluation.references:
        return Counted(work, filmed.sizes)
    again = trajectory(components, motion, body)
    n = len(evaluation.references)
    sizes = {k: 2 * v for k, v in (again.sizes | filmed.sizes).items()}
    return Counted(add(work, times(n, add(again.work, filmed.work))), sizes, times(n, again.spread), again.lanes)
