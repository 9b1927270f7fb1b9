"""Text to Gaussians: score distillation of a prior into 3D Gaussians, seen from cameras all round."""

import logging
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, Protocol

import torch
from torch import Tensor

from diffuphy.losses import SDS, Constant, Estimator, Exponential, Linear, Schedule, sds
from diffuphy.losses.guidance import Guidance
from diffuphy.losses.regularize import anisotropy
from diffuphy.losses.sds import Weight
from diffuphy.render import Rasteriser, Warp, orbit, render_gaussians
from diffuphy.text2gs.cameras import Orbits
from diffuphy.text2gs.densify import AdaptiveSplitting
from diffuphy.text2gs.init import Start, SurfaceCloud
from diffuphy.text2gs.params import LearningRates, Parameters, clean
from diffuphy.text2gs.shape_prior import ShapePrior
from diffuphy.types import N_SH, Camera, Gaussians, Look
from diffuphy.workspace import Workspace

log = logging.getLogger(__name__)


class Judge(Protocol):
    """Whoever says how good Gaussians are."""

    def judge(self, gaussians: Gaussians, backend: Rasteriser) -> dict[str, float]:
        """Numbers by name."""
        ...


class Bank(Protocol):
    """Cameras to draw from: ``Orbits``, or those of pictures."""

    @property
    def bank(self) -> int:
        """How many there are."""
        ...

    @property
    def ring(self) -> int:
        """How many of them always come together."""
        ...

    @property
    def size(self) -> int:
        """Longer side of the picture [px]."""
        ...

    @property
    def distance(self) -> float:
        """From camera to origin, for previews [object units]."""
        ...

    @property
    def fov(self) -> float:
        """Angle of previews across the shorter side [deg]."""
        ...

    def __call__(self) -> Camera:
        """All of them."""
        ...


