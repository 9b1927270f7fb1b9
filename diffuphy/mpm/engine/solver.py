"""One frame forward, one frame backward, on buffers that belong to one solver.

Several solvers may run in several threads; one solver may not. Nothing here decides a step or a block of nodes:
``rollout`` does.
"""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import torch
import warp as wp
from torch import Tensor

from diffuphy.mpm.boundary import N_WALL, Boundary, can_be_elastic, signature, wall_gradients
from diffuphy.mpm.drive import Drive, drive_signature, make_drives, mass_gradient
from diffuphy.mpm.engine.active import Active, active
from diffuphy.mpm.engine.launch import Arguments, Bound, Lanes
from diffuphy.mpm.engine.program import backward, forward
from diffuphy.mpm.grid import Grid
from diffuphy.mpm.scheme import Scheme
from diffuphy.mpm.span import Span
from diffuphy.mpm.state import REAL, Bars, Matter, Rows, State, state_bytes
from diffuphy.mpm.substep.adjoint import Needs
from diffuphy.mpm.substep.gather import Sums
from diffuphy.mpm.substep.mirror import REACH, Extent, Mirrors, mirrors
from diffuphy.mpm.substep.variant import Variant

SEGMENT_BYTES = 3 * 2**24
"""Memory the stored substeps of one frame may take in the backward pass before they are cut into segments [byte]; a
frame of 100 substeps of 8000 particles in float32 fits in two segments."""

Body = Callable[[float], Tensor]
"""Acceleration of every particle at a time [s], shape (N, 3) [m/s²]."""


