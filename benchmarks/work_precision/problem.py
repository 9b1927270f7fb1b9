"""A problem at one resolution, and its run by this solver, timed."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from benchmarks.verification.bodies import Body, at_rest
from benchmarks.verification.case import Setting
from benchmarks.work_precision.choice import Choice
from diffuphy.mpm import HalfSpace, State, simulate

Positions = list[Tensor]
"""Of every particle at every frame, the initial one first, each of shape (N, 3) in float64 [m]."""

REMEMBERED = 3e8
"""Bytes of body forces that are kept from one run to the next."""


@dataclass(frozen=True, eq=False)
class Problem:
    """What is to be solved: a body, how it starts, what acts on it, and how wrong an answer is."""

    body: Body
    """Particles and material."""
    dx: float
    """Grid spacing [m]."""
    cells: float
    """Cells along the length that the case counts them by."""
    seconds: float
    """Physical time [s]."""
    frames: int
    """Times at which positions are compared, evenly spaced."""
    pace: float
    """Fastest wave and particle together [m/s]."""
    error: Callable[[Positions], float]
    """Error of an answer [-]."""
    v: Tensor | None = None
    """Initial velocity, shape (N, 3) [m/s]."""
    C: Tensor | None = None
    """Its gradient, shape (N, 3, 3) [1/s]."""
    gravity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Acceleration [m/s²]."""
    walls: tuple[HalfSpace, ...] = ()
    force: Callable[[float], Tensor] | None = None
    """Body force at a time, shape (N, 3) [m/s²]."""

    def steps(self, cfl: float) -> tuple[float, int]:
        """Δt [s], and substeps in a frame."""
        frame = self.seconds / self.frames
        per = math.ceil(frame * self.pace / (cfl * self.dx) - 1e-9)
        return frame / per, per


@dataclass(frozen=True)
class Sample:
    """What one run took."""

    seconds: float
    """Processor time of the run [s]: everything from the state at the start to that at the end, without body forces
    that only the test needs."""
    wall: float
    """The same by the clock on the wall [s]."""


class Forces:
    """A body force in one precision, evaluated once for every time, and the time that took."""

    def __init__(self, force: Callable[[float], Tensor], dtype: torch.dtype):
        self.force, self.dtype = force, dtype
        self.kept: dict[float, Tensor] = {}
        self.cpu = self.wall = 0.0

    def __call__(self, t: float) -> Tensor:
        cpu, wall = time.process_time(), time.perf_counter()
        b = self.kept.get(t)
        if b is None:
            b = self.force(t).to(self.dtype).contiguous()
            if (len(self.kept) + 1) * b.nbytes < REMEMBERED:
                self.kept[t] = b
        self.cpu += time.process_time() - cpu
        self.wall += time.perf_counter() - wall
        return b


class Trial:
    """A problem under one choice of settings."""

    def __init__(self, problem: Problem, choice: Choice):
        self.problem, self.choice = problem, choice
        self.setting = Setting(choice.series, choice.scheme)
        self.dt, self.per = problem.steps(choice.cfl)
        self.body = problem.body.to(choice.dtype)
        self.field = self.body.field
        given = {k: getattr(problem, k) for k in ("v", "C")}
        given = {k: t.to(choice.dtype).contiguous() for k, t in given.items() if t is not None}
        self.start: State = at_rest(self.setting, self.body, **given)
        self.forces = None if problem.force is None else Forces(problem.force, choice.dtype)
        self.states: list[State] = []

    @property
    def particles(self) -> int:
        return len(self.body.x)

    @property
    def rounds(self) -> int:
        """Rounds between particles and grid: substeps, and one more in a frame with half kicks."""
        return (self.per + self.choice.scheme.half_kick) * self.problem.frames

    def run(self) -> Sample:
        """Play the problem on one thread."""
        p = self.problem
        fps = 1.0 / (self.dt * self.per)
        scene = self.setting.scene(dx=p.dx, gravity=p.gravity, boundaries=p.walls, fps=fps)
        before = (0.0, 0.0) if self.forces is None else (self.forces.cpu, self.forces.wall)
        cpu, wall = time.process_time(), time.perf_counter()
        self.states = list(
            simulate(
                scene, self.body.x, self.body.vol, self.field, frames=p.frames, dt=self.dt * (1 + 1e-6),
                state=self.start, body=self.forces, threads=1,
            )
        )  # fmt: skip
        cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
        if self.forces is not None:
            cpu, wall = cpu - (self.forces.cpu - before[0]), wall - (self.forces.wall - before[1])
        return Sample(cpu, wall)

    def error(self) -> float:
        """Of the last run [-]."""
        return self.problem.error([s.x.double() for s in self.states])
