"""The work and the memory of each stage, counted from its component."""

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import torch

from diffuphy.cost import rollouts
from diffuphy.cost.body import Body
from diffuphy.cost.rollouts import Laws, Work, add, times
from diffuphy.cost.substeps import rounds
from diffuphy.material.encoder import N_FEATURES
from diffuphy.mpm.rollout import MAX_THREADS, THREADED
from diffuphy.mpm.solver import segment_of
from diffuphy.scan import THREADS as SCAN_THREADS
from diffuphy.types import Motion

DRAFT = 0.9
"""Share of the particles it asks for that the probe's coarse copy has [-]: the finest lattice that gives no more."""

SEEN = 0.2
"""Power of 1/E in which clips of a drop are compared by the scan [-]: a body that is much too stiff looks more like
the right one than one that is much too soft."""

STRAIGHT = 0.3
"""Way that a region's stiffness comes, over that of steps which all went the same way [-]."""

PREVIEW = 3, 128
"""Pictures of a preview, and their side [px]."""

SHOT = 3 + 3 + 9
"""Numbers of a particle in a trajectory: x, v, F."""

ROW = 3 + 9
"""Numbers of a particle that a frame is drawn from: x, F."""

SKIN, SPLAT = 24, 60
"""Numbers that the graph of a picture keeps of a Gaussian: for each particle that it follows (x, F, arm, and what they
become), and for itself (covariance, footprint, colour, operands)."""

CACHE_BYTES = 256 * 2**20
"""Memory of the pictures that a library keeps [byte]."""

PER_CELL = 8.0
"""Particles a cell, for a single rollout whose scene is not told."""


@dataclass(frozen=True)
class Counted:
    """What a stage does."""

    work: Work
    """How often each unit is done."""
    sizes: Work = field(default_factory=dict)
    """How much is kept of each kind."""
    spread: Work = field(default_factory=dict)
    """The part of ``work`` that several threads share."""
    lanes: int = 1
    """How many threads at most."""


@dataclass(frozen=True)
class Spaced:
    """Particles as far as the scene of a motion asks for them."""

    spacing: float
    """Mean distance [m]."""


def pictures(views: float, gaussians: float, side: float, *, back: bool = False, degree: int = 0) -> Work:
    """Pictures of ``side`` pixels a side, forward, or forward and backward; coloured by harmonics of a degree."""
    work = {"view": views, "view.gaussian": views * gaussians, "view.pixel": views * side**2}
    if degree:
        work["view.harmonic"] = views * gaussians * (degree + 1) ** 2
    return add(work, {f"back.{unit}": n for unit, n in work.items()}) if back else work


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
    work = {"particles": 1.0, "fill.gaussian": body.gaussians, "fill.cell": cells if sample.fill != "none" else 0.0}
    return Counted(work, {"lattice": 3 * 8 * cells})


def material(components: Mapping[str, Any], motion: Motion, body: Body) -> Counted:
    """The scan, the training, and the clips of prior and verdict."""
    fit, probe = components["material"], components["material"].probe
    n = DRAFT * min(probe.particles, body.particles)
    drop = _Drop(fit, body, n, components["gaussians"].sh_degree)
    regions = min(fit.regions, len(set(motion.materials.values())))
    parts = [_part(r, regions, len(body.kinds)) for r in range(len(body.kinds))]
    work, scans = [{"material": 1.0, "material.particle": body.particles}], []
    if fit.stiffness_steps:
        for laws, log_E in _pairs(fit, body, parts, regions):
            scans.append(drop.clip(fit.scan_frames, laws, body.wave(log_E)))
    own = Laws.of(*_own(body))
    embedded = getattr(fit.guidance, "references", 0) is None
    length = 2 + embedded * 3 if fit.steps or fit.stiffness_steps else 1
    work += [drop.clip(probe.frames, own, body.wave())] * length
    trained = Laws.of(fit.elastic, fit.plastic)
    wave = body.wave(fitted(fit, body, regions, 0.5))
    for frames, count in _curriculum(fit, few := _refined(fit, regions)):
        work.append(times(count, drop.clip(frames, trained, wave, back=True)))
    steps, scores = (
        fit.steps + few * fit.refine_steps,
        _scores(fit.descent()) + few * _scores(fit.descent(fit.refine_steps)),
    )
    work += [times(scores, drop.clip(probe.frames, own, wave))]
    work.append(times(steps, {"train": 1.0, "train.flop": flops(fit.net, n, len(fit.elastic) + len(fit.plastic))}))
    states = drop.bytes(probe.frames, trained, wave) if fit.steps else 0.0
    shown = fit.takes.shown(probe.frames)
    # one frame's graph at a time; of all of them the rows they are drawn from, latents, noise, and gradients of these
    graph = 4 * (body.gaussians * (SKIN * probe.skin + SPLAT) + shown * (3 * ROW * n + 10 * probe.image**2))
    sizes = {"state": states, "graph": graph if fit.steps else 0.0}
    return Counted(add(*work, *scans), sizes, add(*scans), SCAN_THREADS)


