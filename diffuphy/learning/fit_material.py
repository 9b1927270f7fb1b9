"""The stage that finds out what the object is made of.

    probe the object → scan experts × stiffness, forward only → refine the best few → train the best of these → harden

The scan finds the basins, the gradient their bottoms. The gradient runs the whole way back: pixels → Gaussians →
trajectory → MPM adjoint → mixture → decoder → encoder. DiffuPhyGS (2025), §3.3–3.4. Recipe and
failures: docs/learning.md.
"""

import dataclasses
import logging
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, get_args

import torch

from diffuphy.learning.case import Case, Segment, parameters
from diffuphy.learning.descent import Descent, descend
from diffuphy.learning.identifiability import RHO_UNSEEN, certainty
from diffuphy.learning.probe import Probe
from diffuphy.learning.regional import RegionalNet
from diffuphy.learning.scan import region_values, scan
from diffuphy.learning.verdict import film_field, verdict
from diffuphy.losses.estimators import SDS, Estimator
from diffuphy.losses.sds import Weight
from diffuphy.losses.takes import Takes
from diffuphy.losses.velocity import Velocity
from diffuphy.material import Param
from diffuphy.material.decoder import inside
from diffuphy.material.field import Hypothesis, harden, prune, warm_start
from diffuphy.material.net import Net
from diffuphy.material.presets import lookup
from diffuphy.types import Gaussians, Look, MaterialField, Motion, Particles
from diffuphy.workspace import Workspace

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class FitMaterial:
    """Settings of the material stage."""

    VERSION: ClassVar[int] = 7

    guidance: Any
    """Video prior (``losses.guidance``); the analytic one is given the probe's reference clips."""
    library: Any = None
    """Knows the parts of an object (``text2gs.shapes.Library``); None: one material for the whole object."""
    net: Net = field(default_factory=Net)
    """The material network."""
    probe: Probe = field(default_factory=Probe)
    """The experiment the clip shows."""
    estimator: Estimator = field(default_factory=SDS)
    """What training takes from the prior's answer (``losses.estimators``); the scan compares by plain SDS."""
    takes: Takes = field(default_factory=Takes)
    """What each step looks at: frames of the clip, camera, background."""
    velocity: Velocity | None = None
    """Velocity loss; None or weight 0 leaves it out."""
    override: dict[str, float | None] = field(default_factory=dict)
    """Parameters of the table to replace for the whole object, by name [SI]: {"E": 2e5, "nu": 0.3}; None keeps the
    table's."""
    elastic: tuple[str, ...] = ()
    """Candidate elastic experts; () lets the plan choose from the prompt."""
    plastic: tuple[str, ...] = ()
    """Candidate plastic experts; () lets the plan choose from the prompt."""
    stiffness: tuple[float, float] = (3.5, 6.3)
    """Range of log10 E [Pa]: softer inverts on impact, stiffer costs more substeps than a film shows."""
    stiffness_steps: int = 6
    """Values of log10 E in the scan; 0 leaves the scan out."""
    start: float = 5.2
    """log10 E to start from without a scan [Pa]; the stiff side is the safe side."""
    learn: tuple[str, ...] = ("E",)
    """Parameters to learn, by their names in the field; the others stay at the table's. A short drop shows stiffness;
    what else it shows depends on the material: ν, yield_stress, friction_angle, viscosity."""
    pixel_noise: float | None = None
    """Standard deviation of a pixel for which the summary says how certain what was learnt can be, and the log what the
    clip does not show (``identifiability``); some clips more. None leaves it out."""
    regions: int = 2
    """Most regions that get hypotheses of their own; 1 when the prompt names one material."""
    segment: Segment = "parts"
    """What makes a region: ``parts`` with words of their own in the prompt, if known to the library; or ``colour``."""
    scan_frames: int = 8
    """Frames of the scan's clips: impact and rebound."""
    refine: int = 3
    """Choices of laws, the best of the scan, that are refined before one of them is trained; 1 trains the best."""
    refine_steps: int = 5
    """Optimiser steps of each of these; 0 leaves them out."""
    steps: int = 40
    """Optimiser steps at most; 0 leaves the training out."""
    patience: int = 3
    """Scores in a row, one every five steps, that may bring less than 1 % before the training ends; 0 never ends it."""
    lr: float = 2e-3
    """Learning rate of the network; 1e-2 oscillates."""
    lr_region: float = 0.08
    """Learning rate of each region's common shift of its parameters."""
    smooth: float = 1e-3
    """Weight of the variance of log10 E inside a region [1/dex²]: particles differ only where the clip says so, and a
    few stiff ones do not set the time step of the film; 0 leaves it out."""
    curriculum: tuple[int, ...] = ()
    """Frames of the clip in equal parts of the run; () is all frames after a scan, 5-7-9-all without one."""
    blur: tuple[float, ...] = ()
    """Low-pass of the clip in equal parts of the run, the last being sharp [shares of the picture's height]; () is
    sharp after a scan, 1/8 and 1/16 first without one: from too soft a start sharp pictures lead the wrong way."""
    weight: Weight = "x0"
    """w(t) of the distillation; σ/α makes the gradient of the exact prior that of a squared error."""
    t_range: tuple[float, float] = (0.02, 0.98)
    """Diffusion times drawn from."""
    gate_time: float = 1 / 30
    """Reference time of the rate-form plastic gates while training [s]; the film runs hardened weights."""
    seed: int = 0

    def __post_init__(self) -> None:
        lo, hi = self.stiffness
        if not 0 < lo < hi < 12:
            raise ValueError(f"material.stiffness must be log10 Pa with lo < hi, e.g. (3.5, 6.3), got {self.stiffness}")
        if not lo < self.start < hi:
            raise ValueError(f"material.start must lie inside material.stiffness {self.stiffness}, got {self.start}")
        if min(self.steps, self.stiffness_steps, self.refine_steps) < 0 or min(self.regions, self.refine) < 1:
            raise ValueError(
                "material.steps, stiffness_steps and refine_steps must be ≥ 0 and regions and refine ≥ 1, got "
                f"{self.steps}, {self.stiffness_steps}, {self.refine_steps}, {self.regions} and {self.refine}"
            )
        if self.segment not in get_args(Segment):
            raise ValueError(f"material.segment must be one of {get_args(Segment)}, got {self.segment!r}")
        if not self.learn:
            raise ValueError("material.learn must name a parameter; material.steps=0 leaves the training out")
        if "rho" in self.learn:
            raise ValueError(RHO_UNSEEN)
        if self.pixel_noise is not None and not self.pixel_noise > 0:
            raise ValueError(f"material.pixel_noise must be positive, or null to leave it out, got {self.pixel_noise}")
        self._check_override()
        self.estimator.check(self.guidance)
        if self.scan_frames > self.probe.frames:
            raise ValueError(f"material.scan_frames = {self.scan_frames} exceeds probe.frames = {self.probe.frames}")

    def _check_override(self) -> None:
        """Refuse an overridden parameter that is no material's, or a value that no material can have."""
        known = ("E", "nu", "rho", "yield_stress", "friction_angle", "cohesion", "viscosity")
        if unknown := set(self.override) - set(known):
            raise ValueError(f"material.override has no {sorted(unknown)[0]!r}; it takes {', '.join(known)}")
        given = {k: v for k, v in self.override.items() if v is not None}
        for word in ("rubber", "metal", "sand", "honey"):  # together they read every parameter
            dataclasses.replace(lookup(word), **given)
        lo, hi = (10**e for e in self.stiffness)
        if "E" in given and not lo < given["E"] < hi:
            raise ValueError(
                f"material.override.E = {given['E']:g} Pa lies outside what the fit may find, {lo:.3g} to {hi:.3g} Pa; "
                "change it, or widen material.stiffness (log10 Pa)"
            )

    # ------------------------------------------------------------------ the stage
    def __call__(
        self, look: Look, motion: Motion, gaussians: Gaussians, particles: Particles, *, work: Workspace
    ) -> MaterialField:
        """Fit the material field of all ``particles``.

        Returns:
            One-hot on experts (so that the film does not depend on the time step), unused experts pruned.
        """
        case = self.case(look, motion, gaussians, particles)
        model = self.fit(case, work)
        with torch.no_grad():
            hardened = harden(model())
            numbers = verdict(case, hardened, self.weight)
            if self.pixel_noise is not None:
                numbers |= certainty(case, hardened, self._learnt(case), self.pixel_noise)
            work.summary(numbers)
            return film_field(case, model, gaussians, particles)

    def case(self, look: Look, motion: Motion, gaussians: Gaussians, particles: Particles) -> Case:
        """The object on the bench, and what is known of it."""
        return Case.make(
            self.probe, self.guidance, self.library, look, motion, gaussians, particles,
            elastic=self.elastic, plastic=self.plastic, override=self.override, regions=self.regions,
            segment=self.segment,
        )  # fmt: skip

    def fit(self, case: Case, work: Workspace) -> RegionalNet:
        """Scan, refine the best few, train the best of these; continues from the checkpoint of ``work``."""
        state = work.load() or {}
        if "starts" not in state:
            state = {"starts": self._starts(case, state.get("scores", ()), work), "tried": []}
        starts, tried, run = state["starts"], state["tried"], state.get("run")
        few = starts if self.steps and self.refine_steps and len(starts) > 1 else []
        short = dataclasses.replace(self.descent(self.refine_steps), curriculum=(), patience=0)
        for i in range(len(tried), len(few)):  # each finds the bottom of its own basin
            model = self.model(case, starts[i])
            done = descend(
                case, model, short, work,
                state=run, around={"starts": starts, "tried": tried}, first=i * self.refine_steps,
            )  # fmt: skip
            tried, run = [*tried, {"score": done.score, "model": model.state_dict()}], None
            work.save({"starts": starts, "tried": tried})
        best = min(range(len(tried)), key=lambda i: tried[i]["score"], default=0)
        model = self.model(case, starts[best])
        if tried:
            model.load_state_dict(tried[best]["model"])
            scores = ", ".join(f"{t['score']:.3g}" for t in tried)
            log.info("material: refined the best %d choices of laws to %s", len(tried), scores)
        if self.steps:
            around = {"starts": starts, "tried": tried}
            descend(case, model, self.descent(), work, state=run, around=around, first=len(few) * self.refine_steps)
        return model

    def _starts(self, case: Case, known: Sequence[float], work: Workspace) -> list[list[dict[str, Any]]]:
        """Hypotheses to begin from, each one for every region: the best of the scan, or an open one without it."""
        if self.stiffness_steps:
            lo, hi = self.stiffness
            steps = max(2, self.stiffness_steps // (int(case.labels.max()) + 1))  # a joint scan grows like a power
            grid = torch.linspace(lo + 0.1, hi - 0.1, steps, dtype=torch.float64).tolist()
            found = scan(
                case, grid, frames=self.scan_frames, weight=self.weight, work=work, known=known,
                batched=case.bench.draft.x.is_cuda,
            )  # fmt: skip
            return found[: self.refine]
        open_ones = [
            {"elastic": None, "plastic": None, "theta": r["theta"] | {"E": 10**self.start}, "rho": r["rho"]}
            for r in region_values(case.table, case.labels)
        ]
        return [open_ones]

    def descent(self, steps: int | None = None) -> Descent:
        """Settings of the training loop; the stage's own number of steps by default."""
        everything = self.probe.frames
        return Descent(
            steps=self.steps if steps is None else steps,
            takes=self.takes, estimator=self.estimator, weight=self.weight, t_range=self.t_range,
            velocity=self.velocity, gate_time=self.gate_time,
            curriculum=self.curriculum or (() if self.stiffness_steps else (5, 7, 9, everything)),
            blur=self.blur or (() if self.stiffness_steps else (1 / 8, 1 / 16)), patience=self.patience, seed=self.seed,
        )  # fmt: skip

    # ------------------------------------------------------------------ what is trained
    def model(self, case: Case, start: list[dict[str, Any]]) -> RegionalNet:
        """The network that begins at a hypothesis for each region."""
        learn, table = self._learnt(case), case.table
        begin = warm_start(table.elastic, table.plastic, case.labels, [Hypothesis(**h) for h in start])
        begin = dataclasses.replace(begin, theta=inside(learn, begin.theta))
        if self.net.gate == "start":
            begin = prune(begin).field
        return RegionalNet(
            self.net.build(case.points, begin, learn), case.labels,
            lr=self.lr, lr_region=self.lr_region, smooth=self.smooth,
        )  # fmt: skip

    def _learnt(self, case: Case) -> list[Param]:
        """The parameters to learn, Young's modulus with the bounds of this fit.

        Raises:
            ValueError: no candidate law reads one of them, so no clip depends on it.
        """
        known = {p.name: p for p in parameters(case.table.elastic, case.table.plastic)}
        if unread := [name for name in self.learn if name not in known]:
            raise ValueError(
                f"material.learn has {unread[0]!r}, which no candidate law reads; they read {', '.join(known)}"
            )
        lo, hi = (10**e for e in self.stiffness)
        return [dataclasses.replace(known[n], lo=lo, hi=hi) if n == "E" else known[n] for n in self.learn]
