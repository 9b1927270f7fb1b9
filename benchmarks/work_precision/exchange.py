"""How a problem reaches another code and how its answer comes back: an npz file there, another back, lines between.

Runs under the interpreter of the other code, which has NumPy and nothing of this project: this file imports neither.
A child is told ``load PATH`` and ``run PATH`` by lines on its standard input and answers each with a line of JSON; so
it takes turns with others like any run in this process, and has compiled before it is timed.
"""

import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

WALL_KINDS = ("sticky", "slip", "separate")
"""Numbers that stand for kinds of walls in a task."""


@dataclass(frozen=True)
class Task:
    """A problem as arrays."""

    x: np.ndarray
    """Positions at rest, shape (N, 3) [m]."""
    v: np.ndarray
    """Velocities, shape (N, 3) [m/s]."""
    C: np.ndarray
    """Their gradients, shape (N, 3, 3) [1/s]."""
    vol: np.ndarray
    """Rest volumes, shape (N,) [m³]."""
    law: str
    """``neo_hookean`` or ``fluid_eos``."""
    mu: float
    """Shear modulus, 0 for a liquid [Pa]."""
    lam: float
    """Lamé's first parameter, or the bulk modulus of a liquid [Pa]."""
    gamma: float
    """Exponent of a liquid's pressure K/γ (J^−γ − 1) [-]."""
    rho: float
    """Density [kg/m³]."""
    dx: float
    """Grid spacing [m]."""
    dt: float
    """Substep of an explicit code [s]."""
    per: int
    """Substeps in a frame."""
    frames: int
    gravity: np.ndarray
    """Shape (3,) [m/s²]."""
    walls: np.ndarray
    """A row a wall: point (3), normal (3), number of its kind, friction; shape (W, 8)."""
    low: np.ndarray
    """Lower corner of where particles get to, shape (3,) [m]."""
    high: np.ndarray
    """Upper corner, shape (3,) [m]."""
    forces: np.ndarray
    """Body force before each substep, shape (substeps, N, 3) [m/s²]; empty without one."""

    def save(self, path: str) -> None:
        np.savez(path, **vars(self))

    @classmethod
    def read(cls, path: str) -> "Task":
        with np.load(path) as file:
            return cls(**{k: file[k].item() if file[k].ndim == 0 else file[k] for k in file.files})


class Runner(Protocol):
    """A code with a task loaded."""

    def reset(self) -> None:
        """Back to the start."""

    def frame(self) -> None:
        """Play one frame."""

    def positions(self) -> np.ndarray:
        """Shape (N, 3) [m]."""
        ...


def serve(make: Callable[[Task], Runner]) -> None:
    """Answer lines until the input ends."""
    runner, task = None, None
    for line in sys.stdin:
        order, path = line.rstrip("\n").split(" ", 1)
        if order == "load":
            task = Task.read(path)
            runner = make(task)
            reply: dict[str, Any] = {"particles": len(task.x)}
        else:
            assert runner is not None and task is not None, "load comes before run"
            reply = timed(runner, task, path)
        print(json.dumps(reply), flush=True)


def timed(runner: Runner, task: Task, path: str) -> dict[str, float]:
    """Play a task, write its positions at every frame, and tell what it took."""
    runner.reset()
    rows = [runner.positions()]
    cpu, wall = time.process_time(), time.perf_counter()
    for _ in range(task.frames):
        runner.frame()
        rows.append(runner.positions())
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    np.save(path, np.stack(rows).astype(np.float64))
    return {"seconds": cpu, "wall": wall}
