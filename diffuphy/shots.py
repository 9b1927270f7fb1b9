"""What an evaluation looks at: the film from other sides and in other sizes, silhouettes, a turntable."""

import dataclasses
from dataclasses import dataclass

import torch
from torch import Tensor

from diffuphy.render import orbit, render_gaussians
from diffuphy.render.film.clip import Film
from diffuphy.render.film.floor import Studio
from diffuphy.render.film.rigs import frame_of
from diffuphy.render.kinematics import limit_stretch
from diffuphy.render.skin import Skin
from diffuphy.types import Camera, Gaussians, Particles, Trajectory
from diffuphy.workspace import Workspace

ELEVATION, DISTANCE = 15.0, 3.4
"""Where the turntable's cameras stand: above the horizon [deg] and from the middle [object units]; the object, 2 units
long, fills most of the picture."""


@dataclass(frozen=True)
class Shot(Film):
    """A film whose camera and studio are those of another motion: two films that differ by their matter alone."""

    of: Trajectory | None = None
    """The motion that the camera frames; None is the one that is filmed."""

    def cameras(self, trajectory: Trajectory, particles: Particles) -> Camera:
        return super().cameras(self.of or trajectory, particles)

    def _studio(self, trajectory: Trajectory) -> Studio:
        return super()._studio(self.of or trajectory)

    @classmethod
    def like(cls, film: Film, of: Trajectory, **changes: object) -> "Shot":
        """``film`` in its own colours on something opaque, with other settings, framed for ``of``."""
        settings = {f.name: getattr(film, f.name) for f in dataclasses.fields(Film)} | {"view": "colour", "also": ()}
        if film.background == "transparent":
            settings["background"] = (1.0, 1.0, 1.0)
        return cls(**settings | changes, of=of)  # type: ignore[arg-type]

    def reduced(self, side: int) -> "Shot":
        """The same picture with a shorter side of at most ``side`` pixels, even."""
        scale = min(1.0, side / min(self.width, self.height))
        width, height = (max(2, 2 * round(n * scale / 2)) for n in (self.width, self.height))
        return dataclasses.replace(self, width=width, height=height)

    def pictures(self, gaussians: Gaussians, particles: Particles, trajectory: Trajectory) -> Tensor:
        """Frames (T, H, W, 3) in [0, 1]."""
        return self(gaussians, particles, trajectory, work=Workspace()).rgb

    @torch.no_grad()
    def cover(self, gaussians: Gaussians, particles: Particles, trajectory: Trajectory) -> Tensor:
        """Coverage of the object in each frame, without floor and shadow, shape (T, H, W)."""
        plain = dataclasses.replace(self, supersample=1)
        skin, cameras = Skin.bind(gaussians, particles, self.neighbours), plain.cameras(trajectory, particles)
        frames = []
        for t, (x, F) in enumerate(zip(trajectory.x, trajectory.F, strict=True)):
            camera, (means, F_g) = frame_of(cameras, t), skin(x, limit_stretch(F, self.stretch))
            frames.append(render_gaussians(skin.gaussians, camera, means=means, F=F_g, backend=self.backend).alpha[0])
        return torch.stack(frames).clamp(0, 1)


@dataclass(frozen=True)
class Turntable:
    """The object at rest, from all round, on white."""

    camera: Camera
    azimuth: Tensor
    """Of each view, from the front [deg], shape (n,)."""
    rgb: Tensor
    """Pictures (n, S, S, 3) in [0, 1]."""
    cover: Tensor
    """Coverage of the object, (n, S, S)."""

    @classmethod
    @torch.no_grad()
    def of(cls, gaussians: Gaussians, views: int, side: int) -> "Turntable":
        azimuth = torch.arange(views) * (360 / views)
        camera = orbit(azimuth, ELEVATION, DISTANCE, width=side, height=side).to(gaussians.means.device)
        image = render_gaussians(gaussians, camera)
        return cls(camera, azimuth, image.over(torch.ones_like(image.rgb[0, 0, 0])).clamp(0, 1), image.alpha)
