"""Parameters for which a law has no meaning are refused by name. The ranges of ``Param`` are narrower: those are what a
fit searches. What is allowed and seldom meant is said."""

import logging
import math
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from diffuphy.mpm.scene import Scene
from diffuphy.types import MaterialField

log = logging.getLogger(__name__)

OPEN = {"E": (0.0, math.inf), "nu": (-1.0, 0.5), "bulk_modulus": (0.0, math.inf), "relaxation_time": (0.0, math.inf)}
"""Parameters that lie strictly between two numbers."""

HALF_OPEN = {
    "yield_stress": (0.0, math.inf), "friction_angle": (0.0, 90.0), "cohesion": (0.0, math.inf),
    "viscosity": (0.0, math.inf), "consistency": (0.0, math.inf), "E_N": (0.0, math.inf),
    "tension_ratio": (0.0, math.inf), "preconsolidation": (0.0, math.inf), "compaction": (0.0, math.inf),
}  # fmt: skip
"""Parameters that may be as small as the first and must be less than the second."""

REMEDY = {
    "nu": "take at most 0.499, and for a liquid the 'fluid' law",
    "E": "for a liquid take the 'fluid' law",
    "friction_angle": "degrees, of sand about 35",
}
"""What else to do."""


def check_limits(field: MaterialField, params: tuple[str, ...]) -> None:
    """Refuse parameters out of the range in which their law is defined; those that no law of the mixture reads may be
    anything.

    Raises:
        ValueError: naming parameter, first particle, value and range.
    """
    for name in params:
        low, high = {**OPEN, **HALF_OPEN}.get(name, (-math.inf, math.inf))
        t = field.theta[name].detach() if name in field.theta else None
        if t is None:
            continue
        bad = ~((t > low if name in OPEN else t >= low) & (t < high))
        if bool(bad.any()):
            p = int(bad.nonzero()[0])
            bracket = "(" if name in OPEN else "["
            advice = f"; {REMEDY[name]}" if name in REMEDY else ""
            raise ValueError(
                f"{name} of particle {p} is {float(t[p]):g}; it must be in {bracket}{low:g}, {high:g}){advice}"
            )


def check_velocity(velocity: Tensor | None, n: int) -> None:
    """Refuse an added velocity that is no velocity of ``n`` particles.

    Raises:
        ValueError: naming its shape, or the first particle for which it is not finite.
    """
    if velocity is None:
        return
    if tuple(velocity.shape) not in ((3,), (1, 3), (n, 3)):
        raise ValueError(f"velocity must have shape (3,) or ({n}, 3), got {tuple(velocity.shape)}")
    finite = torch.isfinite(velocity.detach())
    if not bool(finite.all()):
        rows = (~finite).reshape(-1, 3).any(1).nonzero()[:, 0]
        who = f" of particle {int(rows[0])}" if velocity.dim() == 2 else ""
        raise ValueError(f"velocity{who} is {velocity.reshape(-1, 3)[rows[0]].tolist()}; it must be finite")


RESTFUL = 3.0
"""Cells across a body that lies still on an elastic wall: 1 and 2 do not, 3 do for 1e5 substeps (``benchmarks
stability``)."""


def say_small(scene: Scene, x: Tensor, vol: Tensor) -> None:
    """Warn of a body that is too thin for elastic walls: it would not come to rest on them."""
    if scene.scheme.contact != "elastic" or not scene.boundaries:
        return
    across = (x.detach().amax(0) - x.detach().amin(0) + float(vol.detach().median()) ** (1 / 3)) / scene.dx
    if float(across.min()) < RESTFUL - 0.1:  # what lies askew in the lattice
        log.warning(
            "the body is %.1f cells thick along %s; on elastic walls one of less than %g does not come to rest: take "
            "a dx of at most %.3g m, or contact='rigid' (docs/numerics/stability.md)",
            float(across.min()), "xyz"[int(across.argmin())], RESTFUL, scene.dx * float(across.min()) / RESTFUL,
        )  # fmt: skip


def check_options(
    scene: Scene,
    gather: Sequence[str],
    diagnose: bool,
    report: Any,
    segment: int | None,
    window: int | None,
    scenes: int,
    particles: int,
    threads: int | None,
) -> None:
    """Refuse options of ``rollout.simulate`` that contradict each other.

    Raises:
        ValueError: naming the option and what to give instead.
    """
    if gather and report is None:
        raise ValueError(f"gather = {tuple(gather)} fills the reports of frames; give a list as report")
    if diagnose and report is None:
        raise ValueError("diagnose fills the reports of frames; give a list as report")
    for name, value, of in (("segment", segment, "substep"), ("window", window, "frame"), ("threads", threads, "")):
        if value is not None and value < 1:
            raise ValueError(f"{name} must be at least 1{' ' * bool(of)}{of}, got {value}")
    if scenes < 1 or particles % scenes:
        raise ValueError(f"scenes must divide the number of particles, got scenes = {scenes} and {particles} particles")
    if scenes > 1 and (gather or diagnose):
        raise ValueError("gather and diagnose sum over one scene; run the scenes of a batch one by one for that")
    if scenes > 1 and scene.bounds is not None:
        raise ValueError("a batch of scenes has no bounds: its scenes must keep the same particles; set bounds to None")


def check_steering(steer: Any, grad: bool, scenes: int) -> None:
    """Refuse to steer what cannot be.

    Raises:
        ValueError: with gradients, since a backward pass runs frames again with the drives they had; or in a batch.
    """
    if steer is not None and (grad or scenes > 1):
        raise ValueError("steer changes drives while a simulation runs, which grad = True and scenes > 1 do not allow")