def segment_of(steps: int, row: int, budget: int = SEGMENT_BYTES) -> int:
    """How many of the ``steps`` rounds of a frame the backward pass keeps at once, when a state takes ``row`` bytes.

    In c segments (1 − 1/c) of the rounds are run once more, and steps/c + c states are kept: the fewest segments that
    fit into ``budget``, or √steps.
    """
    for c in range(1, round(steps**0.5) + 1):
        if (-(-steps // c) + c) * row <= budget:
            return -(-steps // c)
    return max(1, round(steps**0.5))


def backward_bytes(state: State, frames: int, steps: int, *, segment: int | None = None, keep: bool = False) -> int:
    """Memory that states take in a backward pass through ``frames`` frames of ``steps`` rounds each [byte].

        frames · row + rows of one frame at work,   kept: every round of every frame

    Beside it there are the gradients, of the size of two states and the parameters, and six rows of eight numbers a
    node (with several threads one more for each copy).

    Args:
        state: any state of the rollout.
        steps: rounds of a frame, ``Span.steps``.
        segment, keep: as for ``simulate``.
    """
    row = state_bytes(state)
    if keep:
        return frames * (steps + 1) * row
    part = min(segment or segment_of(steps, row), steps)
    return (frames + part + 1 + -(-steps // part) - 1) * row


class Solver:
    """Runs the substeps of a frame, forward or backward.

    Args:
        mixture: laws, from ``material.make_mixture``.
        boundaries: walls; a solver without any has no wall code.
        gravity: acceleration [m/s²].
        dtype: torch.float32 or torch.float64.
        device: where the tensors are.
        particles: how many there are in one scene.
        dx: node spacing [m].
        extent: lowest and highest coordinates of the particles [m]; a wall with matter behind it is not a mirror.
        scheme: transfer and time integration.
        drives: forces and prescribed motions of particles; without any there is no code for them.
        body: an acceleration of every particle, or None.
        gather: sums that ``advance`` will be asked for.
        grad: whether ``advance_adjoint`` will be called.
        scenes: scenes one after the other in every tensor, each on a grid of its own.
        threads: threads that launch, on a CPU.
    """

    def __init__(
        self,
        mixture: Any,
        boundaries: Sequence[Boundary],
        gravity: Sequence[float],
        dtype: torch.dtype,
        device: torch.device | str,
        *,
        particles: int,
        dx: float,
        extent: Extent | None = None,
        scheme: Scheme = Scheme(),  # noqa: B008, frozen
        drives: Sequence[Drive] = (),
        body: Body | None = None,
        gather: Sequence[str] = (),
        grad: bool = True,
        scenes: int = 1,
        threads: int = 1,
    ):
        if dtype not in REAL:
            raise ValueError(
                f"a simulation runs in torch.float32 or torch.float64, got {dtype}; convert the particles first"
            )
        wp.init()
        self.mixture, self.scheme, self.gravity, self.body = mixture, scheme, tuple(gravity), body
        self.dtype, self.device = dtype, torch.device(device)
        self.planes, walls = mirrors(boundaries, dx, extent) if scheme.mirror else (Mirrors(), tuple(boundaries))
        if not can_be_elastic(walls):
            scheme = dataclasses.replace(scheme, contact="rigid")
        holding = (k for k, b in enumerate(walls) if b.kind != "separate" and k not in self.planes.walls)
        self.variant = Variant(
            mixture, REAL[dtype], scheme, signature(walls, scheme.contact == "elastic"),
            tuple(holding) if scheme.sharpen else (), self.planes.any,
            drive_signature(drives), body is not None, "impulse" in gather, grad or "expected_dv" in gather,
        )  # fmt: skip
        lanes = Lanes(scenes, particles, threads if self.device.type == "cpu" else 1)
        self._active: tuple[Tensor | None, Grid | None, float, Active | None] = (None, None, 0.0, None)
        self._args = Arguments(self.variant, walls, tuple(drives), self.planes, self.gravity, lanes, self.device)

    @property
    def shift(self) -> tuple[float, float, float]:
        """Shift of the lattice that puts a plane of nodes on every mirror wall [Δx]."""
        return self.planes.shift

    def steer(self, drives: Sequence[Drive]) -> None:
        """Work on with other drives of the same kinds."""
        self._args.steer(drives)

    # ------------------------------------------------------------------ forward
    def advance(
        self, state: State, matter: Matter, span: Span, keep: bool = False, sums: Sums | None = None
    ) -> tuple[State, list[int], Rows | None]:
        """The state after ``span``; for each of LEFT, INVERTED, FAST one more than the index of a particle that did so
        (0: none); and, if ``keep``, every state on the way, for ``advance_adjoint``. What ``sums`` asks for is added
        to it."""
        with self._args.stream():
            work = Rows(self.variant, state, slots=span.steps + 1 if keep else 1)
            status = torch.zeros(3, dtype=torch.int32, device=self.device)
            bound, before = self._bind(work, matter, state, span)
            a = work.arrays
            flowed = self._room(work.n) if keep else (a.He, a.HN)
            program = forward(bound, wp.from_torch(status), flowed, sums)
            program.run(self._rounds(range(span.steps), work.n if keep else 0), before)
            u, v, C, He, H, memory, HN = work.take(span.steps if keep else 0)
            assert u is not None and v is not None and C is not None and He is not None
            end = State(state.x.detach() + u, v, C, He, H, memory, HN, span.end)
            return end, status.tolist(), work if keep else None

    def watch(self, state: State, matter: Matter, span: Span) -> Iterator[tuple[int, list[int], State]]:
        """The rounds of ``span`` one by one, slowly: number, status as of ``advance``, and the state after it. What is
        handed out last holds until the next is asked for."""
        with self._args.stream():
            work = Rows(self.variant, state, slots=1)
            status = torch.zeros(3, dtype=torch.int32, device=self.device)
            bound, before = self._bind(work, matter, state, span)
            program = forward(bound, wp.from_torch(status), (work.arrays.He, work.arrays.HN))
            for numbers in self._rounds(range(span.steps), 0):
                program.run([numbers], before)
                u, v, C, He, H, memory, HN = work.take(0)
                assert u is not None and v is not None and C is not None and He is not None
                time = min(span.start + (numbers["s"] + 1) * span.dt, span.end)
                yield numbers["s"], status.tolist(), State(state.x.detach() + u, v, C, He, H, memory, HN, time)

    def _bind(self, work: Rows, matter: Matter, state: State, span: Span) -> tuple[Bound, Callable[[int], None] | None]:
        """Arguments of a frame that begins with ``state``; and what is to be done before every round."""
        body, active = self.body, self.active(state, span)
        if body is None:
            return Bound(self._args, work, matter, span, None, active), None
        now = torch.empty(work.n, 3, dtype=self.dtype, device=self.device)

        def accelerate(s: int) -> None:
            now.copy_(body(span.start + s * span.dt))

        return Bound(self._args, work, matter, span, now, active), accelerate

    def active(self, state: State, span: Span) -> Active | None:
        """The nodes that a frame from ``state`` works on; None: all."""
        if span.grid.slack is None:
            return None
        T = span.n_sub * span.dt
        x, grid, time, known = self._active
        if x is not state.x or grid != span.grid or time != T or known is None:
            planes, order = self.planes.planes(span.grid), self.scheme.order
            known = active(state.x, state.v, span.grid, T, self.gravity, order, planes, REACH)
            self._active = state.x, span.grid, T, known
        return known

    def _rounds(self, which: Sequence[int], stride: int) -> list[dict[str, int]]:
        """Numbers of some rounds in order, whose states lie ``stride`` rows apart."""
        still = self._args.still
        return [
            {"s": s, "ws": 0 if still else s, "at": i * stride, "to": (i + 1) * stride} for i, s in enumerate(which)
        ]

    def _room(self, n: int) -> tuple[wp.array, wp.array]:
        """Room for the elastic parts of one state after flow."""
        v, mix = self.variant, self.mixture
        return self._args.zeros(n if mix.is_plastic else 0, v.mat33), self._args.zeros(
            n if mix.branches else 0, v.mat33
        )

    # ------------------------------------------------------------------ backward
    def advance_adjoint(
        self,
        state: State,
        matter: Matter,
        span: Span,
        bars: Bars,
        needs: Needs,
        *,
        segment: int | None = None,
        kept: Rows | None = None,
        gravity: bool = False,
        walls: bool = False,
        wave: bool = False,
        watch: Callable[[int, Bars], None] | None = None,
    ) -> Bars:
        """Gradients with respect to ``state``, to (w_e, w_p, θ, m) and to the scene, given those with respect to the
        state after ``span``.

        Substeps are run again from ``state``, ``segment`` at a time, so that at most steps/segment + segment states
        are in memory; the result does not depend on it. By default all at once if that takes less than SEGMENT_BYTES.

        Args:
            bars: gradients in the fields of a state; they are overwritten.
            needs: which of w_e, w_p, θ, m want one.
            kept: what ``advance`` kept; then nothing is run again.
            gravity, walls, wave: whether gravity, the data of the walls and what goes by the fastest wave want one.
            watch: is told the number of every round that has been gone back through, and the gradients so far.
        """
        segment = span.steps if kept is not None else min(segment or self._segment(state, span), span.steps)
        with self._args.stream():
            starts = list(range(0, span.steps, segment))
            work = Rows(self.variant, state, slots=segment + 1) if kept is None else kept
            bound, before = self._bind(work, matter, state, span)
            flowed = self._room(work.n)
            again = forward(bound, bound.status, flowed)
            bars = self._with_room(bars, matter, span, needs, gravity, walls, wave)
            back = backward(bound, bars, needs, flowed)
            saved = []
            for s in starts[:-1]:
                saved.append(work.take(0))
                again.run(self._rounds(range(s, s + segment), work.n), before)
                work.put(work.take(segment))
            for s in reversed(starts):
                if s != starts[-1]:
                    work.put(saved.pop())
                rounds = self._rounds(range(s, min(s + segment, span.steps)), work.n)
                if kept is None:
                    again.run(rounds, before)
                backwards = [r | {"to": 0} for r in reversed(rounds)]  # what p2g writes again is scratch
                if watch is None:
                    back.run(backwards, before)
                else:
                    for r in backwards:
                        back.run([r], before)
                        watch(r["s"], bars)
        if bars.push is None or bars.m is None or matter.tag is None:
            return bars
        shared = mass_gradient(self._args.drives, matter.m, matter.tag, bars.push)
        return dataclasses.replace(bars, m=bars.m + shared)

    def wall_gradients(self, span: Span, bars: Bars) -> tuple[Tensor, Tensor, Tensor] | None:
        """Gradients in friction, velocity and angular velocity of the walls, from those in their data."""
        args = self._args
        return None if bars.walls is None else wall_gradients(args.boundaries, args.times(span), bars.walls)

    def _segment(self, state: State, span: Span) -> int:
        """Rounds that are kept at once unless told otherwise."""
        return segment_of(span.steps, state_bytes(state))

    def _with_room(
        self, bars: Bars, matter: Matter, span: Span, needs: Needs, gravity: bool, walls: bool, wave: bool
    ) -> Bars:
        """Room for the other gradients that are wanted."""
        wanted = zip(("w_e", "w_p", "theta", "m"), matter.tensors()[:4], needs, strict=True)
        more = {name: torch.zeros_like(t) for name, t, need in wanted if need}
        new = matter.m.new_zeros
        if gravity:
            more["gravity"] = new(span.grid.nodes * self._args.lanes.scenes, 3)
        if needs[3] and (impulses := make_drives(self.variant.drives, self.variant.real).impulses):
            more["push"] = new(len(matter.m), impulses)
        if wave and self.scheme.keeps:
            more["alpha"] = new(len(matter.m))
        if self.variant.elastic:
            more["omega"] = new(span.grid.nodes * self._args.lanes.scenes)
        if walls:
            more["walls"] = new(1 if self._args.still else span.steps, len(self._args.boundaries), N_WALL)
        return dataclasses.replace(bars, **more)