@dataclass(frozen=True)
class FitGaussians:
    """Gaussians whose pictures the guidance finds likely.

        E_{camera, t, ε}[w(t) (ε̂ − ε) ∂z/∂θ] = 0

    DiffuPhyGS, eqs. 2 and 4; Poole et al., DreamFusion (2023).
    """

    VERSION: ClassVar[int] = 1

    guidance: Guidance
    """The prior; its layout must be "image" or "views"."""
    cameras: Bank = field(default_factory=Orbits)
    """Bank of cameras to draw from, and their picture size."""
    init: Start = field(default_factory=SurfaceCloud)
    """What to start from."""
    shape: ShapePrior | None = None
    """A prior of where the points are, beside that of what they look like; None leaves it out."""
    densify: AdaptiveSplitting | None = field(default_factory=AdaptiveSplitting)
    """When and where to add Gaussians; None keeps their number."""
    rates: LearningRates = field(default_factory=LearningRates)
    """Step sizes at the start."""
    decay: Schedule = field(default_factory=lambda: Exponential(1.0, 0.03))
    """Factor on all step sizes over the run; 0.1 at the end instead of 0.03 loses 0.3 dB to the noise of single
    views."""
    steps: int = 1200
    """Optimiser steps."""
    views: int = 1
    """Cameras a step. More steps with fewer views win: at an equal number of views 1, 2, 4 and 8 reach
    31.0, 30.2, 28.8 and 26.5 dB."""
    t_min: Schedule = field(default_factory=lambda: Constant(0.02))
    """Lower end of the diffusion times drawn."""
    t_max: Schedule = field(default_factory=lambda: Linear(0.98, 0.25, 0.7))
    """Upper end: large times settle which object it is, small ones its details (+0.3 dB against no annealing)."""
    weight: Weight = "sigma2"
    """w(t) of the estimator."""
    estimator: Estimator = field(default_factory=SDS)
    """What is taken from the prior's answer (``losses.estimators``)."""
    background: Literal["random", "white"] = "random"
    """Colour behind the object: white and a random colour in turn by chance, which no transparent haze can match; or
    white."""
    sh_degree: int = 0
    """Degree of spherical harmonics, 0 to 3. 0: colour does not depend on the view, and nothing need turn with the
    material."""
    opaque: float = 0.15
    """Drift of opacities towards 1, as a share of a full step: matter is opaque unless the pictures keep objecting."""
    max_scale: float = 0.15
    """Longest axis of a Gaussian (1 σ) [object units]."""
    max_ratio: float = 5.0
    """Longest over shortest axis of a Gaussian; 8 gains 0.1 dB and makes flatter ones, which a deforming body tears."""
    anisotropy: float = 0.0
    """Weight of the mean excess of the ratio of axes over ``anisotropy_ratio`` (``losses.regularize``) [-]; 0 leaves it
    out: ``max_ratio`` bounds every ratio already."""
    anisotropy_ratio: float = 3.0
    """Ratio up to which Gaussians are let alone [-]."""
    min_opacity: float = 0.1
    """Gaussians more transparent than this are haze and go at the end."""
    isolation: float = 4.0
    """At the end, a Gaussian farther from its neighbours than this many times its size plus their spacing goes too."""
    preview_every: int = field(default=50, metadata={"runtime": True})
    """Steps between preview pictures and metrics."""
    backend: Rasteriser = field(default_factory=Warp)
    """Rasteriser."""
    seed: int = 0
    """Of everything random: start, cameras, backgrounds, times, noise, children."""
    judge: Judge | None = field(default=None, metadata={"runtime": True})
    """Asked at the end about the result; its numbers go to the log. None: nobody."""

    def __post_init__(self) -> None:
        if self.guidance.layout not in ("image", "views"):
            raise ValueError(
                f"FitGaussians renders pictures; guidance of layout {self.guidance.layout!r} cannot judge them"
            )
        if self.sh_degree not in N_SH:
            raise ValueError(f"sh_degree must be 0, 1, 2 or 3, got {self.sh_degree}")
        if self.steps < 1 or not 1 <= self.views <= self.cameras.bank:
            raise ValueError(
                f"steps must be ≥ 1 and views in [1, {self.cameras.bank}], got {self.steps} and {self.views}"
            )
        together = getattr(self.guidance, "together", 1)
        if self.views % self.cameras.ring or self.cameras.ring % together:
            raise ValueError(
                f"fit.views must be a multiple of fit.cameras.ring, and that of the {together} views that the prior "
                f"judges together, got {self.views} and {self.cameras.ring}; set both to {together}"
            )
        if self.anisotropy < 0.0 or self.anisotropy_ratio < 1.0:
            raise ValueError(
                "anisotropy must not be negative and anisotropy_ratio at least 1, "
                f"got {self.anisotropy} and {self.anisotropy_ratio}"
            )
        self.estimator.check(self.guidance)

    def __call__(self, look: Look, *, work: Workspace | None = None) -> Gaussians:
        """Fit Gaussians to ``look``. Interrupted and called again with the same workspace, it gives the same bits."""
        work = work or Workspace()
        run = _Run.restored(work.load(), work.device) or _Run.started(self, look, work.device)
        bank = self.cameras().to(work.device)
        if self.shape is not None and self.shape.acts(run.step, self.steps):
            self.shape.prepare(look, work.device)
        bar = work.bar(self.steps, "gaussians", initial=run.step)

        while run.step < self.steps:
            step = run.step
            params, g = run.params, run.generator
            if step % self.preview_every == 0:
                self._preview(work, run)

            camera = bank[run.next_views(self.views, len(bank), self.cameras.ring)]
            background = self._background(g).to(work.device)
            picture = render_gaussians(params.gaussians(), camera, background=background, backend=self.backend).rgb
            cond = self.guidance.condition(look, camera, background, generator=g)
            t = self._times(step, g).to(work.device)
            loss = sds(self.guidance, picture, cond, t=t, generator=g, weight=self.weight, estimator=self.estimator)
            loss.backward()

            run.observe()
            shape = self._shape(look, run)
            if self.anisotropy > 0.0:
                (self.anisotropy * anisotropy(params.values["log_scales"], self.anisotropy_ratio)).backward()
            params.step(self.rates, self.decay(step, self.steps), opaque=self.opaque)
            params.project(max_scale=self.max_scale, max_ratio=self.max_ratio)
            run.step += 1
            if self.densify is not None and self.densify.due(run.step, self.steps):
                counts = self.densify(params, run.mean_gradient(), g)
                run.forget_gradients()
                work.log(run.step, event="densify", **counts)
            if step % self.preview_every == 0:
                scalars = {"sds": loss.item(), **shape, "t_max": self.t_max(step, self.steps)}
                work.log(run.step, gaussians=len(params), **scalars)
            bar.update()
            work.show("gaussians", run.step, self.steps, params.gaussians)
            if work.due():
                work.save(run.state())
        bar.close()

        self._preview(work, run)
        gaussians, removed = clean(
            run.params.gaussians(), min_opacity=self.min_opacity, radius=1.7, isolation=self.isolation
        )
        work.log(run.step, event="clean", gaussians=len(gaussians), **removed)
        log.info("%d Gaussians after %d steps; removed %s", len(gaussians), self.steps, removed)
        if self.judge is not None:
            work.log(run.step, event="judged", **self.judge.judge(gaussians, self.backend))
        return gaussians

    def _shape(self, look: Look, run: "_Run") -> dict[str, float]:
        """Add the gradient of the shape prior, if it acts, to those of the pictures; its value, for the log.

        Eq. 2 has means over views where the pictures' gradient is a sum, hence the factor; it comes after ``observe``,
        since densification looks at the pictures' gradient alone (§3.3).
        """
        if self.shape is None or not self.shape.acts(run.step, self.steps):
            return {}
        loss = self.shape.loss(run.params.gaussians(), look, run.generator)
        (self.views * loss).backward()
        return {"shape": loss.item()}

    # ------------------------------------------------------------------ what is drawn at random
    def _background(self, g: torch.Generator) -> Tensor:
        colour, chance = torch.rand(3, generator=g), torch.rand((), generator=g)
        return colour if self.background == "random" and chance < 0.5 else torch.ones(3)

    def _times(self, step: int, g: torch.Generator) -> Tensor:
        """Diffusion times, uniform between the two schedules: one for all views when they are judged together."""
        lo, hi = self.t_min(step, self.steps), self.t_max(step, self.steps)
        count = 1 if self.guidance.layout == "views" else self.views
        return (lo + (hi - lo) * torch.rand(count, generator=g)).expand(self.views)

    @torch.no_grad()
    def _preview(self, work: Workspace, run: "_Run") -> None:
        if work.directory is None:
            return
        o = self.cameras
        camera = orbit([30.0, 120.0, 250.0], [15.0, 35.0, 5.0], o.distance, fov=o.fov, width=128, height=128)
        camera, white = camera.to(work.device), torch.ones(3, device=work.device)
        rgb = render_gaussians(run.params.gaussians(), camera, background=white, backend=self.backend).rgb
        work.image(f"gaussians-{run.step:05d}", torch.cat(list(rgb), 1))


