"""The work and the memory of a material stage that is not ours: a rival that learns, and a material that is given.

Each says by ``expected(motion, share)`` what its material will be after a share of its steps: a row for each kind of
matter, as stiff as the stiffest particle.
"""

from collections.abc import Mapping
from typing import Any

from diffuphy.cost.body import Body
from diffuphy.cost.counted import Counted
from diffuphy.cost.drop import Drop
from diffuphy.cost.learning import flops, judged, own
from diffuphy.cost.matter import Matter
from diffuphy.cost.rollouts import Laws, add, matter_bytes, times
from diffuphy.types import Motion


def trained(components: Mapping[str, Any], motion: Motion, body: Body) -> Counted:
    """Steps of a rival, the scores between them, the clips of prior and verdict."""
    fit, descent = components["material"], components["material"].descent()
    probe, frames = fit.probe, fit.probe.frames
    drop = Drop(probe, descent.takes, body, components["gaussians"].sh_degree)
    half, last = (Matter.of(fit.expected(motion, share)) for share in (0.5, 1.0))
    work = [{"material": 1.0, "material.particle": body.particles}]
    embedded = getattr(fit.guidance, "references", 0) is None
    several = len(fit.elastic) * len(fit.plastic) > 1  # then some are left out, and two drops say what that changes
    work += [drop.clip(frames, last.laws, last.wave)] * (1 + embedded + 2 * several)
    work += [drop.clip(frames, Laws.of(*own(body)), body.wave())] * (3 * embedded)
    work.append(times(judged(descent), drop.clip(frames, half.laws, half.wave)))
    grad = getattr(fit, "gradient", "full")
    work += [drop.clip(descent.shown(step, frames), half.laws, half.wave, grad) for step in range(fit.steps)]
    network = getattr(fit, "network", None)
    laws = len(half.laws.elastic) + len(half.laws.plastic)
    work.append(times(fit.steps, {"train": 1.0, "train.flop": flops(network, drop.n, laws) if network else 0.0}))
    work.append({"score.pixel": getattr(fit, "samples", 0) * frames * probe.image**2})
    sizes = {"state": drop.states(frames, half.laws, half.wave, grad), "graph": drop.graph()}
    return Counted(add(*work), sizes if fit.steps else {})


def given(components: Mapping[str, Any], motion: Motion, body: Body) -> Counted:
    """A material that is only written down; by label each filler looks for its neighbour."""
    fit = components["material"]
    laws = Matter.of(fit.expected(motion)).laws
    pairs = 0.0
    if hasattr(fit, "words"):
        carried = min(body.gaussians, body.particles / 2)
        pairs = carried * (body.particles - carried)
    return Counted({"label.pair": pairs}, {"state": body.particles * matter_bytes(laws, False)})
