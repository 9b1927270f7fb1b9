"""The training loop of a material: what every model is trained by.

    field → drop → clip → score of the prior → gradient → step;  every few steps: harden, score, keep the best

The model may be anything that has parameters and means a material field: the network, a field of free particles, a
group-wise choice. Nothing here knows which.
"""

import dataclasses
import logging
import math
from dataclasses import dataclass, field
from typing import Any, Literal

import torch
from torch import Tensor, nn

from diffuphy.learning.case import Case
from diffuphy.losses.estimators import SDS, Estimator
from diffuphy.losses.sds import Weight
from diffuphy.losses.takes import Takes
from diffuphy.losses.velocity import Velocity
from diffuphy.material.encoder import Points
from diffuphy.material.field import harden, prune, summary
from diffuphy.mpm import FrameReport
from diffuphy.render import contact_sheet
from diffuphy.types import MaterialField, SimulationDiverged
from diffuphy.workspace import Workspace

log = logging.getLogger(__name__)


class Model(nn.Module):
    """What is trained. Its state dict is all that a checkpoint needs of it."""

    def forward(self) -> MaterialField:
        """The field of the draft particles, differentiable in the parameters."""
        raise NotImplementedError

    def at(self, points: Points, draft: Tensor) -> MaterialField:
        """The field of any particles of the object.

        Args:
            points: what they look like.
            draft: the draft particle that each belongs to (``patches.kin``), shape (M,), int64.
        """
        raise NotImplementedError

    def groups(self) -> list[dict[str, Any]]:
        """Parameters by learning rate: ``[{"params": [...], "lr": 2e-3}, ...]``."""
        raise NotImplementedError

    def optimiser(self) -> torch.optim.Optimizer:
        """What moves the parameters."""
        return torch.optim.Adam(self.groups(), betas=(0.9, 0.95))

    def penalty(self, field: MaterialField) -> Tensor | None:
        """What is added to the loss of a field besides the clip's; None adds nothing."""
        return None


