"""The last stage: the film."""

from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from diffuphy.render.around import Around, Scenery, with_scenery
from diffuphy.render.cameras import fit
from diffuphy.render.draw import render_gaussians
from diffuphy.render.fillers import Fillers, drawn
from diffuphy.render.floor import Backdrop, Shadow, backdrop, pool
from diffuphy.render.image import Rasteriser
from diffuphy.render.kinematics import limit_stretch
from diffuphy.render.raster import Warp
from diffuphy.render.skin import Skin
from diffuphy.types import Camera, Clip, Gaussians, Particles, Trajectory
from diffuphy.workspace import Workspace

STRAYS = 0.005
"""Share of the particles at each edge of the object that framing ignores, so that a crumb flung far away does not
shrink the film."""


@dataclass(frozen=True)
class Film:
    """Films a trajectory with one resting camera: particles carry the Gaussians, the floor carries their shadow."""

    VERSION: ClassVar[int] = 2

    width: int = 384
    """Width [px]; even, as video codecs need."""
    height: int = 384
    """Height [px]; even."""
    azimuth: float = -60.0
    """Where the camera stands, from +x towards +y [deg]."""
    elevation: float = 14.0
    """How high it stands [deg]; low, so that heights above the floor read well."""
    fov: float = 32.0
    """Angle across the shorter side [deg]; about that of a portrait lens."""
    distance: float | None = None
    """Distance from the middle of the motion [m]; none frames the whole path of the object."""
    margin: float = 1.15
    """Size of the picture over the size of what it must show [-]."""
    floor: bool = True
    """Draw the floor at z = 0 and the shadow."""
    background: tuple[float, float, float] | None = None
    """One colour behind everything, rgb in [0, 1]; none is a soft studio backdrop."""
    shadow: float = 0.5
    """Darkness of the shadow under a thick body [-]; 0 draws none."""
    supersample: int = 1
    """Samples a side of a pixel; splats are band-limited already, so 1 suffices for all but stills."""
    neighbours: int = 1
    """Particles each Gaussian follows; 1 lets cracks open cleanly."""
    stretch: float = 3.0
    """A Gaussian is drawn at most this many times longer than at rest [-]: flowing matter shears without bound, the
    patch of it that one Gaussian stands for does not."""
    fillers: bool = True
    """Draw the inside of a body where it has opened (``render.fillers``)."""
    around: Around | None = None
    """What stands around the object and does not move; None is nothing but the studio."""
    backend: Rasteriser = field(default_factory=Warp)
    """The rasteriser."""

    def __post_init__(self) -> None:
        if self.width < 2 or self.height < 2 or self.width % 2 or self.height % 2:
            raise ValueError(f"width and height must be even and positive, got {self.width} x {self.height}")
        if not (-90 < self.elevation < 90 and 0 < self.fov < 180):
            raise ValueError(
                f"elevation must be in (-90, 90) and fov in (0, 180) degrees, got {self.elevation} and {self.fov}"
            )
        if self.distance is not None and self.distance <= 0:
            raise ValueError(f"distance must be positive [m] or none, got {self.distance}")
        if self.margin < 1 or self.stretch < 1 or self.supersample < 1 or self.neighbours < 1:
            raise ValueError(f"margin, stretch, supersample and neighbours must be at least 1, got {self}")
        if not 0 <= self.shadow <= 1:
            raise ValueError(f"shadow must be in [0, 1], got {self.shadow}")

    def __call__(self, gaussians: Gaussians, particles: Particles, trajectory: Trajectory, *, work: Workspace) -> Clip:
        """One picture for each frame of the trajectory."""
        with torch.no_grad():
            skin = Skin.bind(gaussians, particles, self.neighbours)
            fillers = Fillers.of(skin.gaussians, particles) if self.fillers else None
            skin = with_scenery(skin, self.around, particles)
            camera = self.camera(trajectory)
            studio = self._studio(camera, trajectory)
            shadow = (
                Shadow.over(trajectory.x, particles.vol, strength=self.shadow)
                if self.floor and self.shadow > 0
                else None
            )
            frames = len(trajectory.x)
            rgb, cut = torch.empty(frames, self.height, self.width, 3), []
            with work.bar(frames, "film") as bar:
                for t in range(frames):
                    x, F = trajectory.x[t], trajectory.F[t]
                    rgb[t], limited, opened = self._frame(skin, fillers, x, F, camera, studio, shadow)
                    work.log(t, limited=limited, fillers=opened)
                    cut.append(limited)
                    bar.update()
            work.summary(_limited(cut, len(skin.gaussians) + (len(fillers.index) if fillers else 0)))
            work.image("film", contact_sheet(rgb, fps=trajectory.fps))
        return Clip(rgb, trajectory.fps)

    def camera(self, trajectory: Trajectory) -> Camera:
        """The resting camera, at ``supersample`` times the size of the film."""
        s = self.supersample
        return fit(
            path(trajectory, floor=self.floor),
            self.azimuth,
            self.elevation,
            fov=self.fov,
            width=self.width * s,
            height=self.height * s,
            margin=self.margin,
            distance=self.distance,
        )

    def _studio(self, camera: Camera, trajectory: Trajectory) -> Backdrop:
        points = path(trajectory, floor=False)
        centre = (points.amin(0) + points.amax(0)) / 2
        size = float((points.amax(0) - points.amin(0)).amax().clamp_min(1e-6))
        studio = backdrop(camera, centre[:2], size, floor=self.floor)
        if self.background is None:
            return studio
        plain = studio.rgb.new_tensor(self.background).expand_as(studio.rgb)
        return Backdrop(plain, studio.ground, studio.solid)

    def _frame(
        self,
        skin: Skin | Scenery,
        fillers: Fillers | None,
        x: Tensor,
        F: Tensor,
        camera: Camera,
        studio: Backdrop,
        shadow: Shadow | None,
    ) -> tuple[Tensor, int, int]:
        """The picture, how many Gaussians are drawn shorter than they are, and how many fillers."""
        behind = studio.rgb
        if shadow is not None:
            behind = behind * (1 - studio.solid * (1 - shadow.cast(x, studio.ground)))[..., None]
        gaussians, means, F_g, opened = drawn(skin, fillers, x, F)
        F_g, limited = limit_stretch(F_g, self.stretch)
        image = render_gaussians(gaussians, camera, means=means, F=F_g, background=behind, backend=self.backend)
        return pool(image.rgb[0], self.supersample).clamp(0, 1), limited, opened


