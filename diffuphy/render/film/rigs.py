"""What holds the camera of a film: resting, on a turntable, following, in a captured place, or step by step.

A rig says for a whole motion where the camera is, once or in every frame; studio, floor and shadow follow it.
"""

import dataclasses
import math
from dataclasses import dataclass
from typing import Literal, Protocol, Self

import torch
from torch import Tensor

from diffuphy.render.cameras import direction, fit, intrinsics, look_at
from diffuphy.render.film.paths import boxes, path, smoothed
from diffuphy.types import Camera, Particles, Trajectory


class Rig(Protocol):
    """Holds the camera of a film."""

    def __call__(self, trajectory: Trajectory, particles: Particles, *, width: int, height: int, floor: bool) -> Camera:
        """One camera for all frames, or one a frame.

        Args:
            width, height: of the picture [px].
            floor: whether the floor is to be seen.
        """
        ...

    def turned(self, degrees: float) -> "Rig":
        """The same, seen from another side: turned about the vertical by ``degrees``, from +x towards +y."""
        ...


@dataclass(frozen=True)
class Sight:
    """Where a camera stands and how wide it sees."""

    azimuth: float = -60.0
    """Where the camera stands, from +x towards +y [deg]."""
    elevation: float = 14.0
    """How high it stands [deg]; low, so that heights above the floor read well."""
    fov: float = 32.0
    """Angle across the shorter side [deg]; about that of a portrait lens."""
    distance: float | None = None
    """Distance from what it looks at [m]; none frames the whole path of the object."""
    margin: float = 1.15
    """Size of the picture over the size of what it must show [-]."""

    def __post_init__(self) -> None:
        if not (-90 < self.elevation < 90 and 0 < self.fov < 180):
            raise ValueError(
                f"elevation must be in (-90, 90) and fov in (0, 180) degrees, got {self.elevation} and {self.fov}"
            )
        if self.distance is not None and self.distance <= 0:
            raise ValueError(f"distance must be positive [m] or none, got {self.distance}")
        if self.margin < 1:
            raise ValueError(f"margin must be at least 1, got {self.margin}")

    def turned(self, degrees: float) -> Self:
        return dataclasses.replace(self, azimuth=self.azimuth + degrees)

    def _reach(self, points: Tensor, R: Tensor, K: Tensor, width: int, height: int) -> Tensor:
        """Distance from which a camera that looks at the origin sees all ``points`` (..., M, 3).

        |X| ≤ t_x (Z + D) in camera axes, and likewise for Y:  D = max(|X|/t_x − Z, |Y|/t_y − Z).
        """
        if self.distance is not None:
            return points.new_tensor(self.distance)
        p = points @ R.mT
        slope = points.new_tensor([width, height]) / (2 * self.margin * torch.stack([K[0, 0], K[1, 1]]))
        return (p[..., :2].abs() / slope - p[..., 2:]).amax()


@dataclass(frozen=True)
class Resting(Sight):
    """Stands still and sees the whole motion, as near as it can."""

    def __call__(self, trajectory: Trajectory, particles: Particles, *, width: int, height: int, floor: bool) -> Camera:
        points = path(trajectory, floor=floor)
        return fit(
            points, self.azimuth, self.elevation, fov=self.fov, width=width, height=height, margin=self.margin,
            distance=self.distance,
        )  # fmt: skip