@dataclass(frozen=True)
class Descent:
    """Settings of the loop."""

    steps: int = 40
    """Optimiser steps at most."""
    takes: Takes = field(default_factory=Takes)
    """What each step looks at."""
    estimator: Estimator = field(default_factory=SDS)
    """What is taken from the prior's answer."""
    weight: Weight = "x0"
    """w(t) of the distillation."""
    t_range: tuple[float, float] = (0.02, 0.98)
    """Diffusion times drawn from."""
    velocity: Velocity | None = None
    """Velocity loss; None or weight 0 leaves it out."""
    gate_time: float | None = 1 / 30
    """Reference time of rate-form plastic gates [s]; None uses the weights as they are."""
    curriculum: tuple[int, ...] = ()
    """Frames of the clip in equal parts of the run, the last part being all; () is all from the start."""
    blur: tuple[float, ...] = ()
    """Low-pass of the clip likewise, the last part being sharp [shares of the picture's height]."""
    check: int = 5
    """Steps from one score of the hardened field to the next; the best so far is what remains in the end."""
    patience: int = 3
    """Scores in a row, at the full length of the clip, that may bring less than ``gain`` before the run ends; 0 never
    ends it early."""
    gain: float = 0.01
    """Least relative fall of the score that counts as progress [-]."""
    clip: float = 1.0
    """Largest norm of the gradient of a step."""
    keep: Literal["best", "last"] = "best"
    """Which of the fields that were scored remains in the end."""
    seed: int = 0
    """Of noise, diffusion times and takes."""

    def __post_init__(self) -> None:
        if self.steps < 0 or self.check < 1 or self.patience < 0:
            raise ValueError(
                "descent.steps and patience must be ≥ 0 and check ≥ 1, "
                f"got {self.steps}, {self.patience} and {self.check}"
            )

    def shown(self, step: int, total: int) -> int:
        """Frames shown at a step, of ``total``: short clips first, when the start may be far away."""
        return min(total, self._stage(self.curriculum or (total,), step))

    def blurred(self, step: int) -> float:
        """Low-pass at a step: where things are first, their outlines in the end."""
        return self._stage((*self.blur, 0.0), step)

    def _stage(self, stages: tuple[Any, ...], step: int) -> Any:
        return stages[min(len(stages) - 1, step * (len(stages) + 1) // max(self.steps, 1))]

    def rate(self, step: int) -> float:
        """Factor of the learning rates: four steps up, then linearly down to a tenth."""
        return min(1.0, (step + 1) / 4) * (1 - 0.9 * step / self.steps)


@dataclass
class Run:
    """How far a descent has come: all of it goes into a checkpoint."""

    step: int = 0
    """Steps done."""
    score: float = math.inf
    """Clip loss of the best hardened field so far."""
    at: int = 0
    """Step of the best."""
    stale: int = 0
    """Scores since the last progress."""
    bar: float = math.inf
    """Score that the next progress is measured from."""
    why: str = "all steps were taken"
    """Why it ended."""
    best: dict[str, Tensor] = field(default_factory=dict)
    """State dict of the model at its best."""


def descend(
    case: Case,
    model: Model,
    settings: Descent,
    work: Workspace,
    *,
    state: dict[str, Any] | None = None,
    around: dict[str, Any] | None = None,
    first: int = 0,
) -> Run:
    """Train a model by video score distillation; it is left at the best of the fields that were scored, unless the
    settings keep the last.

    A gradient that is not finite, or a material that cannot be simulated, ends the run with the best so far; where no
    field had a score yet it is an error. Killed between two steps and continued from its checkpoint, a run ends in the
    same bits.

    Args:
        state: what a checkpoint of this run holds under ``run``.
        around: what a checkpoint holds besides.
        first: number of the first step in the log.

    Raises:
        FloatingPointError: a gradient is not finite, and no field had a score; the message names the parameter.
        SimulationDiverged: the start itself cannot be simulated.
    """
    run, trainer = Run(), _Trainer(case, model, settings)
    if state is not None:
        run = trainer.restore(state)
    with work.bar(settings.steps, "material: train", initial=run.step) as bar:
        while run.step < settings.steps:
            if run.step % settings.check == 0 and not trainer.judge(run, work):
                break
            try:
                scalars = trainer.step(run.step, work)
            except (FloatingPointError, SimulationDiverged) as trouble:
                if math.isinf(run.score):
                    raise
                run.why = f"step {run.step}: {trouble}"
                log.warning("material: training ends with the best so far, of step %d: %s", run.at, run.why)
                break
            work.log(first + run.step, **scalars)
            run.step += 1
            bar.update()
            if work.due():
                work.save((around or {}) | {"run": trainer.state(run)})
        else:
            trainer.judge(run, work)
    if run.best and (settings.keep == "best" or run.step < settings.steps):  # a run that ended early has no last one
        model.load_state_dict(run.best)
    log.info("material: %d steps, best score %.3g at step %d; %s", run.step, run.score, run.at, run.why)
    return run


class _Trainer:
    """One step, one score, and what they need from one to the next."""

    def __init__(self, case: Case, model: Model, settings: Descent):
        self.case, self.model, self.settings = case, model, settings
        self.total = case.bench.probe.frames
        self.optimiser = model.optimiser()
        self.rates = [group["lr"] for group in self.optimiser.param_groups]
        self.generator = torch.Generator().manual_seed(settings.seed)
        velocity = settings.velocity
        self.velocity = velocity if velocity is not None and velocity.weight else None
        self.target = case.cond.target() if self.velocity is not None and self.velocity.form == "image" else None
        self.gather = (self.velocity.needs,) if self.velocity is not None and self.velocity.needs else ()

    def step(self, number: int, work: Workspace) -> dict[str, float]:
        """One step of the optimiser.

        Raises:
            FloatingPointError: a gradient is not finite; no parameter was moved.
        """
        s, case = self.settings, self.case
        for group, rate in zip(self.optimiser.param_groups, self.rates, strict=True):
            group["lr"] = rate * s.rate(number)
        take = s.takes(number, s.shown(number, self.total), self.generator)
        take = dataclasses.replace(take, blur=s.blurred(number))
        field = self.model()
        reports: list[FrameReport] = []
        to, gates = take.frames[-1], s.gate_time
        trajectory = case.bench.simulate(field, to, gate_time=gates, report=reports, gather=self.gather)
        t = s.t_range[0] + (s.t_range[1] - s.t_range[0]) * float(torch.rand((), generator=self.generator))
        loss = distilled = case.cond.distil(
            trajectory, take, t=t, generator=self.generator, weight=s.weight, estimator=s.estimator
        )
        if self.velocity is not None:
            loss = loss + case.bench.velocity_loss(self.velocity, trajectory, field, reports, self.target)
        if (penalty := self.model.penalty(field)) is not None:
            loss = loss + penalty
        self.optimiser.zero_grad()
        loss.backward()
        self._check()
        norm = torch.nn.utils.clip_grad_norm_([p for g in self.optimiser.param_groups for p in g["params"]], s.clip)
        self.optimiser.step()
        work.show("material", number + 1, s.steps, lambda: (case.bench.skin, trajectory))
        return {"loss": distilled.item(), "total": loss.item(), "grad": norm.item(), **summary(field)}

    def _check(self) -> None:
        bad = [
            f"{name} ({int((~p.grad.isfinite()).sum())} of {p.numel()} numbers)"
            for name, p in self.model.named_parameters()
            if p.grad is not None and not bool(p.grad.isfinite().all())
        ]
        if bad:
            what = "is not finite; narrow material.stiffness or shorten the clip"
            raise FloatingPointError(f"the gradient of {', '.join(bad)} {what}")

    def judge(self, run: Run, work: Workspace) -> bool:
        """Score the hardened field, keep it if it is the best; whether to go on: scores count against the patience of
        the run once the whole clip is shown, and sharp."""
        s = self.settings
        with torch.no_grad():
            field = prune(harden(self.model())).field
            try:
                drop = self.case.bench.simulate(field)
                score = self.case.cond.score(drop, s.weight)
            except SimulationDiverged:
                if math.isinf(run.score):
                    raise
                score = math.inf
            else:
                self._preview(drop, run.step, work)
        if score < run.score:
            run.score, run.at, run.best = score, run.step, _copied(self.model.state_dict())
        early = s.shown(run.step, self.total) < self.total or s.blurred(run.step) > 0
        if early or run.score < (1 - s.gain) * run.bar:
            run.bar, run.stale = run.score, 0
        else:
            run.stale += 1
        if s.patience and run.stale >= s.patience:
            run.why = f"the last {run.stale} scores brought less than {s.gain:.0%}"
            return False
        return True

    def _preview(self, drop: Any, step: int, work: Workspace) -> None:
        """Two rows: what the prior has in mind, and what the drop looks like now."""
        if work.directory is None:
            return
        clips = (self.case.cond.target(), self.case.bench.film(drop))
        rows = [contact_sheet(clip, columns=6, frames=6) for clip in clips if clip is not None]
        work.image(f"material-{step:05d}", torch.cat(rows))

    def state(self, run: Run) -> dict[str, Any]:
        """All that decides how the run goes on."""
        optimiser, rng = self.optimiser.state_dict(), self.generator.get_state()
        return vars(run) | {"model": self.model.state_dict(), "optimiser": optimiser, "rng": rng}

    def restore(self, state: dict[str, Any]) -> Run:
        """Go on from there."""
        self.model.load_state_dict(state["model"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.generator.set_state(state["rng"])
        return Run(**{f.name: state[f.name] for f in dataclasses.fields(Run)})


def _copied(state: dict[str, Tensor]) -> dict[str, Tensor]:
    return {name: value.detach().clone() for name, value in state.items()}