class _Run:
    """Everything that changes while the loop runs; what it holds is what a checkpoint holds."""

    def __init__(self, params: Parameters, generator: torch.Generator):
        self.params, self.generator, self.step = params, generator, 0
        self.order = torch.empty(0, dtype=torch.int64)
        self.forget_gradients()

    @classmethod
    def started(cls, fit: FitGaussians, look: Look, device: str) -> "_Run":
        g = torch.Generator().manual_seed(fit.seed)
        return cls(Parameters(fit.init(look, fit.guidance, g, fit.sh_degree, device=device).to(device)), g)

    @classmethod
    def restored(cls, state: dict[str, Any] | None, device: str) -> "_Run | None":
        if state is None:
            return None
        self = cls(Parameters.restored(state["params"], device), torch.Generator())
        self.generator.set_state(state["generator"])
        self.step, self.order = state["step"], state["order"]
        self.gradient, self.seen = state["gradient"].to(device), state["seen"]
        return self

    def state(self) -> dict[str, Any]:
        return {
            "step": self.step,
            "params": self.params.state(),
            "generator": self.generator.get_state(),
            "order": self.order,
            "gradient": self.gradient,
            "seen": self.seen,
        }

    def next_views(self, views: int, bank: int, ring: int) -> Tensor:
        """Indices of the next cameras: a bank shuffled ring by ring, dealt out until too few are left."""
        if len(self.order) < views:
            rings = torch.randperm(bank // ring, generator=self.generator)
            self.order = (ring * rings[:, None] + torch.arange(ring)).flatten()
        drawn, self.order = self.order[:views], self.order[views:]
        return drawn

    def observe(self) -> None:
        """Add ‖∂L/∂mean_i‖ of this step to the account that densification looks at."""
        self.gradient += self.params.values["means"].grad.norm(dim=1)
        self.seen += 1

    def mean_gradient(self) -> Tensor:
        return self.gradient / max(1, self.seen)

    def forget_gradients(self) -> None:
        self.gradient, self.seen = torch.zeros(len(self.params), device=self.params.age.device), 0
