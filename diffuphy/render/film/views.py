"""The stage beside the line that films the same motion in further views."""

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from diffuphy.render.film.clip import Film
from diffuphy.types import Clip, Gaussians, MaterialField, Particles, Result, Trajectory
from diffuphy.workspace import Workspace


@dataclass(frozen=True)
class Views(Result):
    """Films of one motion, by view."""

    rgb: dict[str, Tensor]
    """Frames of 8 bit, shape (T, H, W, 3), or with coverage (T, H, W, 4)."""
    fps: float
    """Frames per second of physical time [1/s]."""
    slow: float = 1.0
    """Seconds in which a second of physical time is played [-]."""

    def clip(self, name: str) -> Clip:
        """One of them."""
        values = self.rgb[name].float() / 255
        return Clip(values[..., :3], self.fps, self.slow, values[..., 3] if values.shape[3] == 4 else None)


@dataclass(frozen=True)
class OtherViews:
    """Films a motion once more for each of some views, with the same camera in the same studio."""

    VERSION: ClassVar[int] = 1

    film: Film
    """How; its own view does not matter."""
    names: tuple[str, ...]
    """Views."""

    @classmethod
    def of(cls, film: Film) -> "OtherViews":
        """Those that a film asks for besides its own."""
        return cls(dataclasses.replace(film, view="colour", also=()), film.also)

    def __call__(
        self, gaussians: Gaussians, particles: Particles, trajectory: Trajectory, field: MaterialField, *,
        work: Workspace,
    ) -> Views:  # fmt: skip
        """The films of all views."""
        plain = Workspace(progress=work.progress, device=work.device)
        films: dict[str, Tensor] = {}
        for name in self.names:
            film = dataclasses.replace(self.film, view=name)
            clip = film(gaussians, particles, trajectory, field if film.matter else None, work=plain)
            parts = [clip.rgb] if clip.alpha is None else [clip.rgb, clip.alpha[..., None]]
            films[name] = (torch.cat(parts, dim=-1) * 255).round().to(torch.uint8)
        return Views(films, trajectory.fps, self.film.slow)
