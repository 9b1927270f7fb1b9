"""What is played: particles in motion, the Gaussians that they carry, and colours."""

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np
import torch
from torch import Tensor

from diffuphy.formats.run import absorbed
from diffuphy.geometry import rotations
from diffuphy.mpm import State
from diffuphy.render import Skin
from diffuphy.render.film.around import Around, Scenery, with_scenery
from diffuphy.render.film.paint import PAINTED, Measured, Mixed, Moment, Painter, onto_gaussians, painter
from diffuphy.render.kinematics import limit_stretch
from diffuphy.render.sh import from_rgb, to_rgb
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


def _resting(g: Gaussians) -> tuple[Tensor, Tensor, Tensor]:
    """R S, colours seen from nowhere in particular (the constant term), and opacities."""
    axes = rotations(g.quats) * g.log_scales.exp()[:, None, :]
    return axes, to_rgb(g.sh).clamp(0, 1), g.logit_opacities.sigmoid()[:, None]


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
        axes, _, opacity = self._rest
        means, F_g = self._moved(x, F)
        M = F_g @ axes
        return Splats(*(t.float().numpy() for t in (means, M @ M.mT, self._rgb(colors), opacity)))

    def _rgb(self, colors: Tensor | None) -> Tensor:
        """Colours of Gaussians, of those that stay where they are too."""
        rgb = self._rest[1]
        if colors is None:
            return rgb
        tied = self.skin.skin if isinstance(self.skin, Scenery) else self.skin
        own = onto_gaussians(colors.to(rgb), tied.index, tied.weight)
        return torch.cat([own, rgb[len(own) :]])

    def gaussians(self, x: Tensor, F: Tensor, colors: Tensor | None = None) -> Gaussians:
        """The same as a result, in metres, with all harmonics of the film's own colours."""
        g = self.skin.gaussians
        made = absorbed(g, *self._moved(x, F))
        return made if colors is None else dataclasses.replace(made, sh=from_rgb(self._rgb(colors)))

    def _moved(self, x: Tensor, F: Tensor) -> tuple[Tensor, Tensor]:
        return self.skin(x, limit_stretch(F, self.stretch))


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

    def seen(self, t: int, view: str) -> tuple[Tensor, Tensor, Tensor | None]:
        """Places, deformations and colours of the particles in frame ``t``, what a figure is made of."""
        paint, now = self.painter(view), Moment.of(self.trajectory, t)
        return now.x, now.F, None if paint is None else paint(now)


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

    def seen(self, state: State, view: str) -> tuple[Tensor, Tensor, Tensor | None]:
        """Places, deformations and colours of the particles in a state, what a figure is made of."""
        x, v, F = (t.detach().float().cpu() for t in (state.x, state.v, state.F))
        paint = self.painter(view)
        Fe = None if state.Fe is None else state.Fe.float().cpu()
        return x, F, None if paint is None else paint(Moment(x, v, F, Fe))