def trajectory(components: Mapping[str, Any], motion: Motion, body: Body) -> Counted:
    """One rollout with every particle."""
    play = components["trajectory"]
    scene = play.scene(motion, Spaced(body.spacing(body.particles)))
    fit = components["material"]
    regions = min(fit.regions, len(set(motion.materials.values())))
    steps = rounds(scene, body.wave(fitted(fit, body, regions, 1.0)), body.size / 2)
    elastic, plastic = _own(body)
    laws, nodes = Laws.of(elastic, plastic), rollouts.block(body.extent, scene.dx)
    work = rollouts.forward(body.particles, steps, scene.frames, nodes, laws, play.scheme, double=play.double)
    if play.scheme.contact == "elastic":
        work["contact.particle"] = body.particles * steps
    threads = body.particles >= THREADED
    if threads:  # each waits for the others, and has a copy of the nodes
        work["threads.particle"] = body.particles * steps
    shots = (scene.frames + 1) * body.particles * 4 * SHOT
    own = body.particles * (2 * rollouts.row_bytes(laws, play.double) + rollouts.matter_bytes(laws, play.double))
    sizes = {"state": own + nodes * rollouts.node_bytes(play.scheme, play.double), "shot": shots}
    return Counted(work, sizes, work, MAX_THREADS if threads else 1)


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


class _Drop:
    """The probe with its coarse copy."""

    def __init__(self, fit: Any, body: Body, particles: float, degree: int):
        self.fit, self.body, self.n, self.degree = fit, body, particles, degree
        dx = body.spacing(particles) * fit.probe.particles_per_cell ** (1 / 3)
        self.scene = fit.probe.scene(dx, body.size)
        self.nodes = rollouts.block(body.extent, dx)

    def rounds(self, frames: int, wave: float) -> float:
        """Rounds of so many frames."""
        return rounds(self.scene, wave, 0.0) * frames / self.scene.frames

    def clip(self, frames: int, laws: Laws, wave: float, *, back: bool = False) -> Work:
        """A simulated and filmed drop, with its gradient if asked: then some frames, each drawn a second time."""
        R, scheme, G = self.rounds(frames, wave), self.scene.scheme, self.body.gaussians
        shown, side = self.fit.takes.shown(frames) if back else frames, self.fit.probe.image
        work = [
            rollouts.forward(self.n, R, frames, self.nodes, laws, scheme),
            pictures(shown, G, side, degree=self.degree),
            {"skin": shown * G * self.fit.probe.skin * (1 + 3 * back), "score.pixel": shown * side**2},
        ]
        if back:
            work.append(pictures(shown, G, side, back=True, degree=self.degree))
            work += [rollouts.backward(self.n, R, self.nodes, laws, scheme, kept=True), {"back.frame": frames}]
        return add(*work)

    def bytes(self, frames: int, laws: Laws, wave: float) -> float:
        """Memory of the states that a gradient keeps [byte]."""
        return frames * (self.rounds(frames, wave) / frames + 1) * self.n * rollouts.row_bytes(laws, False)


def _refined(fit: Any, regions: int) -> int:
    """Choices of laws that are refined before one of them is trained."""
    few = min(fit.refine, len(fit.plastic) ** regions) if fit.steps and fit.stiffness_steps and fit.refine_steps else 1
    return few if few > 1 else 0


