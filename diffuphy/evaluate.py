"""The stage beside the line that scores a film; what each number means: ``docs/metrics.md``.

Numbers that need no weights come with every film: physical checks, silhouettes, colours, likeness to the embedded
prior. Those of the paper (DiffuPhyGS, §4.1 and A.2) come where their weights are on the machine, and those that compare
with an untrained network where its films are asked for: each costs another trajectory. The plan decides and says why.
"""

import dataclasses
import logging
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import torch
from torch import Tensor

from diffuphy.material.net import Untrained
from diffuphy.metrics import picture
from diffuphy.metrics.book import Book
from diffuphy.metrics.frechet import frechet, kernel, windows
from diffuphy.metrics.language import clipsim, front_everywhere, janus
from diffuphy.metrics.physics import World
from diffuphy.metrics.score import Scores, estimate
from diffuphy.metrics.structure import psnr, ssim, ssim_object
from diffuphy.mpm.boundary import HalfSpace
from diffuphy.mpm.scene import Scene
from diffuphy.mpm.trajectory import Simulate
from diffuphy.render.film.clip import Film
from diffuphy.shots import Shot, Turntable
from diffuphy.types import Clip, Gaussians, Look, MaterialField, Motion, Particles, SimulationDiverged, Trajectory
from diffuphy.workspace import Workspace

log = logging.getLogger(__name__)

WITH_WORDS = ("CLIPSIM", "Janus")
WITH_REFERENCE = ("Diff_SSIM", "Diff_SSIM (object)")
WITH_BOTH = ("CLIPSIM′", "Diff_CLIP")
WITH_VIDEO = ("FVD", "KVD")


