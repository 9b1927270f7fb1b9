"""The work and the memory of the material stage, counted from its component."""

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import torch

from diffuphy.cost import rollouts
from diffuphy.cost.body import Body
from diffuphy.cost.counted import Counted, pictures
from diffuphy.cost.rollouts import Laws, Work, add, times
from diffuphy.cost.substeps import rounds
from diffuphy.learning.scan import FEW
from diffuphy.learning.scan import THREADS as SCAN_THREADS
from diffuphy.material.encoder import N_FEATURES
from diffuphy.types import Motion

DRAFT = 0.9
"""Share of the particles it asks for that the probe's coarse copy has [-]: the finest lattice that gives no more."""

SEEN = 0.2
"""Power of 1/E in which clips of a drop are compared by the scan [-]: a body that is much too stiff looks more like
the right one than one that is much too soft."""

STRAIGHT = 0.3
"""Way that a region's stiffness comes, over that of steps which all went the same way [-]."""

LOOKS = 3.0
"""Clips that the compass search of the scan makes of a region and a choice of laws: two halvings of one or two."""

ROW = 3 + 9
"""Numbers of a particle that a frame is drawn from: x, F."""

SKIN, SPLAT = 24, 60
"""Numbers that the graph of a picture keeps of a Gaussian: for each particle that it follows (x, F, arm, and what they
become), and for itself (covariance, footprint, colour, operands)."""


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
        searched = min(FEW, len(fit.plastic) ** regions) * LOOKS * regions / len(scans)
        scans.append(times(searched, add(*scans)))
    table = Laws.of(*own(body))
    embedded = getattr(fit.guidance, "references", 0) is None
    length = 2 + embedded * 3 if fit.steps or fit.stiffness_steps else 1
    if fit.pixel_noise is not None:  # its own time step, two a parameter and region, one an elastic law
        length += 1 + 2 * len(fit.learn) * regions + (len(fit.elastic) if len(fit.elastic) > 1 else 0)
    work += [drop.clip(probe.frames, table, body.wave())] * length
    trained = Laws.of(fit.elastic, fit.plastic)
    wave = body.wave(fitted(fit, body, regions, 0.5))
    for frames, count in _curriculum(fit, few := _refined(fit, regions)):
        work.append(times(count, drop.clip(frames, trained, wave, back=True)))
    steps, scores = (
        fit.steps + few * fit.refine_steps,
        _scores(fit.descent()) + few * _scores(fit.descent(fit.refine_steps)),
    )
    work += [times(scores, drop.clip(probe.frames, table, wave))]
    work.append(times(steps, {"train": 1.0, "train.flop": flops(fit.net, n, len(fit.elastic) + len(fit.plastic))}))
    states = drop.bytes(probe.frames, trained, wave) if fit.steps else 0.0
    shown = fit.takes.shown(probe.frames)
    # one frame's graph at a time; of all of them the rows they are drawn from, latents, noise, and gradients of these
    graph = 4 * (body.gaussians * (SKIN * probe.skin + SPLAT) + shown * (3 * ROW * n + 10 * probe.image**2))
    sizes = {"state": states, "graph": graph if fit.steps else 0.0}
    return Counted(add(*work, *scans), sizes, add(*scans), SCAN_THREADS)


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


def own(body: Body) -> tuple[tuple[str, ...], tuple[str, ...]]:
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
