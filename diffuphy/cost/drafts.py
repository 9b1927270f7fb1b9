"""The work of the error estimate: the trajectory again, coarsely."""

import dataclasses
from collections.abc import Mapping
from typing import Any

from diffuphy.cost.body import Body
from diffuphy.cost.counted import Counted
from diffuphy.cost.rollouts import add, times
from diffuphy.cost.stages import trajectory
from diffuphy.types import Motion

FULL = 1.25
"""Coarse particles over an eighth of the fine ones: cells at the surface are not full [-]."""


def wanted(components: Mapping[str, Any]) -> bool:
    """Whether a run makes the estimate."""
    return "errors" in components and components["errors"].error == "on"


def errors(components: Mapping[str, Any], motion: Motion, body: Body) -> Counted:
    """Coarse drafts of the trajectory: one, one with half the time step, one in the other precision. Where the scene
    refuses their grid the stage makes no estimate, and nothing is to be paid."""
    estimate, play = components["errors"], components["trajectory"]
    coarse = dataclasses.replace(body, particles=body.particles / 8)  # twice the spacing

    def draft(**settings: Any) -> Counted:
        return trajectory({**components, "trajectory": dataclasses.replace(play, **settings)}, motion, coarse)

    try:
        drafts = [draft()]
    except ValueError:
        return Counted({})
    drafts += [draft(cfl=play.cfl / 2)] * estimate.time + [draft(double=not play.double)] * estimate.precision
    work = times(FULL, add(*(d.work for d in drafts)))
    return Counted(work, drafts[0].sizes, work, max(d.lanes for d in drafts))
