"""What is played: particles in motion, the Gaussians that they carry, and colours."""

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np
import torch
from torch import Tensor

from diffuphy.geometry import rotations
from diffuphy.mpm import State
from diffuphy.render import Skin
from diffuphy.render.around import Around, Scenery, with_scenery
from diffuphy.render.kinematics import limit_stretch
from diffuphy.render.paint import PAINTED, Measured, Mixed, Moment, Painter, onto_gaussians, painter
from diffuphy.render.sh import C0, from_rgb
from diffuphy.types import Gaussians, MaterialField, Particles, Trajectory

VIEWS = ("colour", *PAINTED)
"""What a shot can be coloured by."""

COARSE = 4
"""Particles that each Gaussian follows when there are fewer particles than in the film: each stands for many Gaussians,
and one alone would show as a block."""


class Splats(NamedTuple):
    """Gaussians as a browser draws them, float32."""

    centers: np.ndarray
    """Shape (G, 3) [m]."""
    covariances: np.ndarray
    """Shape (G, 3, 3) [m²]."""
    rgbs: np.ndarray
    """Shape (G, 3), in [0, 1]."""
    opacities: np.ndarray
    """Shape (G, 1), in [0, 1]."""

    def gaussians(self) -> Gaussians:
        """The same as a result, in metres: axes and scales are those of Σ."""
        from scipy.spatial.transform import Rotation

        variance, axes = torch.linalg.eigh(torch.from_numpy(self.covariances).double())
        axes = axes * torch.linalg.det(axes).sign()[:, None, None]  # right-handed
        quats = torch.from_numpy(Rotation.from_matrix(axes.numpy()).as_quat())[:, [3, 0, 1, 2]]
        tiny = torch.finfo(torch.float32).tiny
        alpha = torch.from_numpy(self.opacities[:, 0]).double().clamp(1e-6, 1 - 1e-6)
        return Gaussians(
            torch.from_numpy(self.centers),
            quats.float(),
            (0.5 * variance.clamp_min(tiny).log()).float(),
            torch.logit(alpha).float(),
            from_rgb(torch.from_numpy(self.rgbs)),
        )


def _resting(g: Gaussians) -> tuple[Tensor, Tensor, Tensor]:
    """R S, colours seen from nowhere in particular (the constant term), and opacities."""
    axes = rotations(g.quats) * g.log_scales.exp()[:, None, :]
    return axes, (0.5 + C0 * g.sh[:, 0]).clamp(0, 1), g.logit_opacities.sigmoid()[:, None]


def still(gaussians: Gaussians) -> Splats:
    """Gaussians as they are."""
    M, rgb, opacity = _resting(gaussians)
    return Splats(*(t.detach().float().numpy() for t in (gaussians.means, M @ M.mT, rgb, opacity)))


@dataclass(frozen=True)
class Figure:
    """Gaussians that follow particles, in main memory."""

    skin: Skin | Scenery
    stretch: float
    """Longest drawing of a Gaussian over that at rest [-]."""

    @classmethod
    def of(
        cls, gaussians: Gaussians, particles: Particles, k: int, stretch: float, around: Around | None = None
    ) -> Self:
        """Tie each Gaussian to ``k`` particles."""
        particles = particles.to("cpu")
        skin = Skin.bind(gaussians.to("cpu"), particles, min(k, len(particles)))
        return cls(with_scenery(skin, around, particles), stretch)

    @cached_property
    def _rest(self) -> tuple[Tensor, Tensor, Tensor]:
        return _resting(self.skin.gaussians)

    def __call__(self, x: Tensor, F: Tensor, colors: Tensor | None = None) -> Splats:
        """Gaussians for particles at ``x`` (N, 3) [m] deformed by ``F`` (N, 3, 3).

            Σ = F R S² Rᵀ Fᵀ

        Args:
            colors: of the particles, shape (N, 3); None: those of the film.
        """
        axes, rgb, opacity = self._rest
        means, F_g = self.skin(x, F)
        M = limit_stretch(F_g, self.stretch) @ axes
        if colors is not None:
            tied = self.skin.skin if isinstance(self.skin, Scenery) else self.skin
            own = onto_gaussians(colors.to(rgb), tied.index, tied.weight)
            rgb = torch.cat([own, rgb[len(own) :]])
        return Splats(*(t.float().numpy() for t in (means, M @ M.mT, rgb, opacity)))


@dataclass(frozen=True)
class Shot:
    """A film that is not yet pictures."""

    title: str
    """What was simulated."""
    figure: Figure
    particles: Particles
    """Those that move."""
    field: MaterialField
    """What they are made of."""
    trajectory: Trajectory
    """How they move, in main memory."""

    def __len__(self) -> int:
        return len(self.trajectory.x)

    @cached_property
    def _painters(self) -> dict[str, Painter]:
        return {}

    def painter(self, view: str) -> Painter | None:
        """Who paints this view, on the scale of the whole film; None for its own colours."""
        if view == "colour":
            return None
        if view not in self._painters:
            self._painters[view] = painter(view, self.trajectory, self.field.to("cpu"))
        return self._painters[view]

    def splats(self, t: int, view: str = "colour") -> Splats:
        """Frame ``t``."""
        paint, now = self.painter(view), Moment.of(self.trajectory, t)
        return self.figure(now.x, now.F, None if paint is None else paint(now))


@dataclass(frozen=True)
class Stage:
    """Where a simulation goes on, in the colours and on the scales of a film."""

    title: str
    """What is simulated."""
    figure: Figure
    field: MaterialField
    """What the particles are made of, in main memory."""
    like: Shot
    """Whose scales are used."""

    def painter(self, view: str) -> Painter | None:
        """Who paints this view; None for its own colours."""
        film = self.like.painter(view)
        if film is None:
            return None
        return dataclasses.replace(film, field=self.field) if isinstance(film, Measured) else Mixed.of(self.field)

    def splats(self, state: State, view: str = "colour") -> Splats:
        """The picture of a state."""
        x, v, F = (t.detach().float().cpu() for t in (state.x, state.v, state.F))
        paint = self.painter(view)
        Fe = None if state.Fe is None else state.Fe.float().cpu()
        return self.figure(x, F, None if paint is None else paint(Moment(x, v, F, Fe)))
