"""The material point method: particles, walls, grid, time; and its adjoint."""

import diffuphy.compiling  # noqa: F401, sets Warp up before it starts
from diffuphy.mpm.boundary import Boundary, Box, Cylinder, HalfSpace, Mesh, Schedule, Sphere, container
from diffuphy.mpm.grid import Grid
from diffuphy.mpm.rollout import FrameReport, rollout, simulate
from diffuphy.mpm.sample import Sample, coarsen
from diffuphy.mpm.scene import SCENES, Scene, scene_for
from diffuphy.mpm.scheme import Scheme
from diffuphy.mpm.solver import Solver
from diffuphy.mpm.state import Matter, Span, State

__all__ = [
    "SCENES", "Boundary", "Box", "Cylinder", "FrameReport", "Grid", "HalfSpace", "Matter", "Mesh", "Sample", "Scene",
    "Schedule", "Solver", "Span", "Sphere", "State", "coarsen", "container", "rollout", "scene_for", "simulate",
]  # fmt: skip
