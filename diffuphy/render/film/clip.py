"""The last stage: the film."""

import math
from dataclasses import dataclass, field
from typing import ClassVar, Literal

import torch
from torch import Tensor

from diffuphy.render.draw import render_gaussians
from diffuphy.render.film.around import Around, Scenery, with_scenery
from diffuphy.render.film.brush import Brush, brush, in_studio
from diffuphy.render.film.colormap import lay
from diffuphy.render.film.fillers import Fillers, with_fillers
from diffuphy.render.film.floor import Shadow, Studio, pool
from diffuphy.render.film.paint import Moment, check_view, wants_matter
from diffuphy.render.film.paths import path
from diffuphy.render.film.rigs import Resting, Rig, checked, frame_of
from diffuphy.render.film.video import contact_sheet
from diffuphy.render.image import Rasteriser
from diffuphy.render.kinematics import limited
from diffuphy.render.raster import Warp
from diffuphy.render.skin import Skin
from diffuphy.types import Camera, Clip, Gaussians, MaterialField, Particles, Trajectory
from diffuphy.workspace import Workspace


@dataclass(frozen=True)
class Film:
    """Films a trajectory: particles carry the Gaussians, the floor carries their shadow, a rig carries the camera."""

    VERSION: ClassVar[int] = 3

    width: int = 384
    """Width [px]; even, as video codecs need."""
    height: int = 384
    """Height [px]; even."""
    camera: Rig = field(default_factory=Resting)
    """What holds the camera: resting, on a turntable, following, in a captured place, or step by step."""
    view: str = "colour"
    """What is shown: colour, depth, normals, material, E, stress, J or velocity."""
    also: tuple[str, ...] = field(default=(), metadata={"runtime": True})
    """Further views of the same motion, each a film of its own beside the main one; none costs nothing."""
    legend: bool = True
    """Lay the scale of a view that has one into the picture."""
    floor: bool = True
    """Draw the floor at z = 0 and the shadow."""
    background: tuple[float, float, float] | Literal["transparent"] | None = None
    """One colour behind everything, rgb in [0, 1], or "transparent", for PNG and WebM; none is a soft studio
    backdrop."""
    shadow: float = 0.5
    """Darkness of the shadow under a thick body [-]; 0 draws none."""
    supersample: int = 1
    """Samples a side of a pixel; splats are band-limited already, so 1 suffices for all but stills."""
    neighbours: int = 1
    """Particles each Gaussian follows; 1 lets cracks open cleanly."""
    stretch: float = 3.0
    """A Gaussian is drawn at most this many times longer than at rest, and at most this many times as far from its
    particle [-]: flowing matter shears without bound, the patch of it that one Gaussian stands for does not."""
    slow: float = 1.0
    """Seconds in which a second of physical time is played [-]; 4 is slow motion, four times, and is smooth with
    scene.fps four times as high."""
    fillers: bool = True
    """Draw the inside of a body where it has opened (``render.film.fillers``)."""
    around: Around | None = None
    """What stands around the object and does not move; None is nothing but the studio."""
    backend: Rasteriser = field(default_factory=Warp)
    """The rasteriser."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "also", tuple(self.also))
        check_view(self.view, self.also)
        if self.width < 2 or self.height < 2 or self.width % 2 or self.height % 2:
            raise ValueError(f"width and height must be even and positive, got {self.width} x {self.height}")
        at_least_1 = (self.stretch, self.supersample, self.neighbours)
        if not all(a >= 1 for a in at_least_1):
            raise ValueError(f"stretch, supersample and neighbours must be at least 1, got {at_least_1}")
        if not 0 <= self.shadow <= 1:
            raise ValueError(f"shadow must be in [0, 1], got {self.shadow}")
        if not 0 < self.slow < math.inf:
            raise ValueError(f"slow must be positive, 1 is as fast as physics, got {self.slow}")
        if isinstance(self.background, str) and self.background != "transparent":
            raise ValueError(f'background must be [r, g, b], "transparent" or null, got {self.background!r}')

    @property
    def matter(self) -> bool:
        """Whether it asks for the material."""
        return wants_matter(self.view)

    def __call__(
        self,
        gaussians: Gaussians,
        particles: Particles,
        trajectory: Trajectory,
        field: MaterialField | None = None,
        *,
        work: Workspace,
    ) -> Clip:
        """One picture for each frame of the trajectory; ``field`` for views of the material."""
        with torch.no_grad():
            skin = Skin.bind(gaussians, particles, self.neighbours)
            skin, fillers = with_fillers(skin, particles) if self.fillers else (skin, None)
            skin = with_scenery(skin, self.around, particles)
            cameras = self.cameras(trajectory, particles)
            draws = brush(self.view, skin, cameras, trajectory, field)
            studio, shadow = self._studio(trajectory), self._shadow(trajectory, particles)
            empty = studio.empty(cameras) if len(cameras) == 1 else None
            frames, counts = len(trajectory.x), list[int]()
            picture = torch.empty(frames, self.height, self.width, 4 if self.background == "transparent" else 3)
            with work.bar(frames, "film") as bar:
                for t in range(frames):
                    camera = frame_of(cameras, t)
                    behind = studio.behind(empty or studio.empty(camera), shadow, trajectory.x[t])
                    picture[t], cut = self._frame(skin, fillers, Moment.of(trajectory, t), camera, behind, draws)
                    counts.append(cut)
                    work.log(t, limited=cut)
                    bar.update()
            if self.legend and (card := draws.legend(self.height)) is not None:
                picture = lay(picture, card)
            most = {"limited_frames": sum(n > 0 for n in counts), "limited_most": max(counts)}
            work.summary(most | {"gaussians": len(skin.gaussians), "particles": len(particles)})
            clip = Clip(picture[..., :3], trajectory.fps, self.slow, picture[..., 3] if picture.shape[3] > 3 else None)
            work.image("film", contact_sheet(clip.rgb, fps=trajectory.fps))
        return clip

    def cameras(self, trajectory: Trajectory, particles: Particles) -> Camera:
        """The camera, or that of every frame, at ``supersample`` times the size of the film."""
        s = self.supersample
        camera = self.camera(trajectory, particles, width=self.width * s, height=self.height * s, floor=self.floor)
        return checked(camera, len(trajectory.x))

    def _studio(self, trajectory: Trajectory) -> Studio:
        points = path(trajectory, floor=False)
        if in_studio(self.view):
            return Studio.around(points, floor=self.floor, background=self.background)
        return Studio.around(points, floor=False, background=self.background or (1.0, 1.0, 1.0))

    def _shadow(self, trajectory: Trajectory, particles: Particles) -> Shadow | None:
        if not (self.floor and self.shadow > 0 and in_studio(self.view)):
            return None
        return Shadow.over(trajectory.x, particles.vol, strength=self.shadow)

    def _frame(
        self,
        skin: Skin | Scenery,
        fillers: Fillers | None,
        now: Moment,
        camera: Camera,
        behind: tuple[Tensor, Tensor | None],
        draws: Brush,
    ) -> tuple[Tensor, int]:
        """One picture (H, W, 3), or (H, W, 4) where the background is transparent; and how many particles are drawn
        shorter than they are stretched."""
        F, cut = limited(now.F, self.stretch)
        gaussians, (means, F_g) = draws.gaussians(now), skin(now.x, F)
        if fillers is not None:
            gaussians, means, F_g = fillers.drawn(gaussians, means, F_g, now.x, now.F, now.Fe)
        image = render_gaussians(gaussians, camera, means=means, F=F_g, backend=self.backend)
        rest, (back, dark) = 1 - image.alpha[0], behind
        picture = draws.picture(image, camera) + rest[..., None] * back
        if dark is not None:
            picture = torch.cat([picture, (image.alpha[0] + rest * dark)[..., None]], dim=-1)
        return pool(picture, self.supersample).clamp(0, 1), cut
