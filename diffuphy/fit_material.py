"""The stage that finds out what the object is made of.

    probe the object → scan experts × stiffness, forward only → refine a network inside the best basin → harden

The scan finds the basin, the gradient the bottom of it. The gradient runs the whole way back: pixels → Gaussians →
trajectory → MPM adjoint → mixture → decoder → encoder. DiffuPhyGS (2025), §3.3–3.4. Recipe and
failures: docs/learning.md.
"""

import dataclasses
import logging
from dataclasses import dataclass, field
from functools import partial
from typing import Any, ClassVar

import torch
from torch import Tensor

from diffuphy.appearance import appearance
from diffuphy.losses.estimators import SDS, Estimator
from diffuphy.losses.regularize import spread
from diffuphy.losses.sds import Weight
from diffuphy.losses.takes import Takes
from diffuphy.losses.velocity import Velocity
from diffuphy.material import ELASTIC, Param
from diffuphy.material.decoder import bounded, inside
from diffuphy.material.encoder import Points
from diffuphy.material.field import Hypothesis, harden, prune, summary, warm_start
from diffuphy.material.net import MaterialNet, Net
from diffuphy.material.patches import color_clusters, nearest
from diffuphy.material.presets import lookup
from diffuphy.mpm import FrameReport
from diffuphy.probe import Bench, Probe, TableClips, table_field
from diffuphy.scan import Conditions, region_values, scan, with_columns
from diffuphy.types import Gaussians, Look, MaterialField, Motion, Particles
from diffuphy.workspace import Workspace

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class FitMaterial:
    """Settings of the material stage."""

    VERSION: ClassVar[int] = 4

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
    regions: int = 2
    """Most regions, by colour, that get hypotheses of their own; 1 when the prompt names one material."""
    scan_frames: int = 8
    """Frames of the scan's clips: impact and rebound."""
    steps: int = 40
    """Optimiser steps; 0 leaves the training out."""
    lr: float = 2e-3
    """Learning rate of the network; 1e-2 oscillates."""
    lr_region: float = 0.08
    """Learning rate of each region's common shift of its parameters."""
    smooth: float = 1e-3
    """Weight of the variance of log10 E inside a region [1/dex²]: particles differ only where the clip says so, and a
    few stiff ones do not set the time step of the film; 0 leaves it out."""
    curriculum: tuple[int, ...] = ()
    """Frames of the clip in equal parts of the run; () is all frames after a scan, 5-7-9-all without one."""
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
        if self.steps < 0 or self.stiffness_steps < 0 or self.regions < 1:
            raise ValueError(
                f"material.steps and stiffness_steps must be ≥ 0 and regions ≥ 1, "
                f"got {self.steps}, {self.stiffness_steps}, {self.regions}"
            )
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
        bench = self.probe.bench(gaussians, particles, motion.size)
        table = self._table(look, motion, bench)
        guidance = self._guidance(look, motion, gaussians, particles)
        cond = Conditions(guidance, motion, bench)
        points = appearance(gaussians, bench.draft)
        labels = self._labels(motion, points)

        state = work.load() or {"step": 0, "chosen": self._chosen(bench, cond, table, labels, work)}
        chosen = [Hypothesis(**h) for h in state["chosen"]]
        net, shift = self._train(bench, cond, points, labels, chosen, state, work)

        with torch.no_grad():
            draft = harden(self._field(net, shift, labels))
            self._verdict(bench, cond, draft, table, work)
            return self._film_field(net, shift, labels, gaussians, particles, bench)

    def _guidance(self, look: Look, motion: Motion, gaussians: Gaussians, particles: Particles) -> Any:
        """The prior; the analytic one knows clips of the probe by heart, simulated with another draw of particles."""
        if getattr(self.guidance, "references", 0) is not None:
            return self.guidance
        other = dataclasses.replace(self.probe, seed=self.probe.seed + 1).bench(gaussians, particles, motion.size)
        return dataclasses.replace(self.guidance, references=TableClips(other, self._table(look, motion, other)))

    def _table(self, look: Look, motion: Motion, bench: Bench) -> MaterialField:
        """What the table says of the draft particles, with a column for each candidate expert."""
        table = table_field(self.library, look, motion, bench.draft, self.override)
        return with_columns(table, self.elastic or table.elastic, self.plastic or table.plastic)

    def _labels(self, motion: Motion, points: Points) -> Tensor:
        """Region of each draft particle: colour clusters, as many as the prompt has materials."""
        k = min(self.regions, len(set(motion.materials.values())))
        return color_clusters(points.f[:, 7:10], k)[0]

    def _chosen(
        self, bench: Bench, cond: Conditions, table: MaterialField, labels: Tensor, work: Workspace
    ) -> list[dict[str, Any]]:
        """One hypothesis for each region: the best of the scan, or an open one without it."""
        if self.stiffness_steps:
            lo, hi = self.stiffness
            regions = int(labels.max()) + 1
            steps = max(2, self.stiffness_steps // regions)  # a joint scan of regions grows like a power of them
            grid = torch.linspace(lo + 0.1, hi - 0.1, steps, dtype=torch.float64).tolist()
            return scan(bench, cond, table, labels, grid, frames=self.scan_frames, weight=self.weight, work=work)
        regions = region_values(table, labels)
        return [
            {"elastic": None, "plastic": None, "theta": r["theta"] | {"E": 10**self.start}, "rho": r["rho"]}
            for r in regions
        ]

    # ------------------------------------------------------------------ full gradient: find the bottom
    def _train(
        self,
        bench: Bench,
        cond: Conditions,
        points: Points,
        labels: Tensor,
        chosen: list[Hypothesis],
        state: dict,
        work: Workspace,
    ) -> tuple[MaterialNet, Tensor]:
        """Refine the network and each region's shift by video SDS and the velocity loss, continuing from ``state``."""
        start = warm_start(self.elastic, self.plastic, labels, chosen)
        learn = [self._param_E()]
        start = dataclasses.replace(start, theta=inside(learn, start.theta))
        net = self.net.build(points, start, learn)
        shift = torch.zeros(len(chosen), device=points.x.device, requires_grad=True)
        groups = [{"params": list(net.parameters()), "lr": self.lr}, {"params": [shift], "lr": self.lr_region}]
        optimiser = torch.optim.Adam(groups, betas=(0.9, 0.95))
        generator = torch.Generator().manual_seed(self.seed)
        velocity = self.velocity if self.velocity is not None and self.velocity.weight else None
        gather = (velocity.needs,) if velocity is not None and velocity.needs else ()
        if "net" in state:
            net.load_state_dict(state["net"])
            optimiser.load_state_dict(state["optimiser"])
            generator.set_state(state["rng"])
            with torch.no_grad():
                shift.copy_(state["shift"])

        with work.bar(self.steps, "material: train", initial=state["step"]) as bar:
            for step in range(state["step"], self.steps):
                for group, rate in zip(optimiser.param_groups, (self.lr, self.lr_region), strict=True):
                    group["lr"] = rate * min(1.0, (step + 1) / 4) * (1 - 0.9 * step / self.steps)
                take = self.takes(step, self._frames(step), generator)
                field = self._field(net, shift, labels)
                reports: list[FrameReport] = []
                trajectory = bench.simulate(
                    field, take.frames[-1], gate_time=self.gate_time, report=reports, gather=gather
                )
                t = self.t_range[0] + (self.t_range[1] - self.t_range[0]) * float(torch.rand((), generator=generator))
                loss = distilled = cond.distil(
                    trajectory, take, t=t, generator=generator, weight=self.weight, estimator=self.estimator
                )
                if velocity is not None:
                    loss = loss + bench.velocity_loss(velocity, trajectory, field, reports)
                if self.smooth:
                    loss = loss + self.smooth * spread(field.theta["E"].log10(), labels)
                optimiser.zero_grad()
                loss.backward()
                norm = torch.nn.utils.clip_grad_norm_([*net.parameters(), shift], 1.0, error_if_nonfinite=True)
                optimiser.step()
                bar.update()
                work.show("material", step + 1, self.steps, partial(lambda film: (bench.skin, film), trajectory))
                work.log(step, loss=distilled.item(), total=loss.item(), grad=norm.item(), **summary(field))
                if work.due() or step + 1 == self.steps:
                    work.save(
                        {
                            "step": step + 1,
                            "chosen": [dataclasses.asdict(h) for h in chosen],
                            "net": net.state_dict(),
                            "shift": shift.detach(),
                            "optimiser": optimiser.state_dict(),
                            "rng": generator.get_state(),
                        }
                    )
        return net, shift.detach()

    def _frames(self, step: int) -> int:
        """Frames shown at this step: short clips first, when the start may be far away."""
        everything = self.probe.frames
        stages = self.curriculum or ((everything,) if self.stiffness_steps else (5, 7, 9, everything))
        return min(everything, stages[min(len(stages) - 1, step * (len(stages) + 1) // max(self.steps, 1))])

    def _param_E(self) -> Param:
        """Young's modulus with the bounds of this fit."""
        E = next(p for p in ELASTIC[self.elastic[0]].params if p.name == "E")
        return dataclasses.replace(E, lo=10 ** self.stiffness[0], hi=10 ** self.stiffness[1])

    def _field(self, net: MaterialNet, shift: Tensor, labels: Tensor, points: Points | None = None) -> MaterialField:
        """What the network says, each region moved as a whole by its shift."""
        field = net() if points is None else net(points)
        E = bounded(self._param_E(), field.theta["E"], shift[labels], self.net.param_gain)
        return dataclasses.replace(field, theta=field.theta | {"E": E})

    def _film_field(
        self, net: MaterialNet, shift: Tensor, labels: Tensor, gaussians: Gaussians, particles: Particles, bench: Bench
    ) -> MaterialField:
        """The trained field at all particles, hardened and pruned."""
        parent = nearest(particles.x, bench.draft.x, 1)[1][:, 0]
        field = self._field(net, shift, labels[parent], appearance(gaussians, particles))
        pruned = prune(harden(field))
        for name in pruned.dropped:
            log.info("material: expert %s left out of the film (largest weight %.1e)", name, pruned.peaks[name])
        return pruned.field

    # ------------------------------------------------------------------ how good is it
    def _verdict(
        self, bench: Bench, cond: Conditions, field: MaterialField, table: MaterialField, work: Workspace
    ) -> None:
        """Hardened loss, held-out motion, and the loss at the table itself: below it one fits discretisation."""
        pruned = prune(field)
        numbers = {"hardened_loss": cond.score(bench.simulate(pruned.field), self.weight)}
        if pruned.dropped:
            numbers["pruning_change"] = bench.change(field, pruned.field)
        if isinstance(getattr(cond.guidance, "references", None), TableClips):
            numbers["loss_at_table"] = cond.score(bench.simulate(prune(table).field), self.weight)
            other = dataclasses.replace(self.probe, speed=1.7 * self.probe.speed, tilt=0.25).scene(
                bench.scene.dx, bench.size
            )
            mine, theirs = (bench.film(bench.simulate(prune(f).field, scene=other)) for f in (field, table))
            numbers["held_out_motion"] = float(((mine - theirs) ** 2).mean())
        work.summary(numbers | summary(field))
