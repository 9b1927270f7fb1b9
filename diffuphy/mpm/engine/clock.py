"""How long a substep is, and which block of nodes a frame needs.

    n_sub = ⌈T / min( cfl Δx / (c + V),  0.75 Δx / (c' + V) )⌉,      T = 1/fps

c is the fastest wave of the mixture at rest, c' that in the present stretch, V bounds the speed of a particle in the
frame. The number depends on the material, so it is found again for every frame; it is not differentiated. A frame at
whose end waves turn out to be too fast for its substep is run again with half of it.
"""

import dataclasses
import math
from typing import Any

import torch

from diffuphy.material import wave_speed
from diffuphy.mpm.diagnostics import waves
from diffuphy.mpm.drive import speed_bound
from diffuphy.mpm.engine.solver import Solver
from diffuphy.mpm.grid import Grid
from diffuphy.mpm.scene import STABLE, Scene
from diffuphy.mpm.span import Span
from diffuphy.mpm.state import Matter, State
from diffuphy.types import MaterialField, SimulationDiverged

MAX_SUBSTEPS = 10**6
"""Substeps of one frame beyond which a scene is refused: it is stiffer than an explicit step can film."""

FINEST = 2.0**-6
"""Largest rounding of a position [Δx]: an eighth of what it takes to see it in the weights of a particle and its
neighbour; 13 km from the origin in float32 with cells of 5 cm."""

SPARSE_NODES = 2**15
"""Nodes of a block below which all are worked on: finding out which are needed takes as long as a few substeps."""

SPARSE_SHARE = 0.25
"""Share of the nodes of a block up to which those are worked on alone. A list never costs more than it saves, but above
this it saves less than a fifth of a substep (two bodies of 8000 particles), and it takes kernels of its own."""