def _limited(cut: list[int], gaussians: int) -> dict[str, float]:
    """What the summary says of Gaussians that ``stretch`` limits, from their number in each frame."""
    return {"limited_frames": sum(n > 0 for n in cut), "limited_most": max(cut), "gaussians": gaussians}


def path(trajectory: Trajectory, *, floor: bool) -> Tensor:
    """Points (M, 3) [m] that the film must show: a box around the object at each frame and, if asked, the floor
    below it."""
    x = trajectory.x
    edges = torch.quantile(x.float(), x.new_tensor([STRAYS, 1 - STRAYS]).float(), dim=1).to(x)  # (2, T, 3)
    corners = torch.cartesian_prod(*[torch.arange(2, device=x.device)] * 3)  # (8, 3)
    boxes = edges[corners, :, torch.arange(3, device=x.device)]  # (8, 3, T)
    points = boxes.movedim(1, -1).reshape(-1, 3)
    if not floor:
        return points
    below = x.mean(1)
    below[:, 2] = 0
    return torch.cat([points, below])


def to_bytes(rgb: Tensor) -> np.ndarray:
    """Values in [0, 1] as 8-bit integers."""
    return (rgb.detach().clamp(0, 1) * 255).round().to(torch.uint8).cpu().numpy()


def write_mp4(path: Path | str, rgb: Tensor, fps: float) -> None:
    """Write frames (T, H, W, 3) in [0, 1] as an H.264 film that every browser plays (yuv420p, index at the front).

    Raises:
        ValueError: an odd side, no frame, or fps that is not positive.
    """
    import imageio_ffmpeg

    frames, height, width, _ = rgb.shape
    if frames < 1 or height % 2 or width % 2:
        raise ValueError(
            f"a film needs at least one frame and even sides, got {frames} frames of {width} x {height} px"
        )
    if not fps > 0:
        raise ValueError(f"fps must be positive, got {fps}")
    writer = imageio_ffmpeg.write_frames(
        str(path),
        (width, height),
        fps=float(Fraction(fps).limit_denominator(1001)),
        codec="libx264",
        pix_fmt_out="yuv420p",
        quality=None,
        macro_block_size=2,
        output_params=["-crf", "18", "-preset", "medium", "-movflags", "+faststart"],
    )
    writer.send(None)
    try:
        for frame in rgb:
            writer.send(np.ascontiguousarray(to_bytes(frame)))
    finally:
        writer.close()


def write_png(path: Path | str, rgb: Tensor) -> None:
    """Write one picture (H, W, 3) in [0, 1]."""
    from PIL import Image

    Image.fromarray(to_bytes(rgb)).save(path)


def contact_sheet(rgb: Tensor, columns: int = 4, frames: int = 8, *, fps: float | None = None) -> Tensor:
    """Evenly spaced frames of (T, H, W, 3), first and last included, as one picture; with ``fps`` each bears its
    time [s]."""
    from PIL import Image, ImageDraw

    count = min(frames, len(rgb))
    columns = min(columns, count)
    chosen = [round(k * (len(rgb) - 1) / max(count - 1, 1)) for k in range(count)]
    height, width = rgb.shape[1:3]
    sheet = Image.new("RGB", (columns * width, -(-count // columns) * height), "white")
    for k, t in enumerate(chosen):
        picture = Image.fromarray(to_bytes(rgb[t]))
        if fps is not None:
            ImageDraw.Draw(picture).text((6, 4), f"{t / fps:.2f} s", fill=(60, 60, 60))
        sheet.paste(picture, (k % columns * width, k // columns * height))
    return torch.from_numpy(np.array(sheet)).to(torch.float32) / 255
