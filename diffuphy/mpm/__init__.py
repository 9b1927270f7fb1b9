"""The material point method: particles, walls, grid, time; and its adjoint.

``sampling`` makes particles, ``boundary`` and ``drive`` are what acts on them, ``substep`` holds the kernels,
``engine`` runs them. A ``Scene`` says what there is, ``rollout`` plays it.
"""

import diffuphy.compiling  # noqa: F401, sets Warp up before it starts
from diffuphy.mpm.boundary import Boundary, Box, Cylinder, HalfSpace, Mesh, Schedule, Sphere, container
from diffuphy.mpm.controls import Controls
from diffuphy.mpm.diagnostics import Balance, Diagnostics
from diffuphy.mpm.drive import (
    Acceleration,
    Attractor,
    Drag,
    Drive,
    Held,
    Impulse,
    InBall,
    InBox,
    InCylinder,
    Release,
    Vortex,
)
from diffuphy.mpm.engine.batch import rollout_batch
from diffuphy.mpm.engine.solver import Solver, backward_bytes
from diffuphy.mpm.grid import Grid
from diffuphy.mpm.report import FrameReport
from diffuphy.mpm.rollout import rollout, simulate
from diffuphy.mpm.sampling.coarse import coarsen
from diffuphy.mpm.sampling.sample import Sample
from diffuphy.mpm.scene import SCENES, Scene, scene_for
from diffuphy.mpm.scheme import Scheme
from diffuphy.mpm.span import Span
from diffuphy.mpm.state import Matter, State

__all__ = [
    "SCENES", "Acceleration", "Attractor", "Balance", "Boundary", "Box", "Controls", "Cylinder", "Diagnostics",
    "Drag", "Drive", "FrameReport", "Grid", "HalfSpace", "Held", "Impulse", "InBall", "InBox", "InCylinder",
    "Matter", "Mesh", "Release", "Sample", "Scene", "Schedule", "Scheme", "Solver", "Span", "Sphere", "State",
    "Vortex", "backward_bytes", "coarsen", "container", "rollout", "rollout_batch", "scene_for", "simulate",
]  # fmt: skip
