"""What rivals share: the case, the loop, the verdict. A rival says what is free, and what it is trained against."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import torch
from torch import Tensor

from diffuphy.learning.case import Case
from diffuphy.learning.descent import Descent, Model, descend
from diffuphy.learning.probe import Probe, table_field
from diffuphy.learning.verdict import film_field, verdict
from diffuphy.losses.sds import Weight
from diffuphy.material.field import harden, take
from diffuphy.material.preset import Preset
from diffuphy.material.presets import field as filled
from diffuphy.material.presets import lookup, melt
from diffuphy.types import Gaussians, Look, MaterialField, Motion, Particles
from diffuphy.workspace import Workspace


@dataclass(frozen=True)
class Rival:
    """Settings of every rival that learns."""

    VERSION: ClassVar[int] = 2
    NAME: ClassVar[str] = ""
    """What it is called in the plan."""

    guidance: Any
    """Video prior, that of ``FitMaterial``."""
    library: Any = None
    """Knows the parts of an object: the embedded prior's clips are made with it. A rival is not told them."""
    probe: Probe = field(default_factory=Probe)
    """The experiment the clip shows."""
    override: dict[str, float | None] = field(default_factory=dict)
    """Parameters to replace in the table, for the prior and for what the rival is told [SI]."""
    elastic: tuple[str, ...] = ()
    """Elastic laws of the result; the plan writes them down (``experts``)."""
    plastic: tuple[str, ...] = ()
    """Plastic laws likewise."""
    steps: int = 40
    """Optimiser steps, as many as ours."""
    weight: Weight = "x0"
    """w(t) of the distillation, and of the score of a field."""
    t_range: tuple[float, float] = (0.02, 0.98)
    """Diffusion times drawn from."""
    keep: Literal["best", "last"] = "last"
    """The field of the last step, as their programs do, or of the best by its score, as ours does."""
    seed: int = 0

    def __post_init__(self) -> None:
        if self.steps < 0:
            raise ValueError(f"steps must be ≥ 0, got {self.steps}")

    def __call__(
        self, look: Look, motion: Motion, gaussians: Gaussians, particles: Particles, *, work: Workspace
    ) -> MaterialField:
        """The material of all particles, one-hot and pruned.

        The summary scores it by the same distillation loss for every method, whatever it was trained against.
        """
        case = Case.make(
            self.probe, self.guidance, self.library, look, motion, gaussians, particles, override=self.override
        )
        model = self.model(case, self.begin(table_field(None, look, motion, case.bench.draft, self.override)))
        state = work.load() or {}
        if self.steps:
            descend(self.trained_against(case), model, self.descent(), work, state=state.get("run"))
        with torch.no_grad():
            work.summary(verdict(case, harden(model()), self.weight))
            return film_field(case, model, gaussians, particles)

    # ------------------------------------------------------------------ what a rival says
    def experts(self, motion: Motion) -> tuple[tuple[str, ...], tuple[str, ...], str]:
        """Elastic and plastic laws that the result may have, and why."""
        raise NotImplementedError

    def begin(self, told: MaterialField) -> MaterialField:
        """The field that training begins with.

        Args:
            told: what a user who names one material for the whole object says of the draft particles.
        """
        raise NotImplementedError

    def model(self, case: Case, start: MaterialField) -> Model:
        """What is trained, from ``begin``."""
        raise NotImplementedError

    def expected(self, motion: Motion, share: float = 1.0) -> MaterialField:
        """What a forecast is made with: a row that is as stiff as the stiffest particle after a share of the steps."""
        given = {name: value for name, value in self.override.items() if value is not None}
        told = filled(dataclasses.replace(whole(motion), **given), torch.zeros(1, dtype=torch.long))
        return self.stiffest(self.begin(told), told, share)

    def stiffest(self, start: MaterialField, told: MaterialField, share: float) -> MaterialField:
        """How stiff a row that begins at ``start`` may be after a share of the steps; what is not learnt stays."""
        return start

    def trained_against(self, case: Case) -> Case:
        """The case as the loop sees it: another loss, or another path of the gradient."""
        return case

    def descent(self) -> Descent:
        """Settings of the loop: a fixed number of steps, weights as they are."""
        return Descent(
            steps=self.steps, weight=self.weight, t_range=self.t_range, gate_time=None, patience=0, keep=self.keep,
            seed=self.seed,
        )  # fmt: skip

    def plan(self) -> list[tuple[str, str, str]]:
        """What, decision and why, for the plan."""
        raise NotImplementedError


def whole(motion: Motion) -> Preset:
    """What the table says of the one material that a user would name for the whole object."""
    found = lookup(motion.materials.get("", next(iter(motion.materials.values()))))
    return melt(found) if motion.verb == "melting" else found


def of_one_law(
    told: MaterialField, elastic: str, plastic: str, theta: Mapping[str, float] | None = None, branches: tuple = ()
) -> MaterialField:
    """All particles on one law, with some parameters set to constants; the others, and densities, are as told."""
    one = torch.ones_like(told.rho)[:, None]
    constants = {name: torch.full_like(told.rho, value) for name, value in (theta or {}).items()}
    return dataclasses.replace(
        told, elastic=(elastic,), plastic=(plastic,), w_e=one, w_p=one, theta=told.theta | constants, branches=branches
    )


class Frozen(torch.nn.Module):
    """A material field whose tensors are buffers, so that they go where a model goes and into its checkpoints."""

    def __init__(self, field: MaterialField):
        super().__init__()
        self.names, self.branches = (field.elastic, field.plastic), field.branches
        for name, value in {"w_e": field.w_e, "w_p": field.w_p, "rho": field.rho}.items():
            self.register_buffer(name, value.detach().clone())
        self.theta = tuple(field.theta)
        for name, value in field.theta.items():
            self.register_buffer(f"theta_{name}", value.detach().clone())

    def forward(self, rows: Tensor | None = None) -> MaterialField:
        """The field, or some of its rows."""
        theta = {name: getattr(self, f"theta_{name}") for name in self.theta}
        whole = MaterialField(*self.names, self.w_e, self.w_p, theta, self.rho, self.branches)
        return whole if rows is None else take(whole, rows)
