"""From particles and a material field to a trajectory: one autograd node a frame, the time step from the material.

    n_sub = ⌈T / min( cfl Δx / (c + V),  0.8 Δx / (s c + V) )⌉,      T = 1/fps

c is the fastest wave of the mixture at rest, V bounds the speed of a particle in the frame, s ≥ 1 says how much faster waves run
in the present stretch. The number depends on the material, so it is found again for every frame; it is not differentiated.
"""

import dataclasses
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from diffuphy.material import make_mixture, wave_speed
from diffuphy.mpm.grid import Grid
from diffuphy.mpm.kernels import FAST, INVERTED, LEFT
from diffuphy.mpm.scene import Scene
from diffuphy.mpm.solver import REAL, Matter, Solver, Span, State
from diffuphy.types import MaterialField, SimulationDiverged, Trajectory

STABLE = 0.8
"""Largest Δt (c + |v|) / Δx of an explicit step that is stable for all laws of the library [-]."""

GROWTHS = 6
"""How often the block of a frame may be enlarged before the particles are taken to have exploded; it doubles its margin each time."""


@dataclass(frozen=True)
class FrameReport:
    """What one frame took."""

    n_sub: int
    """Substeps."""
    dt: float
    """Length of one [s]."""
    wave_speed: float
    """Fastest wave c at rest [m/s]."""
    speed: float
    """Bound V on the speed of a particle [m/s]."""
    grid: Grid
    """Block of nodes."""
    reruns: int
    """How often it was enlarged because particles left it."""


class Frame(torch.autograd.Function):
    """One frame of a rollout. Only the state at its start is kept; backward runs its substeps again."""

    @staticmethod
    def forward(ctx: Any, solver: Solver, vol: Tensor, frame: dict[str, Any], x: Tensor, v: Tensor, C: Tensor, He: Tensor, H: Tensor | None,
                w_e: Tensor, w_p: Tensor, theta: Tensor, m: Tensor) -> tuple[Tensor | None, ...]:  # fmt: skip
        matter = Matter(w_e, w_p, theta, m, vol)
        state = State(x, v, C, He, H)
        span, reruns = frame["span"], 0
        end, status = solver.advance(state, matter, span)
        while status[LEFT] and bool(torch.isfinite(end.x).all()) and not status[INVERTED] and not status[FAST]:
            reruns += 1
            if reruns > GROWTHS:
                break
            span = dataclasses.replace(span, grid=span.grid.grown(2 ** (reruns + 1)))
            end, status = solver.advance(state, matter, span)
        frame.update(span=span, reruns=reruns, status=status)
        ctx.solver, ctx.span, ctx.segment = solver, span, frame["segment"]
        ctx.save_for_backward(x, v, C, He, H, w_e, w_p, theta, m, vol)
        return end.x, end.v, end.C, end.He, end.H

    @staticmethod
    def backward(ctx: Any, *grads: Tensor | None) -> tuple[Any, ...]:
        *state, w_e, w_p, theta, m, vol = ctx.saved_tensors
        bars = [None if t is None else torch.zeros_like(t) if g is None else g.clone() for t, g in zip(state, grads, strict=True)]
        end, matter = ctx.solver.advance_adjoint(
            State(*state), Matter(w_e, w_p, theta, m, vol), ctx.span, State(*bars), ctx.needs_input_grad[8:12], ctx.segment
        )
        return (None, None, None, end.x, end.v, end.C, end.He, end.H, *matter)
