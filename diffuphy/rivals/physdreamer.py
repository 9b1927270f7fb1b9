"""PhysDreamer: a stiffness field that reproduces one clip which the prior has drawn."""

import dataclasses
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from diffuphy.learning.case import Case, Conditions
from diffuphy.learning.descent import Descent, Model
from diffuphy.losses.estimators import ddim
from diffuphy.losses.takes import Take
from diffuphy.losses.video import clip_latents
from diffuphy.material.decoder import bounded, inside
from diffuphy.material.encoder import Points
from diffuphy.material.moduli import E
from diffuphy.metrics.structure import ssim
from diffuphy.rivals.particles import towards
from diffuphy.rivals.rival import Frozen, Rival, of_one_law
from diffuphy.types import MaterialField, Motion, Trajectory


def drawn(guidance: Any, cond: Any, noise: Tensor, steps: int) -> Tensor:
    """A sample of a prior: from noise along its deterministic path.

    Song et al., DDIM (2021), eq. 12 with η = 0, times from 0.98 to 0.02 evenly, then to 0.

    Args:
        noise: ε, of the shape of the latents.
        steps: calls of the network.
    """
    times = torch.linspace(0.98, 0.02, steps, device=noise.device)
    z = noise
    with torch.no_grad():
        for t, to in zip(times[:-1, None], times[1:, None], strict=True):
            z = ddim(guidance, z, guidance.predict_noise(z, t, cond), t, to)
        last = times[-1:]
        alpha, sigma = guidance.schedule(last)
        return (z - sigma.to(z) * guidance.predict_noise(z, last, cond)) / alpha.to(z)


class OneClip(Conditions):
    """The prior, asked once: the clip that it draws is what every clip is compared with.

        L = 0.1 · ½ mean (z − z*)² + 0.9 · (1 − SSIM(z, z*))

    Zhang et al., PhysDreamer (2024), with the weights of its published program, in z ∈ [0, 1] where the latents
    are pictures; SSIM means nothing in the latents of a network, there the first term stands alone.
    """

    def __init__(self, cond: Conditions, *, seed: int, steps: int):
        super().__init__(cond.guidance, cond.motion, cond.bench)
        self.seed, self.steps = seed, steps
        self._clip: Tensor | None = None

    def clip(self) -> Tensor:
        """The latents of the clip, drawn when they are first needed."""
        if self._clip is None:
            probe, device = self.bench.probe, self.bench.draft.x.device
            with torch.no_grad():
                blank = torch.zeros(1, probe.frames, probe.image, probe.image, 3, device=device)
                like = self.guidance.encode(blank)
            noise = torch.randn(like.shape, generator=torch.Generator().manual_seed(self.seed)).to(like)
            self._clip = drawn(self.guidance, self.prepare(Take.whole(probe.frames)), noise, self.steps)
        return self._clip

    def distil(self, trajectory: Trajectory, take: Take, *, t: float, **settings: Any) -> Tensor:
        """The loss of a take; diffusion time, noise and estimator play no part."""
        frames = list(take.frames)
        z = clip_latents(self.guidance, self.bench.drawing(take), (trajectory.x[frames], trajectory.F[frames]))
        return photometric(z, self.clip()[:, [f - 1 for f in frames]], pictures=z.shape[-1] == 3)


def photometric(z: Tensor, target: Tensor, *, pictures: bool) -> Tensor:
    """See ``OneClip``; latents (1, T, ...), as pictures in [−1, 1]."""
    if not pictures:
        return 0.5 * (z - target).square().mean()
    a, b = ((x[0] + 1) / 2 for x in (z, target))
    return 0.05 * (a - b).square().mean() + 0.9 * (1 - ssim(a, b).mean()).to(z)


