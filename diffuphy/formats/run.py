"""What a finished run holds, loaded when it is asked for."""

import re
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from diffuphy.render import sh as harmonics
from diffuphy.render.film.around import Around, scenery, together
from diffuphy.render.film.views import Views
from diffuphy.render.kinematics import limit_stretch
from diffuphy.render.skin import Skin
from diffuphy.types import Clip, Gaussians, MaterialField, Particles, Trajectory

STRETCH = 3.0
"""Longest a Gaussian is written, over its length at rest [-]; that of ``Film.stretch``."""


@dataclass(frozen=True)
class Run:
    """The results of a run and what a file should say about them."""

    results: dict[str, Path]
    """Folder of each result, by stage."""
    title: str = ""
    """The prompt."""
    neighbours: int = 1
    """Particles each Gaussian follows, as in the film."""
    around: Around | None = None
    """Who knows what stands around the object, as in the film; None: nothing does."""

    @classmethod
    def at(cls, folder: Path) -> "Run":
        """The run in a folder of ``outputs/runs``.

        Raises:
            ValueError: no run there.
        """
        found: dict[str, Path] = {}
        for entry in sorted(folder.iterdir()) if folder.is_dir() else []:
            if match := re.fullmatch(r"\d+_([a-z]+)(\.path\.txt)?", entry.name):
                found[match[1]] = folder / entry.read_text(encoding="utf-8").strip() if match[2] else entry
        if not found:
            raise ValueError(f"{folder} is no run: it has no links 1_prompt to 6_clip; name a folder of outputs/runs")
        settings = folder / ".hydra" / "config.yaml"
        title, around = "", None
        if settings.exists():
            from omegaconf import OmegaConf

            from diffuphy.composing import make

            config = OmegaConf.load(settings)
            title, known = str(config.prompt), OmegaConf.select(config, "stages.clip.around")
            if known is not None:
                around = make({"around": OmegaConf.to_container(known, resolve=True)})["around"]
        return cls({name: path.resolve() for name, path in found.items()}, title, around=around)

    def load(self, stage: str, kind: Any) -> Any:
        """The result of a stage.

        Raises:
            ValueError: the run has ended before.
        """
        if stage not in self.results:
            raise ValueError(
                f"the run has no {stage}: it ended with {list(self.results)[-1]}; continue it without until="
            )
        return kind.load(self.results[stage])

    @cached_property
    def gaussians(self) -> Gaussians:
        return self.load("gaussians", Gaussians)

    @cached_property
    def particles(self) -> Particles:
        return self.load("particles", Particles)

    @cached_property
    def field(self) -> MaterialField:
        return self.load("material", MaterialField)

    @cached_property
    def trajectory(self) -> Trajectory:
        return self.load("trajectory", Trajectory)

    @cached_property
    def clip(self) -> Clip:
        return self.load("clip", Clip)

    @cached_property
    def views(self) -> Views | None:
        """Further films; None where the run has none."""
        return Views.load(self.results["views"]) if "views" in self.results else None

    @cached_property
    def skin(self) -> Skin:
        return Skin.bind(self.gaussians, self.particles, self.neighbours)

    @torch.no_grad()
    def moved(self, t: int) -> tuple[Tensor, Tensor]:
        """Centres (G, 3) [m] and deformations (G, 3, 3), no longer than ``STRETCH``, of the Gaussians of ``skin`` in
        frame ``t``."""
        return self.skin(self.trajectory.x[t], limit_stretch(self.trajectory.F[t], STRETCH))

    @cached_property
    def still(self) -> Gaussians | None:
        """What stands around the object, in metres, z up; None where there is nothing."""
        return scenery(self.around, self.particles)

    def frame(self, t: int, still: bool = True) -> Gaussians:
        """The Gaussians of frame ``t`` as such: in metres, z up, deformation absorbed in size and orientation; then
        those that stand around the object, unless ``still`` is False."""
        now = absorbed(self.skin.gaussians, *self.moved(t))
        return now if not still or self.still is None else together(now, self.still)

    def comment(self) -> str:
        """What metadata say besides the title."""
        return said(self.title, self.trajectory.fps, self.clip.slow if "clip" in self.results else 1.0)


def said(title: str, fps: float, slow: float, view: str = "colour") -> str:
    """Who made a film, from what, and how fast it is played."""
    from diffuphy import __version__

    speed = "real time" if slow == 1.0 else (f"slow motion {slow:g}x" if slow > 1 else f"time lapse {1 / slow:g}x")
    parts = [
        f"diffuphy {__version__}",
        f"prompt: {title}" if title else "",
        f"{fps:g} frames a second of physical time",
    ]
    parts += [f"played at {fps / slow:g} frames a second, {speed}", "" if view == "colour" else f"view: {view}"]
    return "; ".join(part for part in parts if part)


def absorbed(g: Gaussians, means: Tensor, F: Tensor) -> Gaussians:
    """Gaussians whose deformation is part of them.

        Σ = F A Fᵀ = (F R S)(F R S)ᵀ,   F R S = U diag(s) Vᵀ   ⇒   scales s, orientation U

    Colours turn with the rotation of F (polar decomposition), as they do in the film.

    Args:
        means: centres (G, 3). F: deformation gradients (G, 3, 3), det F > 0.
    """
    from diffuphy.geometry import rotations

    M = F.double() @ rotations(g.quats.double()) * g.log_scales.double().exp()[:, None, :]
    U, s, _ = torch.linalg.svd(M)
    U = torch.cat([U[..., :2], U[..., 2:] * torch.linalg.det(U)[:, None, None]], dim=-1)
    quats = torch.from_numpy(Rotation.from_matrix(U.cpu().numpy()).as_quat(scalar_first=True))
    sh = g.sh if harmonics.degree_of(g.sh) == 0 else harmonics.rotate(g.sh, harmonics.polar(F))
    return replace(g, means=means, quats=quats.to(g.quats), log_scales=s.log().to(g.log_scales), sh=sh)