@dataclass(frozen=True)
class Evaluate:
    """Scores a film by everything that this machine can compute."""

    VERSION: ClassVar[int] = 2

    score: Literal["on", "off"] = "on"
    """``off`` leaves the stage out."""
    encoder: Any = None
    """Embeds pictures and words (``metrics.encoder.OpenClip``): CLIPSIM, Diff_CLIP, Janus."""
    aesthetic: Any = None
    """Scores pictures (``metrics.aesthetic.Aesthetic``): LAION."""
    video: Any = None
    """Features of clips (``metrics.i3d.I3D``, ``metrics.videomae.VideoMAE`` or any that has ``frames``, ``missing``
    and a call): FVD and KVD."""
    references: tuple[int, ...] = ()
    """Seeds of untrained material networks whose films are compared with; three make an error bar, each costs a
    film."""
    views: int = 8
    """Views of the turntable; at least four, so that one is from behind."""
    side: int = 128
    """Shorter side of silhouettes, turntable and the clips of FVD [px]; 224 is what CLIP and I3D look at."""
    cameras: int = 4
    """Sides from which clips for FVD are filmed: each gives about as many clips as the film has frames."""
    stride: int = 1
    """Frames between the starts of two clips for FVD."""
    scene: Simulate | None = None
    """How the film was simulated; left open: as the run does it."""
    film: Film | None = None
    """How it was filmed; left open: as the run does it."""
    material: Any = None
    """The material stage, whose untrained network is the reference; left open: that of the run. A rival's run names
    ours, so that all methods are compared with one reference."""
    prior: Any = None
    """``prior(look, camera, background) -> (pictures (C, K, H, W, 3), log-prior (K,))`` of the embedded prior; left
    open: the one that the Gaussians were made with, if it was."""
    absent: Mapping[str, str] = field(default_factory=dict)
    """Why a metric is left out, by its name; the plan's."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "references", tuple(self.references))
        if self.views < 4 or self.side < 16 or self.side % 2:
            raise ValueError(
                f"views must be at least 4 and side even and at least 16 px, got {self.views} and {self.side}"
            )
        if self.cameras < 1 or self.stride < 1:
            raise ValueError(f"cameras and stride must be at least 1, got {self.cameras} and {self.stride}")
        if len(set(self.references)) < len(self.references):
            raise ValueError(f"references must be different seeds, got {self.references}")

    # ------------------------------------------------------------------ plan
    def planned(self, components: Mapping[str, Any]) -> "Evaluate":
        """With the open settings taken from the run, and without what cannot be computed here."""
        why: dict[str, str] = {}
        networks = {"encoder": WITH_WORDS + WITH_BOTH, "aesthetic": ("LAION",), "video": WITH_VIDEO}
        usable = {}
        for name, metrics in networks.items():
            network = getattr(self, name)
            reason = f"evaluate.{name}=null" if network is None else network.missing()
            usable[name] = None if reason else network
            why |= dict.fromkeys(metrics, reason) if reason else {}
        references = self.references if hasattr(self.material or components["material"], "net") else ()
        if not references:
            reason = "evaluate.references=[]: each seed, of a network that was never trained, costs another film"
            if self.references:
                reason = "the material is given: no network was trained that could be compared with an untrained one"
            why |= dict.fromkeys(WITH_REFERENCE + WITH_BOTH + WITH_VIDEO, reason)
        fit = components["gaussians"]
        prior = self.prior or getattr(getattr(fit, "guidance", None), "references", None)
        if prior is None:
            why["PSNR to the prior"] = (
                "the prior is a diffusion model, which has no picture of its own to compare with"
                if hasattr(fit, "guidance")
                else "the object was given, no prior made it"
            )
        open_ = {"scene": "trajectory", "film": "clip", "material": "material"}
        found = {name: getattr(self, name) or components[stage] for name, stage in open_.items()}
        if not references:
            found["material"] = None  # what is not used must not be part of the key
        return dataclasses.replace(self, **usable, **found, prior=prior, absent=why, references=references)

    # ------------------------------------------------------------------ the stage
    def __call__(
        self,
        look: Look,
        motion: Motion,
        gaussians: Gaussians,
        particles: Particles,
        field: MaterialField,
        trajectory: Trajectory,
        clip: Clip,
        *,
        work: Workspace,
    ) -> Scores:
        """All scores of one film."""
        if self.scene is None or self.film is None:
            raise ValueError("scene and film are left open: give those that made the trajectory and the clip")
        shot = Shot.like(self.film, trajectory)
        book = Book(dict(self.absent))
        similarity = None
        if self.encoder is not None:
            similarity = clipsim(self.encoder, clip.rgb, motion.text)
            book.add("CLIPSIM", float(similarity.mean()), better="higher", note=f"of the frames to “{motion.text}”")
            book.curves["CLIPSIM"] = similarity
        self._object(book, look, Turntable.of(gaussians, self.views, self.side))
        book.film(clip, shot.reduced(self.side).cover(gaussians, particles, trajectory))
        mass, known = field.rho.detach() * particles.vol, world(self.scene.scene(motion, particles))
        book.physics(trajectory, mass, particles.vol, known, motion.size)
        if self.references:
            cast = (look, motion, gaussians, particles)
            self._compared(book, cast, trajectory, clip, shot, similarity, work)
        return Scores(tuple(book.scores), book.absent, {k: v.float() for k, v in book.curves.items()}, trajectory.fps)

    def _object(self, book: "Book", look: Look, table: Turntable) -> None:
        """The object at rest, from all round."""
        if self.prior is not None:
            pictures, logits = self.prior(look, table.camera, torch.ones(3, device=table.rgb.device))
            values = psnr(table.rgb, pictures[:, int(logits.argmax())]).tolist()
            note = f"{self.views} views that were not fitted"
            book.scores.append(estimate("PSNR to the prior", values, better="higher", unit="dB", note=note))
        values = picture.saturation(table.rgb, table.cover).tolist()
        book.scores.append(estimate("saturation", values, note="of the object's colours; near 1 is oversaturated"))
        if self.encoder is not None:
            share = front_everywhere(janus(self.encoder, table.rgb, look.subject), table.azimuth)
            book.add("Janus", share, better="lower", note="views from behind that show a front")
        if self.aesthetic is not None:
            values = self.aesthetic(table.rgb).tolist()
            note = f"linear head, {self.views} views; 1 to 10, not the scale of the paper"
            book.scores.append(estimate("LAION", values, better="higher", note=note))

    # ------------------------------------------------------------------ against untrained networks
    def _compared(
        self, book: "Book", cast: tuple[Look, Motion, Gaussians, Particles], trajectory: Trajectory, clip: Clip,
        shot: Shot, similarity: Tensor | None, work: Workspace,
    ) -> None:  # fmt: skip
        """One number a seed; a finished seed is kept in a checkpoint."""
        saved = work.load() or {}
        found: dict[str, dict[str, float]] = dict(saved.get("seeds", {}))
        features = self._features(cast, trajectory, shot) if self.video is not None else None
        cover = shot.cover(*cast[2:], trajectory)
        with work.bar(len(self.references), "references", initial=len(found)) as bar:
            for seed in map(str, self.references):
                if seed in found:
                    continue
                try:
                    other = self._untrained(int(seed), cast, work)
                except SimulationDiverged as trouble:
                    log.warning("no reference film of seed %s: %s", seed, trouble)
                    found[seed] = {}
                    continue
                rgb = shot.pictures(*cast[2:], other).to(clip.rgb.device)
                shown = ssim_object(rgb, clip.rgb, shot.cover(*cast[2:], other), cover)
                values = {"Diff_SSIM": 1 - float(ssim(rgb, clip.rgb).mean())}
                values["Diff_SSIM (object)"] = 1 - float(shown.nanmean())
                if similarity is not None:
                    values["CLIPSIM′"] = float(clipsim(self.encoder, rgb, cast[1].text).mean())
                    values["Diff_CLIP"] = float(similarity.mean()) / values["CLIPSIM′"]
                if features is not None:
                    theirs = self._features(cast, other, shot)
                    values |= {"FVD": frechet(features, theirs), "KVD": kernel(features, theirs)}
                found[seed] = values
                work.save({"seeds": found})
                bar.update()
        book.references([found[str(s)] for s in self.references], () if features is None else features.shape)

    def _untrained(self, seed: int, cast: tuple[Look, Motion, Gaussians, Particles], work: Workspace) -> Trajectory:
        """The motion of the same object with the material that a network says before any training."""
        fit = self.material
        settings = {f.name: getattr(fit.net, f.name) for f in dataclasses.fields(fit.net)}
        network = Untrained(**settings | {"seed": seed})
        fit = dataclasses.replace(fit, steps=0, stiffness_steps=0, net=network, seed=seed)
        assert self.scene is not None
        corner = None if work.directory is None else work.directory / f"reference_{seed}"
        own = Workspace(corner, interval=work.interval, progress=work.progress, device=work.device)
        matter = fit(*cast, work=Workspace(progress=work.progress, device=work.device))
        trajectory = self.scene(cast[1], cast[3], matter, work=own)
        if corner is not None:
            shutil.rmtree(corner)  # its checkpoint
        return trajectory

    def _features(self, cast: tuple[Look, Motion, Gaussians, Particles], trajectory: Trajectory, shot: Shot) -> Tensor:
        """Features of all clips of a motion from all sides, shape (n, D)."""
        found = []
        for k in range(self.cameras):
            rig = shot.camera.turned(360 * k / self.cameras)
            side = dataclasses.replace(shot, camera=rig, width=self.side, height=self.side, supersample=1)
            rgb = side.pictures(*cast[2:], trajectory).to(trajectory.x.device)
            found.append(self.video(windows(rgb, self.video.frames, self.stride)))
        return torch.cat(found)


def world(scene: Scene) -> World:
    """What the checks must know of a scene."""
    still = [isinstance(w, HalfSpace) and w.still for w in scene.boundaries]
    planes = [w for w, at_rest in zip(scene.boundaries, still, strict=True) if at_rest and isinstance(w, HalfSpace)]
    return World(
        scene.gravity,
        tuple((w.point, w.normal) for w in planes),
        reach=2 * scene.dx,
        closed=all(still) and not scene.drives,
    )
