"""The work and the memory of the material stage, counted from its component."""

import dataclasses
import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import torch

from diffuphy.cost.body import Body
from diffuphy.cost.counted import Counted
from diffuphy.cost.drop import Drop
from diffuphy.cost.rollouts import Laws, add, times
from diffuphy.learning.scan import FEW
from diffuphy.learning.scan import THREADS as SCAN_THREADS
from diffuphy.material.encoder import N_FEATURES
from diffuphy.types import Motion

SEEN = 0.2
"""Power of 1/E in which clips of a drop are compared by the scan [-]: a body that is much too stiff looks more like
the right one than one that is much too soft."""

STRAIGHT = 0.3
"""Way that a region's stiffness comes, over that of steps which all went the same way [-]."""

LOOKS = 3.0
"""Clips that the compass search of the scan makes of a region and a choice of laws: two halvings of one or two."""


def material(components: Mapping[str, Any], motion: Motion, body: Body) -> Counted:
    """The scan, the training, and the clips of prior and verdict."""
    fit, probe = components["material"], components["material"].probe
    table, prior = Laws.of(*own(body)), body.wave()
    body = believed(fit, body)
    drop = Drop(probe, fit.takes, body, components["gaussians"].sh_degree)
    regions = regions_of(fit, motion)
    parts = [_part(r, regions, len(body.kinds)) for r in range(len(body.kinds))]
    work, scans = [{"material": 1.0, "material.particle": body.particles}], []
    if fit.stiffness_steps:
        for laws, log_E in _pairs(fit, body, parts, regions):
            scans.append(drop.clip(fit.scan_frames, laws, body.wave(log_E)))
        searched = min(FEW, len(fit.plastic) ** regions) * LOOKS * regions / len(scans)
        scans.append(times(searched, add(*scans)))
    embedded = getattr(fit.guidance, "references", 0) is None
    length = 2 + embedded * 3 if fit.steps or fit.stiffness_steps else 1
    if fit.pixel_noise is not None:  # its own time step, two a parameter and region, one an elastic law
        length += 1 + 2 * len(fit.learn) * regions + (len(fit.elastic) if len(fit.elastic) > 1 else 0)
    work += [drop.clip(probe.frames, table, prior)] * length
    trained = Laws.of(fit.elastic, fit.plastic)
    wave = body.wave(fitted(fit, body, regions, 0.5))
    few = _refined(fit, regions)
    for frames, count in _curriculum(fit, few):
        work.append(times(count, drop.clip(frames, trained, wave, "full")))
    steps = fit.steps + few * fit.refine_steps
    scores = judged(fit.descent()) + few * judged(fit.descent(fit.refine_steps))
    work += [times(scores, drop.clip(probe.frames, Laws.of(*own(body)), wave))]
    work.append(times(steps, {"train": 1.0, "train.flop": flops(fit.net, drop.n, len(fit.elastic) + len(fit.plastic))}))
    states = drop.states(probe.frames, trained, wave, "full") if fit.steps else 0.0
    sizes = {"state": states, "graph": drop.graph() if fit.steps else 0.0}
    return Counted(add(*work, *scans), sizes, add(*scans), SCAN_THREADS)


def regions_of(fit: Any, motion: Motion) -> int:
    """Regions that may have laws of their own."""
    return min(fit.regions, len(set(motion.materials.values())))


def believed(fit: Any, body: Body) -> Body:
    """The body of whoever gives it other laws than the table's."""
    if not hasattr(fit, "experts"):
        return body
    laws = {
        "elastic": fit.elastic[0], "candidates_elastic": fit.elastic,
        "plastic": fit.plastic[0], "candidates_plastic": fit.plastic,
    }  # fmt: skip
    return dataclasses.replace(body, kinds=tuple(dataclasses.replace(kind, **laws) for kind in body.kinds))


def _refined(fit: Any, regions: int) -> int:
    """Choices of laws that are refined before one of them is trained."""
    few = min(fit.refine, len(fit.plastic) ** regions) if fit.steps and fit.stiffness_steps and fit.refine_steps else 1
    return few if few > 1 else 0


def judged(descent: Any) -> int:
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
