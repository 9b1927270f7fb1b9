"""The work and the memory of each stage, counted from its component."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from diffuphy.cost import learning, rivals, rollouts
from diffuphy.cost.body import Body
from diffuphy.cost.counted import Counted, pictures
from diffuphy.cost.matter import Matter
from diffuphy.cost.rollouts import Laws, Work, add
from diffuphy.cost.substeps import rounds
from diffuphy.mpm.rollout import MAX_THREADS, THREADED
from diffuphy.types import Motion

PREVIEW = 3, 128
"""Pictures of a preview, and their side [px]."""

SHOT = 3 + 3 + 9
"""Numbers of a particle in a trajectory: x, v, F."""

CACHE_BYTES = 256 * 2**20
"""Memory of the pictures that a library keeps [byte]."""

PER_CELL = 8.0
"""Particles a cell, for a single rollout whose scene is not told."""


@dataclass(frozen=True)
class Spaced:
    """Particles as far as the scene of a motion asks for them."""

    spacing: float
    """Mean distance [m]."""


def prompt(components: Mapping[str, Any], motion: Motion, body: Body) -> Counted:
    """The refiner."""
    return Counted({"prompt": 1.0})


def gaussians(components: Mapping[str, Any], motion: Motion, body: Body) -> Counted:
    """Score distillation of pictures: references once a camera, then a picture and its gradient a view and step; or
    a file to read, which takes next to nothing."""
    fit = components["gaussians"]
    if not hasattr(fit, "init"):
        return Counted({}, {"graph": 4 * 60 * body.gaussians})
    side, views, bank = fit.cameras.size, fit.steps * fit.views, fit.cameras.bank
    library = getattr(fit.guidance, "references", None)
    variants, aa = getattr(library, "variants", 1), getattr(library, "aa", 0)
    seen = min(bank, views) * variants * side**2
    shown = fit.steps / fit.preview_every + 1
    work = add(
        {"gaussians": 1.0, "step": fit.steps, "step.gaussian": fit.steps * body.mean_gaussians,
         "ray": seen * aa**2, "ray.primitive": seen * aa**2 * body.crowd, "prior.pixel": views * variants * side**2},
        pictures(views, body.mean_gaussians, side, back=True, degree=fit.sh_degree),
        pictures(shown * PREVIEW[0], body.mean_gaussians, PREVIEW[1]),
    )  # fmt: skip
    kept = min(seen * 4 * 2, CACHE_BYTES)  # references at half precision, with coverage
    return Counted(
        work, {"picture": kept, "graph": 4 * (body.gaussians * 60 + 10 * side**2 * fit.views * (variants + 1))}
    )


def particles(components: Mapping[str, Any], motion: Motion, body: Body) -> Counted:
    """Density on a lattice, and what it encloses."""
    sample = components["particles"]
    cells = math.prod(side / body.spacing(body.particles) + 8 for side in body.extent)
    work = {
        "particles": 1.0,
        "fill.gaussian": body.gaussians,
        "fill.cell": cells if sample.filling is not None else 0.0,
    }
    return Counted(work, {"lattice": 3 * 8 * cells})


def material(components: Mapping[str, Any], motion: Motion, body: Body) -> Counted:
    """Ours, a rival that learns, or a material that is given."""
    fit = components["material"]
    if hasattr(fit, "stiffness_steps"):
        return learning.material(components, motion, body)
    return (rivals.trained if hasattr(fit, "steps") else rivals.given)(components, motion, body)


def trajectory(components: Mapping[str, Any], motion: Motion, body: Body) -> Counted:
    """One rollout with every particle."""
    play = components["trajectory"]
    scene = play.scene(motion, Spaced(min(body.spacing(body.particles), coarsest(play))))
    matter = Matter.of_film(components["material"], motion, body)
    steps, laws, nodes = rounds(scene, matter.wave, body.size / 2), matter.laws, rollouts.block(body.extent, scene.dx)
    work = rollouts.forward(body.particles, steps, scene.frames, nodes, laws, play.scheme, double=play.double)
    if play.scheme.contact == "elastic":
        work["contact.particle"] = body.particles * steps
    threads = body.particles >= THREADED
    if threads:  # each waits for the others, and has a copy of the nodes
        work["threads.particle"] = body.particles * steps
    shots = (scene.frames + 1) * body.particles * 4 * SHOT
    held = body.particles * (2 * rollouts.row_bytes(laws, play.double) + rollouts.matter_bytes(laws, play.double))
    sizes = {"state": held + nodes * rollouts.node_bytes(play.scheme, play.double), "shot": shots}
    return Counted(work, sizes, work, MAX_THREADS if threads else 1)


def coarsest(play: Any) -> float:
    """Largest distance of particles with which a run is played [m]: cells thicker than a third of a wall are refused
    once there are particles; before, their volume is only guessed, and no reason to refuse."""
    thinnest = min((wall.thickness for wall in getattr(play, "boundaries", ())), default=math.inf)
    return (1.0 - 1e-9) * thinnest / 3.0 / play.particles_per_cell ** (1 / 3)


def clip(components: Mapping[str, Any], motion: Motion, body: Body) -> Counted:
    """A picture for each frame, with backdrop and shadow."""
    film, play = components["clip"], components["trajectory"]
    frames = max(1, round(play.seconds * play.fps)) + 1
    side = math.sqrt(film.width * film.height) * film.supersample
    work = pictures(frames, body.gaussians, side, degree=components["gaussians"].sh_degree)
    work |= {"clip": 1.0, "film.pixel": frames * side**2, "skin": frames * body.gaussians * film.neighbours}
    if film.floor and film.shadow > 0:
        work["shadow.particle"] = frames * body.particles
    shots = frames * body.particles * 4 * SHOT
    return Counted(work, {"frame": frames * film.width * film.height * 3 * 4, "shot": shots})


STAGES: dict[str, Callable[[Mapping[str, Any], Motion, Body], Counted]] = {
    "prompt": prompt, "gaussians": gaussians, "particles": particles, "material": material,
    "trajectory": trajectory, "clip": clip,
}  # fmt: skip
"""Stage → what counts its work and its memory."""


def single(particles: int, substeps: int, laws: Laws, scheme: Any, double: bool) -> tuple[Work, float]:
    """Work and memory of one rollout of a cube of particles, told by its substeps alone [byte]."""
    nodes = ((particles / PER_CELL) ** (1 / 3) + rollouts.AROUND) ** 3
    work = rollouts.forward(particles, substeps, 0.0, nodes, laws, scheme, double=double)
    own = particles * (2 * rollouts.row_bytes(laws, double) + rollouts.matter_bytes(laws, double))
    return work, own + nodes * rollouts.node_bytes(scheme, double)