@dataclass(frozen=True)
class Turntable(Sight):
    """Goes round the middle of the motion at one height and distance, from which every frame shows the whole object."""

    degrees: float = 360.0
    """How far it goes, from +x towards +y [deg]; once round the whole film closes: it can be played in a loop."""
    per: Literal["film", "second"] = "film"
    """What ``degrees`` are of: the whole film, or a second of physical time."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.per not in ("film", "second") or not math.isfinite(self.degrees):
            raise ValueError(f'degrees must be finite and per "film" or "second", got {self.degrees} and "{self.per}"')

    def __call__(self, trajectory: Trajectory, particles: Particles, *, width: int, height: int, floor: bool) -> Camera:
        points = path(trajectory, floor=floor)
        frames = len(trajectory.x)
        step = self.degrees / (frames if self.per == "film" else trajectory.fps)
        out = direction(self.azimuth + step * torch.arange(frames), self.elevation).to(points)
        R = look_at(out, torch.zeros_like(out))[:, :3, :3]
        K = intrinsics(self.fov, width, height).to(points)
        middle = (points.amin(0) + points.amax(0)) / 2
        there = boxes(trajectory).movedim(1, 0)  # (T, 8, 3): what is in the picture at its own time
        if floor:
            there = torch.cat([there, points[-frames:, None]], dim=1)
        far = self._reach(there - middle, R, K, width, height)
        return Camera(look_at(middle + far * out, middle.expand_as(out)), K.expand(frames, 3, 3), width, height)


@dataclass(frozen=True)
class Follow(Sight):
    """Keeps its direction and travels with the object, whose middle it follows smoothly."""

    smoothing: float = 0.25
    """Standard deviation of the weights in time [s]; what is faster, a bounce say, is seen as a motion in the picture,
    what is slower is followed. Steady motion is followed without delay. 0 follows every twitch."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (math.isfinite(self.smoothing) and self.smoothing >= 0):
            raise ValueError(f"smoothing must not be negative [s], got {self.smoothing}")

    def __call__(self, trajectory: Trajectory, particles: Particles, *, width: int, height: int, floor: bool) -> Camera:
        target = smoothed(trajectory.x.mean(1), self.smoothing * trajectory.fps)
        out = direction(self.azimuth, self.elevation).to(target)
        R = look_at(out, torch.zeros_like(out))[:3, :3]
        K = intrinsics(self.fov, width, height).to(target)
        far = self._reach(boxes(trajectory) - target, R, K, width, height)
        frames = len(target)
        return Camera(look_at(target + far * out, target), K.expand(frames, 3, 3), width, height)


@dataclass(frozen=True)
class Increments:
    """Goes a step a frame in azimuth, elevation and radius about a point, as PhysGaussian's ``move_camera`` does.

    Beyond an elevation of 90° it comes down on the other side, and the picture turns over.
    """

    azimuth: float = -60.0
    """In the first frame, from +x towards +y [deg]."""
    elevation: float = 14.0
    """In the first frame [deg]."""
    radius: float = 2.0
    """Distance from ``center`` in the first frame [m]."""
    step: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Change of azimuth [deg], elevation [deg] and radius [m] from a frame to the next."""
    center: tuple[float, float, float] | None = None
    """Point that it looks at [m]; none is the middle of the object in the first frame."""
    fov: float = 32.0
    """Angle across the shorter side [deg]."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "step", tuple(map(float, self.step)))
        if self.center is not None:
            object.__setattr__(self, "center", tuple(map(float, self.center)))
        if not (-90 < self.elevation < 90 and 0 < self.fov < 180 and self.radius > 0):
            raise ValueError(
                "elevation must be in (-90, 90) degrees, fov in (0, 180) degrees and radius positive [m], got "
                f"{self.elevation}, {self.fov} and {self.radius}"
            )

    def turned(self, degrees: float) -> Self:
        return dataclasses.replace(self, azimuth=self.azimuth + degrees)

    def __call__(self, trajectory: Trajectory, particles: Particles, *, width: int, height: int, floor: bool) -> Camera:
        frames = len(trajectory.x) if any(self.step) else 1
        t = torch.arange(frames, dtype=torch.float64)
        azimuth, elevation, radius = (
            start + t * step for start, step in zip((self.azimuth, self.elevation, self.radius), self.step, strict=True)
        )
        if not bool((radius > 0).all()):
            k = int((radius <= 0).nonzero()[0])
            raise ValueError(
                f"in frame {k} the camera's radius is {float(radius[k]):g} m; it must stay positive: change camera.step"
            )
        x = trajectory.x
        middle = (x[0].amin(0) + x[0].amax(0)) / 2 if self.center is None else x.new_tensor(self.center)
        eye = middle + radius.to(x)[:, None] * direction(azimuth, elevation).to(x)
        K = intrinsics(self.fov, width, height).to(x)
        return Camera(look_at(eye, middle.expand_as(eye)), K.expand(frames, 3, 3), width, height)


def frame_of(camera: Camera, t: int) -> Camera:
    """The camera of frame ``t``: the only one of a resting rig, the t-th of a moving one."""
    return camera if len(camera) == 1 else camera[t : t + 1]


def checked(camera: Camera, frames: int) -> Camera:
    """Refuse a rig whose cameras are neither one nor one a frame.

    Raises:
        ValueError: with both numbers.
    """
    if len(camera) not in (1, frames):
        raise ValueError(f"a rig gives one camera or one a frame, got {len(camera)} for {frames} frames")
    return camera
