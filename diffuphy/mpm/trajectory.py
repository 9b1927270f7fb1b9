"""The stage that sets particles in motion."""

import dataclasses
import itertools
import logging
import math
from dataclasses import dataclass
from typing import Any, ClassVar

import torch

from diffuphy.mpm.boundary import HalfSpace
from diffuphy.mpm.engine.solver import State
from diffuphy.mpm.rollout import FrameReport, simulate
from diffuphy.mpm.scene import Scene, scene_for
from diffuphy.mpm.scheme import Scheme
from diffuphy.types import MaterialField, Motion, Particles, Trajectory
from diffuphy.workspace import Workspace

log = logging.getLogger(__name__)

FRAME = ("x", "v", "F", "Fe")
"""What is kept of a frame; the last where something flows."""

SLOWEST = 5.0
"""Frames a second from which on a frame is simulated as a whole [1/s]. A block of nodes holds wherever particles may
fall in a frame, gT² and more to all sides, and every substep works on it: one of a second is 50 times as large."""


def paced(scene: Scene) -> tuple[Scene, int]:
    """``scene`` with its frames cut into n parts each, so that they are short enough to be simulated; and n."""
    n = math.ceil(SLOWEST / scene.fps)
    return (scene if n == 1 else dataclasses.replace(scene, fps=n * scene.fps, frames=n * scene.frames)), n


@dataclass(frozen=True)
class Play:
    """Sets particles in motion; what they meet is said by ``scene``, which the components that are played define."""

    VERSION: ClassVar[int] = 7

    seconds: float = 2.0
    """Length of the film in physical time [s]."""
    fps: float = 30.0
    """Frames per second [1/s]; the time step inside a frame follows from the material."""
    particles_per_cell: float = 8.0
    """Grid spacing: Δx = spacing · this^⅓; eight keep the quadrature error below that of the grid."""
    cfl: float = 0.4
    """Courant number; explicit steps are stable to 0.75."""
    scheme: Scheme = Scheme(contact="elastic")
    """Transfer between particles and grid, walls and time integration; with elastic contact things touch the floor."""
    double: bool = False
    """Compute in float64, at about twice the time."""

    def __post_init__(self) -> None:
        if not all(0 < a < math.inf for a in (self.seconds, self.fps, self.particles_per_cell)):
            raise ValueError(
                "seconds, fps and particles_per_cell must be positive and finite, "
                f"got {self.seconds}, {self.fps}, {self.particles_per_cell}"
            )
        # what it refuses, it refuses before the other stages run
        Scene(dx=1.0, cfl=self.cfl)

    @property
    def frames(self) -> int:
        """Frames after the initial one."""
        return max(1, round(self.seconds * self.fps))

    def dx(self, particles: Particles) -> float:
        """Grid spacing that fits the particles [m]."""
        return particles.spacing * self.particles_per_cell ** (1 / 3)

    def scene(self, motion: Motion, particles: Particles) -> Scene:
        """What happens around the particles."""
        raise NotImplementedError

    def __call__(self, motion: Motion, particles: Particles, field: MaterialField, *, work: Workspace) -> Trajectory:
        """Positions, velocities and total deformation gradients at every frame, the initial one first."""
        scene = self.scene(motion, particles)
        dtype = torch.float64 if self.double else particles.x.dtype
        saved = work.load()
        shots = _shots(saved) if saved else []
        state = State(**saved["state"]) if saved else None
        reports: list[FrameReport] = []
        paced_scene, parts = paced(scene)
        left = scene.frames - max(0, len(shots) - 1)
        x, vol = particles.x.to(dtype), particles.vol.to(dtype)
        every = simulate(paced_scene, x, vol, field, frames=parts * left, state=state, report=reports)
        states = itertools.islice(every, 0, None, parts)
        if saved:
            next(states)  # the state the checkpoint holds
        with work.bar(scene.frames + 1, "simulate", initial=len(shots)) as bar:
            for state in states:
                shots.append(tuple(t.float() for t in (state.x, state.v, state.F, state.Fe) if t is not None))
                bar.update()
                if reports:
                    r = reports[-1]
                    n = sum(part.n_sub for part in reports[-parts:])
                    work.log(len(shots) - 1, substeps=n, dt=r.dt, wave=r.wave, speed=r.speed, nodes=r.grid.nodes)
                if work.due():
                    work.save(_checkpoint(shots, state))
        if reports:
            substeps = [sum(r.n_sub for r in reports[k : k + parts]) for k in range(0, len(reports), parts)]
            log.info("simulate: %d–%d substeps a frame, Δx = %.3g m", min(substeps), max(substeps), scene.dx)
        x, v, F, *Fe = (torch.stack(parts) for parts in zip(*shots, strict=True))
        return Trajectory(x, v, F, self.fps, *Fe)


@dataclass(frozen=True)
class Simulate(Play):
    """Plays the scene of the prompt's motion word with the object's particles."""

    friction: float = 0.5
    """Coulomb coefficient of the floor, plate and ball [-]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        HalfSpace(friction=self.friction)

    def scene(self, motion: Motion, particles: Particles) -> Scene:
        """The scene of the motion word, on a grid that fits the particles."""
        scene = scene_for(
            motion.verb, motion.size, frames=self.frames, fps=self.fps, friction=self.friction, cfl=self.cfl
        )
        return dataclasses.replace(scene, dx=self.dx(particles), scheme=self.scheme)


def _checkpoint(shots: list[tuple], state: State) -> dict[str, Any]:
    frames = dict(zip(FRAME, (torch.stack(parts) for parts in zip(*shots, strict=True)), strict=False))
    return {**frames, "state": {f.name: getattr(state, f.name) for f in dataclasses.fields(state)}}


def _shots(saved: dict[str, Any]) -> list[tuple]:
    return list(zip(*(saved[k] for k in FRAME if k in saved), strict=True))
