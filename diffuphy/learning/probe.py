"""The experiment materials are learnt from: a coarse copy of the object, thrown at the floor, filmed by one camera.

One short drop shows stiffness (how far it flattens, how soon it leaves), plasticity (what stays) and friction;
whatever the film later shows, the material is the object's own. Small and short on purpose: twelve frames with one
impact have one basin, longer clips have many.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import torch
from torch import Tensor

from diffuphy.losses.takes import Take, low_pass
from diffuphy.losses.velocity import Velocity, centroid
from diffuphy.losses.video import by_frames
from diffuphy.material import presets
from diffuphy.mpm import FrameReport, HalfSpace, Scene, Scheme, rollout
from diffuphy.mpm.sampling.coarse import coarsen
from diffuphy.render import Skin, look_at, render_gaussians
from diffuphy.types import Camera, Gaussians, Look, MaterialField, Motion, Particles, Trajectory


@dataclass(frozen=True)
class Probe:
    """Settings of the drop test."""

    particles: int = 1500
    """Particles of the coarse copy; 1.2–1.7 thousand carry the motion, more only cost."""
    frames: int = 12
    """Frames of the clip: the impact falls in the first three or four, the answer in the rest."""
    fps: float = 30.0
    """Frames per second [1/s]."""
    speed: float = 1.5
    """Impact speed of an object of 0.3 m [m/s]; grows with the square root of the size (Froude)."""
    tilt: float = 0.0
    """Sideways speed as a fraction of the impact speed; shows friction."""
    gap: float = 0.03
    """Height of the lowest particle at the start, in object sizes."""
    particles_per_cell: float = 8.0
    """Grid spacing: Δx = spacing · this^⅓, as for the film."""
    cfl: float = 0.4
    """Courant number."""
    scheme: Scheme = Scheme()
    """Transfers, walls and time integration. Against the probe itself the choice hardly matters; a reference from
    elsewhere asks for ``contact="elastic"``, which lets a stiff body touch the floor before it turns, as films do, and
    of grains for ``sharpen=False, retain=0``: see ``docs/benchmarks/identify.md``."""
    image: int = 64
    """Height and width of the clip [px]."""
    view: float = 40.0
    """Angle of view of the camera [deg]: a bounce stays inside 40; a heap of grains runs out of it, and with it goes
    what shows its friction: 60 keeps it."""
    skin: int = 4
    """Particles each Gaussian follows; several, because a draft particle stands for many Gaussians."""
    background: tuple[float, float, float] = (0.85, 0.9, 1.0)
    """Colour behind the object."""
    seed: int = 0
    """Which particles the coarse copy keeps."""

    def __post_init__(self) -> None:
        if self.particles < 64 or self.frames < 2 or self.image < 16:
            raise ValueError(
                "a probe needs particles ≥ 64, frames ≥ 2 and image ≥ 16, "
                f"got {self.particles}, {self.frames}, {self.image}"
            )
        if not 0.0 < self.view < 180.0:
            raise ValueError(f"probe.view is an angle in (0, 180) degrees, got {self.view}; 40 is the default")

    def scene(self, dx: float, size: float) -> Scene:
        """The drop itself."""
        speed = self.speed * math.sqrt(size / 0.3)
        return Scene(
            dx=dx,
            fps=self.fps,
            frames=self.frames,
            velocity=(self.tilt * speed, 0.0, -speed),
            lift=self.gap * size,
            boundaries=(HalfSpace(friction=0.5),),
            cfl=self.cfl,
            scheme=self.scheme,
        )

    def bench(self, gaussians: Gaussians, particles: Particles, size: float, kind: Tensor | None = None) -> "Bench":
        """Set the experiment up for one object.

        Args:
            size: longest side of the object [m].
            kind: what may be of different materials, shape (N,), int64; the draft keeps the volume of each.
        """
        draft, kept = coarsen(particles, n=self.particles, seed=self.seed, kind=kind)
        scene = self.scene(draft.spacing * self.particles_per_cell ** (1 / 3), size)
        # the body hangs at its height, whichever of its particles the draft kept: half a spacing is a frame of the fall
        above = float(draft.x[:, 2].min() - particles.x[:, 2].min())
        scene = dataclasses.replace(scene, lift=self.gap * size + above)
        skin = Skin.bind(gaussians, draft, k=self.skin)
        return Bench(self, scene, draft, skin, self.camera(draft, size), size, kept)

    def camera(self, draft: Particles, size: float) -> Camera:
        """One camera that sees the object from its start down to the floor, whatever it does there."""
        focal = 0.5 * self.image / math.tan(math.radians(self.view / 2))
        eye = (0.6 * size, -2.4 * size, 0.9 * size)
        device = draft.x.device
        K = torch.tensor([[focal, 0, self.image / 2], [0, focal, self.image / 2], [0, 0, 1]], device=device)
        view = look_at(eye, (0.0, 0.0, 0.42 * size)).to(device)
        return Camera(view[None], K[None], self.image, self.image)


@dataclass(frozen=True)
class Bench:
    """The experiment, ready to run with any material."""

    probe: Probe
    scene: Scene
    draft: Particles
    """The coarse copy."""
    skin: Skin
    camera: Camera
    size: float
    """Longest side of the object [m]."""
    kept: Tensor | None = None
    """Which particle of the object each of the draft is, shape (N,), int64; None: the draft is the object."""

    def simulate(
        self,
        field: MaterialField,
        frames: int | None = None,
        *,
        scene: Scene | None = None,
        gate_time: float | None = None,
        **options: Any,
    ) -> Trajectory:
        """Drop the draft particles; differentiable in ``field`` where gradients are enabled.

        Args:
            frames: frames after the initial state; all of the probe's by default.
            scene: another motion (held-out test); the drop by default.
            gate_time: reference time of rate-form plastic gates [s]; None uses the weights as they are.
            options: of ``mpm.simulate``; ``report=[], gather=("impulse",)`` has the reports hold what a loss needs.
        """
        scene = scene or self.scene
        options = {"dt_ref": gate_time if "identity" in field.plastic else None} | options
        if torch.is_grad_enabled():
            options = {"grad": True, "keep": True} | options
        return rollout(scene, self.draft.x, self.draft.vol, field, frames=frames, **options)

    def velocity_loss(
        self,
        velocity: Velocity,
        trajectory: Trajectory,
        field: MaterialField,
        reports: Sequence[FrameReport] = (),
        target: Tensor | None = None,
    ) -> Tensor:
        """λ_vel · L_vel of a drop (``losses.velocity``), a scalar.

        What the simulator gathered, and the masses that go with it, are constants: the gradient is that of the
        velocities alone.

        Args:
            velocity: form and weight.
            trajectory: of ``simulate``, T frames after the initial state.
            field: the material it was simulated with.
            reports: of the T frames, with ``velocity.needs`` gathered if that is not None.
            target: the clip that the prior has in mind, at least T frames (H, W, 3), for the form ``image``.

        Raises:
            ValueError: when the form needs what was not gathered in every frame, or a clip that is not there.
        """
        if velocity.form == "image":
            return self._image_velocity(velocity, trajectory, target)
        m = field.rho.detach() * self.draft.vol
        needed = {}
        if velocity.needs is not None:
            sums = [getattr(report, velocity.needs) for report in reports]
            if not sums or any(s is None for s in sums):
                raise ValueError(
                    f"velocity.form = {velocity.form!r} needs {velocity.needs} of each frame; "
                    f"simulate with report=reports and gather=({velocity.needs!r},)"
                )
            needed[velocity.needs] = torch.stack(sums)
        return velocity(trajectory.v, m, gravity=self.scene.gravity, dt=1 / self.scene.fps, **needed)

    def _image_velocity(self, velocity: Velocity, trajectory: Trajectory, target: Tensor | None) -> Tensor:
        if target is None:
            raise ValueError("velocity.form = 'image' compares with the prior's clip, and this prior has none in mind")
        take = Take.whole(len(trajectory.x) - 1)
        draw, background, frames = self.drawing(take), self.background_of(take), list(take.frames)
        seen = by_frames(lambda x, F: centroid(draw(x, F), background), trajectory.x[frames], trajectory.F[frames])
        wanted = torch.stack([centroid(picture, background) for picture in target[: len(frames)]])
        centre = self.camera.viewmats[0] @ self.camera.viewmats.new_tensor([0.0, 0.0, 0.42 * self.size, 1.0])
        pixel = float(centre[2] / self.camera.Ks[0, 0, 0])
        return velocity.of_pictures(seen, wanted, pixel=pixel, dt=1 / self.scene.fps)

    def camera_of(self, take: Take) -> Camera:
        """The one camera of a take: the experiment's, turned about the vertical axis through the object."""
        a = math.radians(take.azimuth)
        c, s = math.cos(a), math.sin(a)
        turn = self.camera.viewmats.new_tensor([[c, s, 0, 0], [-s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
        return dataclasses.replace(self.camera, viewmats=self.camera.viewmats @ turn)

    def background_of(self, take: Take) -> Tensor:
        """Colour behind the object in a take, shape (3,)."""
        colour = self.probe.background if take.background is None else take.background
        return torch.tensor(colour, device=self.draft.x.device)

    def drawing(self, take: Take) -> Callable[[Tensor, Tensor], Tensor]:
        """What draws a frame of a take, pixels (H, W, 3) in [0, 1], of particles at x (N, 3) deformed by F (N, 3, 3);
        differentiable in both."""
        gaussians, camera, background = self.skin.gaussians, self.camera_of(take), self.background_of(take)

        def draw(x: Tensor, F: Tensor) -> Tensor:
            means, F_g = self.skin(x, F)
            picture = render_gaussians(gaussians, camera, means=means, F=F_g, background=background).rgb[0]
            return low_pass(picture, background, take.blur * self.probe.image) if take.blur else picture

        return draw

    def film(self, trajectory: Trajectory, take: Take | None = None) -> Tensor:
        """The frames of a take, by default all but the first of the trajectory, shape (T, H, W, 3); differentiable."""
        take = take or Take.whole(len(trajectory.x) - 1)
        draw, frames = self.drawing(take), list(take.frames)
        return torch.stack([draw(x, F) for x, F in zip(trajectory.x[frames], trajectory.F[frames], strict=True)])

    def change(self, before: MaterialField, after: MaterialField) -> float:
        """Largest distance between two materials' drops at any frame, over the size of the object [-]."""
        with torch.no_grad():
            x, y = (self.simulate(field).x for field in (before, after))
        return float((x - y).norm(dim=-1).max()) / self.size


def parts_of(library: Any, look: Look, draft: Particles) -> tuple[tuple[str, ...], Tensor]:
    """Names of the parts of an object, and the part of each particle, shape (N,), int64.

    Args:
        library: knows the parts of an object (``text2gs.shapes.Library``); None: one part, the "object".
    """
    if library is None:
        return ("object",), torch.zeros(len(draft), dtype=torch.long, device=draft.x.device)
    shape = library.object(look)
    points = (draft.x.cpu() - torch.tensor(draft.offset)) / draft.scale
    return tuple(part.name for part in shape.parts), shape.part_of(points).long().to(draft.x.device)


def table_field(
    library: object, look: Look, motion: Motion, draft: Particles, override: Mapping[str, float | None] | None = None
) -> MaterialField:
    """The material the table gives each particle, by the words of the prompt, part by part.

    Args:
        library: knows the parts of an object (``text2gs.shapes.Library``); None: one material for the whole object.
        override: parameters that all parts take instead of the table's, by the names of ``presets.Preset`` [SI].
    """
    words, index = words_of(library, look, motion, draft)
    kinds = [presets.lookup(w) for w in words]
    kinds = [presets.melt(k) for k in kinds] if motion.verb == "melting" else kinds
    given = {k: v for k, v in (override or {}).items() if v is not None}
    kinds = [dataclasses.replace(k, **given) for k in kinds]
    return presets.field(kinds, index, dtype=draft.x.dtype)


def words_of(library: object, look: Look, motion: Motion, draft: Particles) -> tuple[list[str], Tensor]:
    """Material words by the prompt, one for each part of the object, and the part of each particle, shape (N,)."""
    whole = motion.materials.get("", next(iter(motion.materials.values())))
    names, index = parts_of(library if set(motion.materials) - {""} else None, look, draft)
    return [motion.materials.get(name, whole) for name in names], index


@dataclass(frozen=True)
class TableClips:
    """References of the embedded clip prior: the probe itself, simulated with the table's material.

    The prompt selects one clip, hard: the likelihood of a clip outweighs any soft preference by hundreds of nats, so a
    soft mixture would have a fixed point at every reference.
    """

    bench: Bench
    field: MaterialField

    @cached_property
    def drop(self) -> Trajectory:
        """The drop, as long as the probe's; what is filmed of it is another question."""
        with torch.no_grad():
            return self.bench.simulate(self.field)

    def __call__(
        self, words: Motion, camera: Camera, background: Tensor, *, take: Take | None = None
    ) -> tuple[Tensor, Tensor]:
        """Reference clips, shape (1, K=1, T, H, W, 3), and their log-prior, shape (1,).

        Args:
            camera: one for each frame of the clip.
            take: what the clip shows; frames 1 … T as the experiment films them by default.
        """
        with torch.no_grad():
            clip = self.bench.film(self.drop, take or Take.whole(len(camera)))
        return clip[None, None], torch.zeros(1, device=clip.device)
