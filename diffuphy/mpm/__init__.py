"""The material point method: particles, walls, grid, time; and its adjoint."""

import warp as wp

wp.config.quiet = True  # before Warp starts: a library does not greet
wp.config.log_level = wp.LOG_WARNING

from diffuphy.mpm.boundary import Boundary, HalfSpace, Sphere  # noqa: E402
from diffuphy.mpm.grid import Grid  # noqa: E402
from diffuphy.mpm.rollout import FrameReport, rollout, simulate  # noqa: E402
from diffuphy.mpm.sample import Sample, coarsen  # noqa: E402
from diffuphy.mpm.scene import SCENES, Scene, scene_for  # noqa: E402
from diffuphy.mpm.solver import Solver  # noqa: E402
from diffuphy.mpm.state import Matter, Span, State  # noqa: E402

__all__ = [
    "SCENES", "Boundary", "FrameReport", "Grid", "HalfSpace", "Matter", "Sample", "Scene", "Solver", "Span", "Sphere",
    "State", "coarsen", "rollout", "scene_for", "simulate",
]  # fmt: skip
