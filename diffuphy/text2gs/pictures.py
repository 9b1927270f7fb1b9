"""Pictures of one's own as the prior of the object: the fit with an exact score whose only reference they are."""

import dataclasses
import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import torch
from torch import Tensor

from diffuphy.losses.guidance.analytic import Analytic
from diffuphy.render import Rasteriser, render_gaussians
from diffuphy.render.scenes.photographs import Shot, files, resized, rgba, shots
from diffuphy.render.scenes.placement import Axis, Placement
from diffuphy.render.scenes.ply import Up, upright_turn
from diffuphy.text2gs.fit import FitGaussians
from diffuphy.text2gs.hull import Hull, HullCloud, hull
from diffuphy.text2gs.normalise import check_turns
from diffuphy.types import Camera, Gaussians, Look

RGB = tuple[float, float, float]


@dataclass(frozen=True)
class Pictures:
    """Pictures of an object with their cameras: the references of the analytic guidance, and the cameras of the fit.

    The object is what is not transparent, or not of the colour of the background. Its visual hull says where it is: it
    is centred, its longest side 2, z up.
    """

    VERSION: ClassVar[int] = 1
    ring: ClassVar[int] = 1

    path: str = field(metadata={"content": files})
    """A folder with transforms.json, transforms_train.json or cameras.json, and the pictures that it names."""
    up: Up = "z_up"
    """Which way is up for the cameras; z_up is NeRF's synthetic scenes, y_down what COLMAP leaves."""
    turns: tuple[tuple[Axis, float], ...] = ()
    """Further rotations about the then upright axes, [axis, angle [deg]], the first one first."""
    size: int = 96
    """Longer side of the pictures in the fit [px]."""
    background: RGB | None = None
    """Colour behind the object in pictures without transparency, rgb in [0, 1]; None refuses such pictures."""
    hold: int = 8
    """Every so manieth picture is not fitted but compared with at the end, if the scene itself has none for that; 0:
    none is held out."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "turns", check_turns(self.turns))
        upright_turn(self.up)
        if self.background is not None:
            object.__setattr__(self, "background", tuple(map(float, self.background)))
            if len(self.background) != 3 or not all(0 <= c <= 1 for c in self.background):
                raise ValueError(f"background must be three numbers in [0, 1], got {self.background}")
        if self.size < 8 or self.hold < 0 or self.hold == 1:
            raise ValueError(f"size must be at least 8 px and hold 0 or at least 2, got {self.size} and {self.hold}")
        if self.bank < 3:
            raise ValueError(f"{self.path} has {self.bank} pictures to fit; an object needs at least 3")

    def __call__(self, look: Look | None = None, camera: Camera | None = None, background: Tensor | None = None) -> Any:
        """The cameras of the fit; or, as references, their pictures (C, 1, H, W, 3) over a background, and None.

        Args:
            look: not used: there is one object.
            camera: some of those cameras.
            background: rgb, shape (3,).
        """
        if camera is None or background is None:
            return self._scene[1][self._fitted]
        pictures, _, _ = self._scene
        index = [self._index[view.tobytes()] for view in camera.viewmats.detach().cpu().numpy()]
        found = pictures[index].to(camera.viewmats.device)
        return over(found, background.to(found))[:, None], None

    @property
    def bank(self) -> int:
        """Pictures that are fitted."""
        return len(self._fitted)

    @property
    def held(self) -> int:
        """Pictures that are held out."""
        return len(self._shots) - self.bank

    @property
    def hull(self) -> Hull:
        """The visual hull."""
        return self._scene[2]

    @property
    def distance(self) -> float:
        """Mean distance of the cameras from the middle of the object [object units]."""
        views = self._scene[1].viewmats
        return float((views[:, :3, :3].mT @ views[:, :3, 3:])[..., 0].norm(dim=1).mean())

    @property
    def fov(self) -> float:
        """Angle across the shorter side of the first picture [deg]."""
        camera = self._scene[1]
        short, f = min((camera.width, float(camera.Ks[0, 0, 0])), (camera.height, float(camera.Ks[0, 1, 1])))
        return 2 * math.degrees(math.atan(short / (2 * f)))

    @property
    def pixel(self) -> float:
        """Side of a pixel of the fit at the origin [object units]."""
        camera = self._scene[1]
        return 2.0 * self.distance * math.tan(math.radians(self.fov) / 2) / min(camera.width, camera.height)

    def judge(self, gaussians: Gaussians, backend: Rasteriser) -> dict[str, float]:
        """Mean PSNR over white of the pictures that were held out, and of those that were fitted [dB]."""
        pictures, cameras, _ = self._scene
        held = [i for i in range(len(self._shots)) if i not in set(self._fitted)]
        white = torch.ones(3, device=gaussians.means.device)
        scores = {}
        for name, some in (("held_out", held), ("fitted", self._fitted)):
            values = []
            for i in some:
                drawn = render_gaussians(gaussians, cameras[[i]].to(white.device), background=white, backend=backend)
                error = (drawn.rgb[0].clamp(0, 1) - over(pictures[[i]].to(white), white)[0]).square().mean()
                values.append(-10 * math.log10(float(error)))
            if values:
                scores[f"psnr_{name}"] = sum(values) / len(values)
        return scores

    @cached_property
    def _shots(self) -> tuple[Shot, ...]:
        return shots(self.path)

    @cached_property
    def _fitted(self) -> list[int]:
        """Numbers of the pictures that are fitted."""
        if any(shot.held for shot in self._shots):
            return [i for i, shot in enumerate(self._shots) if not shot.held]
        return [i for i in range(len(self._shots)) if not self.hold or i % self.hold]

    @cached_property
    def _index(self) -> dict[bytes, int]:
        """Number of each picture by its camera."""
        return {view.tobytes(): i for i, view in enumerate(self._scene[1].viewmats.numpy())}

    @cached_property
    def _scene(self) -> tuple[Tensor, Camera, Hull]:
        """Pictures (n, H, W, 4), premultiplied; cameras and hull in the frame of the object."""
        sides = {(s.camera.width, s.camera.height) for s in self._shots}
        if len(sides) > 1:
            raise ValueError(f"{self.path} has pictures of {len(sides)} sizes, {sorted(sides)[:3]} px; one is allowed")
        ((w, h),) = sides
        width, height = (max(1, round(self.size * side / max(w, h))) for side in (w, h))
        pictures = torch.stack([rgba(shot, width, height, self.background) for shot in self._shots])
        views, Ks = (torch.cat([getattr(s.camera, n) for s in self._shots]) for n in ("viewmats", "Ks"))
        cameras = resized(Camera(views, Ks, w, h), width, height)
        for turn in (Placement.turns([("x", 90.0 * upright_turn(self.up))]), Placement.turns(self.turns)):
            cameras = turn.camera(cameras)
        found = hull(pictures[self._fitted][..., 3], cameras[self._fitted])
        low, high = found.box
        scale = 2.0 / float((high - low).amax())
        place = Placement(Placement.turns(()).quat, scale, -scale * (low + high) / 2)
        centred = dataclasses.replace(found, cells=scale * found.cells + place.shift, side=scale * found.side)
        return pictures, place.camera(cameras), centred


def over(premultiplied: Tensor, background: Tensor) -> Tensor:
    """Pictures (..., 4) over a colour, shape (..., 3)."""
    return premultiplied[..., :3] + (1 - premultiplied[..., 3:]) * background


def images(
    path: str,
    up: Up = "z_up",
    turns: tuple[tuple[Axis, float], ...] = (),
    size: int = 96,
    background: RGB | None = None,
    hold: int = 8,
    count: int = 3000,
    **fit: Any,
) -> FitGaussians:
    """The fit of Gaussians to pictures of one's own: score distillation of a prior that knows them alone.

    With one reference a camera the score is exact and the noise cancels, ε̂ − ε = (α/σ)(z − r) for s = 0: a weighted
    least-squares reconstruction (``Analytic``).

    Args:
        path, up, turns, size, background, hold: of ``Pictures``.
        count: Gaussians to start with, on the visual hull.
        fit: settings of ``FitGaussians``.
    """
    pictures = Pictures(path, up, tuple(turns), size, background, hold)
    guidance = Analytic(references=pictures)
    return FitGaussians(guidance=guidance, cameras=pictures, init=HullCloud(pictures, count), judge=pictures, **fit)
