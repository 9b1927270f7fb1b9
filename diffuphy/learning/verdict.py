"""What is left of a trained material, and how good it is."""

import dataclasses
import logging
from typing import Any

from diffuphy.learning.appearance import appearance
from diffuphy.learning.case import Case
from diffuphy.learning.descent import Model
from diffuphy.learning.probe import TableClips
from diffuphy.losses.sds import Weight
from diffuphy.material.field import harden, prune, summary
from diffuphy.material.patches import kin
from diffuphy.material.readout import readout
from diffuphy.types import Gaussians, MaterialField, Particles

log = logging.getLogger(__name__)


def film_field(case: Case, model: Model, gaussians: Gaussians, particles: Particles) -> MaterialField:
    """The trained field at all particles: one-hot on experts, so that the film does not depend on the time step, and
    without the experts that nobody uses."""
    points = appearance(gaussians, particles)
    draft = kin(points.x, points.color, case.points.x, case.points.color)
    pruned = prune(harden(model.at(points, draft)))
    for name in pruned.dropped:
        log.info("material: expert %s left out of the film (largest weight %.1e)", name, pruned.peaks[name])
    return pruned.field


def verdict(case: Case, field: MaterialField, weight: Weight) -> dict[str, Any]:
    """Loss of the hardened field of the draft particles; against the embedded prior also its held-out motion, and the
    loss at the table itself: below it one fits discretisation. And what each part is made of, in words."""
    bench, cond, table = case.bench, case.cond, case.table
    pruned = prune(field)
    numbers: dict[str, Any] = {"hardened_loss": cond.score(bench.simulate(pruned.field), weight)}
    if pruned.dropped:
        numbers["pruning_change"] = bench.change(field, pruned.field)
    if isinstance(getattr(cond.guidance, "references", None), TableClips):
        numbers["loss_at_table"] = cond.score(bench.simulate(prune(table).field), weight)
        faster = dataclasses.replace(bench.probe, speed=1.7 * bench.probe.speed, tilt=0.25)
        scene = faster.scene(bench.scene.dx, bench.size)
        mine, theirs = (bench.film(bench.simulate(prune(f).field, scene=scene)) for f in (field, table))
        numbers["held_out_motion"] = float(((mine - theirs) ** 2).mean())
    parts = [str(row) for row in readout(field, case.part, case.names)]
    for words in parts:
        log.info("material: %s", words)
    return numbers | summary(field) | {"parts": parts}