def _scores(descent: Any) -> int:
    """Scores of a hardened field in a descent."""
    return descent.steps // descent.check + 1 + bool(descent.steps % descent.check) if descent.steps else 0


def _curriculum(fit: Any, few: int) -> Iterable[tuple[int, int]]:
    """Lengths of the training clips [frames], and how many there are of each."""
    descent, frames = fit.descent(), fit.probe.frames
    lengths = [descent.shown(step, frames) for step in range(fit.steps)] + [frames] * few * fit.refine_steps
    return [(frames, lengths.count(frames)) for frames in sorted(set(lengths))]


def grid(fit: Any, regions: int) -> list[float]:
    """Values of log₁₀ E that the scan tries [Pa]."""
    lo, hi = fit.stiffness
    steps = max(2, fit.stiffness_steps // regions)
    return torch.linspace(lo + 0.1, hi - 0.1, steps, dtype=torch.float64).tolist()


def _nearest(value: float, values: Sequence[float]) -> float:
    """The value of log₁₀ E whose clip looks most like that of ``value``."""
    return min(values, key=lambda v: abs(10 ** (-SEEN * v) - 10 ** (-SEEN * value)))


def _part(index: int, regions: int, parts: int) -> int:
    """Region that a part is taken to lie in."""
    return index * regions // parts


def _pairs(fit: Any, body: Body, parts: list[int], regions: int) -> Iterable[tuple[Laws, list[float]]]:
    """Laws and log₁₀ E of each part, for every hypothesis of the scan."""
    elastic = tuple(dict.fromkeys(k.elastic for k in body.kinds))
    for pair in itertools.product(itertools.product(fit.plastic, grid(fit, regions)), repeat=regions):
        plastic = tuple(dict.fromkeys(p for p, _ in pair))
        yield Laws.of(elastic, plastic), [pair[part][1] for part in parts]


def _own(body: Body) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Laws of the table."""
    return tuple(dict.fromkeys(k.elastic for k in body.kinds)), tuple(dict.fromkeys(k.plastic for k in body.kinds))


def fitted(fit: Any, body: Body, regions: int, share: float) -> list[float | None]:
    """log₁₀ E of each part after a share of the training: from where the scan left it towards the table's [Pa].

    A step moves a region by at most (hi − lo)/4 · gain · rate; rates rise over four steps and fall to a tenth.
    """
    lo, hi = fit.stiffness
    rates = sum(min(1.0, (step + 1) / 4) * (1 - 0.9 * step / fit.steps) for step in range(round(share * fit.steps)))
    reach = STRAIGHT * rates * fit.lr_region * fit.net.param_gain * (hi - lo) / 4
    table = [min(hi, max(lo, math.log10(kind.E))) for kind in body.kinds]
    start = [_nearest(t, grid(fit, regions)) if fit.stiffness_steps else fit.start for t in table]
    return [s + math.copysign(min(abs(t - s), reach), t - s) for s, t in zip(start, table, strict=True)]


def flops(net: Any, particles: float, experts: int) -> float:
    """Multiplications of the material network for so many particles."""
    w, tokens, seen = net.width, net.groups, 3 + N_FEATURES
    encoder = tokens * net.group_size * (seen * w + w * w) + net.depth * tokens * (12 * w * w + 2 * tokens * w)
    return encoder + particles * (3 * w * w + w * (experts + 1))


def single(particles: int, substeps: int, laws: Laws, scheme: Any, double: bool) -> tuple[Work, float]:
    """Work and memory of one rollout of a cube of particles, told by its substeps alone [byte]."""
    nodes = ((particles / PER_CELL) ** (1 / 3) + rollouts.AROUND) ** 3
    work = rollouts.forward(particles, substeps, 0.0, nodes, laws, scheme, double=double)
    own = particles * (2 * rollouts.row_bytes(laws, double) + rollouts.matter_bytes(laws, double))
    return work, own + nodes * rollouts.node_bytes(scheme, double)


def gradient_bytes(particles: int, substeps: int, laws: Laws, double: bool) -> float:
    """Memory of the states of one frame in a backward pass that runs it again [byte]."""
    row = rollouts.row_bytes(laws, double)
    part = segment_of(substeps, row * particles)
    return (part + -(-substeps // part)) * row * particles