class Clock:
    """Time steps of one rollout.

    Args:
        dt: a substep that the user insists on [s]; refused when it is unstable.
    """

    def __init__(self, scene: Scene, solver: Solver, field: MaterialField, matter: Matter, dt: float | None):
        self.scene, self.solver, self.matter, self.dt = scene, solver, matter, dt
        theta = dict(zip(solver.mixture.params, matter.theta.T, strict=True))
        rest = wave_speed(tuple(field.elastic), matter.w_e, theta, matter.m / matter.vol, tuple(field.branches))
        self.rest = rest.detach()
        self._known: tuple[tuple[Any, ...], State, torch.Tensor] | None = None
        self.top = rest.max() if scene.scheme.retain > 0.0 or solver.variant.elastic else None
        """Fastest wave at rest [m/s] as a function of the material, if retention or contact go by it."""

    def steer(self, scene: Scene, matter: Matter) -> None:
        """Go on with the drives of ``scene``, of the same kinds, and with the tags of ``matter``."""
        self.solver.steer(scene.drives)
        self.scene, self.matter = scene, matter

    @property
    def wave(self) -> float:
        """Fastest wave at rest [m/s]."""
        return float(self.rest.max())

    def pace(self, state: State) -> torch.Tensor:
        """Fastest wave of each particle in the present stretch, shape (N,) [m/s]. That of the end of a frame is known
        when the next frame begins with the same tensors."""
        key = tuple(None if t is None else (t.data_ptr(), t.shape, t._version) for t in (state.He, state.memory))
        if self._known is None or self._known[0] != key:
            # with the state, so that nothing else comes to lie where its tensors are
            self._known = key, state, waves(self.solver.mixture, state, self.matter)
        return self._known[2]

    def stiff(self, state: State) -> float:
        """The fastest of them [m/s]."""
        return float(self.pace(state).max())

    def speed(self, state: State) -> float:
        """A bound on the speed of a particle in the next frame [m/s]."""
        x = state.x.detach()
        ends = x.amin(0).tolist(), x.amax(0).tolist()
        walls = max((b.speed_within(*ends, state.time) for b in self.scene.boundaries), default=0.0)
        T, driven = 1.0 / self.scene.fps, 0.0
        if self.scene.drives and self.matter.tag is not None:
            at = (self.matter.m.detach(), self.matter.tag, *ends, state.time, state.time + T)
            driven = speed_bound(self.scene.drives, *at)
        return float(state.v.detach().norm(dim=1).max()) + math.hypot(*self.scene.gravity) * T + walls + driven

    def span(self, state: State) -> Span:
        """Time step and block of the next frame.

        Raises:
            ValueError: the pinned step is unstable, or the scene needs too many.
        """
        T, dx = 1.0 / self.scene.fps, self.scene.dx
        stiff, speed = self.stiff(state), self.speed(state)
        limit = STABLE * dx / (stiff + speed) if stiff + speed > 0 else T
        if self.dt is not None and T / math.ceil(T / self.dt) > limit:
            raise ValueError(
                f"dt = {self.dt:.3g} s is unstable: waves of {stiff:.3g} m/s and particles of up to {speed:.3g} m/s "
                f"cross more than {STABLE} cells of {dx:.3g} m in it; use at most {limit:.3g} s, or leave dt out"
            )
        step = min(self.scene.cfl * dx / (self.wave + speed), limit) if self.dt is None else self.dt
        if not step > 0 or T / step > MAX_SUBSTEPS:
            raise (ValueError if state.time == 0.0 else SimulationDiverged)(
                f"the frame at t = {state.time:.4g} s would take {T / step if step > 0 else math.inf:.3g} substeps: "
                f"waves run at {stiff:.3g} m/s through cells of {dx:.3g} m; "
                "use a softer or denser material, a larger dx, or a higher fps"
            )
        scheme = self.scene.scheme
        n_sub = math.ceil(T / step)
        block = self._block(state, speed)
        span = Span(block, state.time, T / n_sub, n_sub, self.wave, scheme.retain, scheme.half_kick)
        return self._thinned(span, state, speed)

    def _thinned(self, span: Span, state: State, speed: float) -> Span:
        """The same with a part of its block, where that is worth it."""
        if span.grid.nodes < SPARSE_NODES:
            return span
        slack = 1 + math.ceil(0.25 * speed / (self.scene.fps * self.scene.dx))
        thin = dataclasses.replace(span, grid=dataclasses.replace(span.grid, slack=slack))
        part = self.solver.active(state, thin)
        assert part is not None
        return thin if len(part.nodes) < SPARSE_SHARE * span.grid.nodes else span

    def halved(self, span: Span) -> Span:
        """The same frame in twice as many substeps."""
        return dataclasses.replace(span, dt=0.5 * span.dt, n_sub=2 * span.n_sub)

    def outrun(self, span: Span, end: State) -> bool:
        """Whether waves at the end of a frame are too fast for the step it was made with."""
        return self.dt is None and span.dt * self.stiff(end) > span.grid.dx

    def _block(self, state: State, speed: float) -> Grid:
        """Where the particles may get to in a frame: falling freely, and a quarter of the fastest way aside."""
        T, dx = 1.0 / self.scene.fps, self.scene.dx
        x, v = state.x.detach(), state.v.detach()
        g = torch.tensor(self.scene.gravity, dtype=torch.float64)
        slack = dx + 0.25 * speed * T
        down = (x.amin(0).cpu() + (v.amin(0).cpu().clamp_max(0) * T + g.clamp_max(0) * T * T / 2)).double() - slack
        up = (x.amax(0).cpu() + (v.amax(0).cpu().clamp_min(0) * T + g.clamp_min(0) * T * T / 2)).double() + slack
        self._check_places(state, max(float(down.abs().max()), float(up.abs().max())))
        return Grid.around(down.tolist(), up.tolist(), dx, self.scene.scheme.order, self.solver.shift)

    def _check_places(self, state: State, reach: float) -> None:
        """Refuse places that the precision of a state does not tell apart."""
        dtype, dx = state.x.dtype, self.scene.dx
        rounding = 0.5 * torch.finfo(dtype).eps * reach
        if rounding > FINEST * dx:
            raise (ValueError if state.time == 0.0 else SimulationDiverged)(
                f"{str(dtype).removeprefix('torch.')} rounds places to {rounding:.2g} m at {reach:.4g} m from the "
                f"origin, where particles are to get by t = {state.time + 1.0 / self.scene.fps:.4g} s: more than "
                f"{FINEST:g} of a cell of {dx:.3g} m; move the scene to the origin, enlarge dx, or use float64"
            )