class Triplane(Model):
    """E as a function of place: three planes of features, summed, and a small network.

    Chan et al., EG3D (2022). Its last layer begins at zero, so the first field is the start.
    """

    def __init__(self, start: MaterialField, x: Tensor, settings: "PhysDreamer"):
        super().__init__()
        s, generator = settings, torch.Generator().manual_seed(settings.seed)
        self.start, self.param, self.settings = Frozen(start), E, settings
        self.register_buffer("low", x.amin(0))
        self.register_buffer("span", (x.amax(0) - x.amin(0)).amax())
        self.register_buffer("x", x)
        planes = torch.randn(3, s.features, s.resolution, s.resolution, generator=generator)
        self.planes = nn.Parameter(planes)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(s.seed)
            self.mlp = nn.Sequential(
                nn.Linear(s.features, 32), nn.ReLU(), nn.Linear(32, 32), nn.ReLU(), nn.Linear(32, 1)
            )
        for p in self.mlp[-1].parameters():
            nn.init.zeros_(p)
        self.to(x.device)

    def forward(self) -> MaterialField:
        return self._field(self.start(), self.x)

    def at(self, points: Points, draft: Tensor) -> MaterialField:
        return self._field(self.start(draft), points.x)

    def _field(self, start: MaterialField, x: Tensor) -> MaterialField:
        u = (2 * (x - self.low) / self.span - 1).clamp(-1, 1)
        grid = torch.stack([u[:, [0, 1]], u[:, [0, 2]], u[:, [1, 2]]])[:, None]  # (3, 1, N, 2)
        seen = nn.functional.grid_sample(self.planes, grid, align_corners=True)[:, :, 0].sum(0).T
        young = bounded(self.param, start.theta["E"], self.mlp(seen)[:, 0], 1.0)
        return dataclasses.replace(start, theta=start.theta | {"E": young})

    def groups(self) -> list[dict[str, Any]]:
        return [{"params": list(self.parameters()), "lr": self.settings.lr}]

    def penalty(self, field: MaterialField) -> Tensor | None:
        """Total variation of the planes."""
        across, down = (self.planes.diff(dim=d).abs().mean() for d in (2, 3))
        return self.settings.smooth * (across + down) if self.settings.smooth else None


@dataclass(frozen=True)
class PhysDreamer(Rival):
    """A field of Young's modulus by the pixels of one clip; elastic, nothing else.

    Zhang et al., PhysDreamer (2024); sizes and weights of its published program (``train_material.py``).

    What differs: E moves in its logarithm and within this engine's range, there by steps of 1 kPa in a range of five
    decades; the gradient reaches through the whole clip, there through one frame; the clip begins as the experiment
    does, so that no initial velocity need be found; learning rate larger for fewer steps.
    """

    NAME = "PhysDreamer"

    start: float = 1e5
    """E to start from [Pa]."""
    resolution: int = 8
    """Cells of a plane along each side."""
    features: int = 32
    """Features of a cell."""
    smooth: float = 1e-4
    """Weight of the total variation of the planes."""
    lr: float = 1e-2
    """Learning rate; 1e-3 in the program, with 200 steps."""
    samples: int = 30
    """Steps in which the prior draws its clip."""

    def experts(self, motion: Motion) -> tuple[tuple[str, ...], tuple[str, ...], str]:
        return ("fixed_corotated",), ("identity",), f"{self.NAME} is elastic, whatever the material"

    def begin(self, told: MaterialField) -> MaterialField:
        start = of_one_law(told, "fixed_corotated", "identity", {"E": self.start})
        return dataclasses.replace(start, theta=inside([E], start.theta))

    def model(self, case: Case, start: MaterialField) -> Model:
        return Triplane(start, case.bench.draft.x, self)

    def stiffest(self, start: MaterialField, told: MaterialField, share: float) -> MaterialField:
        """It is taken to end at what the clip shows, and to come there evenly."""
        way = share * float((told.theta["E"] / start.theta["E"]).log10().abs())
        return dataclasses.replace(start, theta=start.theta | {"E": towards(start.theta["E"], told.theta["E"], way)})

    def trained_against(self, case: Case) -> Case:
        return dataclasses.replace(case, cond=OneClip(case.cond, seed=self.seed, steps=self.samples))

    def descent(self) -> Descent:
        return dataclasses.replace(super().descent(), curriculum=(max(2, self.probe.frames // 2), self.probe.frames))

    def plan(self) -> list[tuple[str, str, str]]:
        return [
            ("video SDS", "left out", "the prior draws one clip, whose pixels are compared"),
            ("gradient", "kept", "through the whole simulation, to a triplane of E"),
        ]
