"""One frame forward, one frame backward: the kernels in order, on buffers that belong to one solver.

Several solvers may run in several threads; one solver may not. Nothing here decides a step or a block of nodes:
``rollout`` does.
"""

from collections.abc import Callable, Sequence
from typing import Any

import torch
import warp as wp
from torch import Tensor

from diffuphy.mpm.adjoint import Needs, make_adjoint
from diffuphy.mpm.boundary import Boundary, signature
from diffuphy.mpm.gather import Sums, make_gather
from diffuphy.mpm.kernels import make_kernels
from diffuphy.mpm.launch import Arguments, set_integers
from diffuphy.mpm.state import REAL, Matter, Rows, Span, State, view

SEGMENT_BYTES = 2**28
"""Memory the stored substeps of one frame may take in the backward pass before they are cut into segments [byte]."""


class Solver:
    """Runs the substeps of a frame, forward or backward.

    Args:
        mixture: laws, from ``material.mixture.make_mixture``.
        boundaries: walls; a solver without any has no wall code.
        gravity: acceleration [m/s²].
        dtype: torch.float32 or torch.float64.
        device: where the tensors are.
    """

    def __init__(
        self,
        mixture: Any,
        boundaries: Sequence[Boundary],
        gravity: Sequence[float],
        dtype: torch.dtype,
        device: torch.device | str,
    ):
        if dtype not in REAL:
            raise ValueError(
                f"a simulation runs in torch.float32 or torch.float64, got {dtype}; convert the particles first"
            )
        wp.init()
        self.mixture, self.boundaries, self.gravity = mixture, tuple(boundaries), tuple(float(g) for g in gravity)
        self.dtype, self.device, self.real = dtype, torch.device(device), REAL[dtype]
        self.walls = signature(self.boundaries)
        self.kernels = make_kernels(mixture, self.walls, self.real)
        self._arguments = Arguments(self.kernels, self.boundaries, self.gravity, dtype, self.device)

    # ------------------------------------------------------------------ forward
    def advance(
        self, state: State, matter: Matter, span: Span, keep: bool = False, sums: Sums | None = None
    ) -> tuple[State, list[int], Rows | None]:
        """The state after ``span``; for each of LEFT, INVERTED, FAST one more than the index of a particle that did so
        (0: none); and, if ``keep``, every state on the way, for ``advance_adjoint``. What ``sums`` asks for is added
        to it."""
        with self._arguments.stream():
            work = Rows(self.kernels, state, slots=span.n_sub + 1 if keep else 1)
            status = torch.zeros(3, dtype=torch.int32, device=self.device)
            flowed = torch.empty_like(state.He) if keep and self.mixture.is_plastic else None
            substeps = self._forward(work, matter, span, status, flowed, sums)
            if keep:
                self._replay(substeps, work.n)
            else:
                for substep in substeps:
                    substep(0, 0)
            u, v, C, He, *more = work.take(span.n_sub) if keep else work.parts()
            end = State(state.x.detach() + u, v, C, He, *more, *(None,) * (2 - len(more)), span.end)
            return end, status.tolist(), work if keep else None

    def _forward(
        self, work: Rows, matter: Matter, span: Span, status: Tensor, flowed: Tensor | None, sums: Sums | None = None
    ) -> list[Callable[[int, int], None]]:
        """The substeps of ``span`` as functions of the rows to read and to write."""
        args, k, plastic = self._arguments, self.kernels, self.mixture.is_plastic
        low, n, dx, dt = args.frame(span)
        grid, grid_v = args.nodal("grid", span.grid), args.nodal("grid_v", span.grid)
        a, mat, row = work.arrays, args.matter(matter), args.rows(span)
        He_out = a.He if flowed is None else view(flowed, k.mat33, self.device)
        st = wp.from_torch(status)
        now = [a.X, a.u, a.v, a.C, a.He, a.log_J]
        p2g = args.record(k.p2g, work.n, [*now, *mat, low, dx, dt, n, 0, grid, He_out, st])
        grid_update = args.record(
            k.grid_update, span.grid.nodes, [grid, row, args.sdf, 0, args.kick(span), dx, n, grid_v]
        )
        g2p = args.record(
            k.g2p, work.n,
            [
                a.X, a.u, He_out if plastic else a.He, a.H, a.log_J, grid_v, low, dx, dt, n, 0, 0,
                a.u, a.v, a.C, a.He, a.H, a.log_J, st,
            ],
        )  # fmt: skip
        gather = None if sums is None else self._gather(work, mat[3], span, grid, row, sums)

        def step(s: int, at: int, to: int) -> None:
            if at != to:
                set_integers(p2g, at=at)
                set_integers(g2p, at=at, to=to)
            if not args.still:
                set_integers(grid_update, s=s)
            p2g.launch()
            if gather is not None:
                gather(s, at)
            grid_update.launch()
            g2p.launch()

        return [lambda at, to, s=s: step(s, at, to) for s in range(span.n_sub)]

    def _gather(
        self, work: Rows, m: wp.array, span: Span, grid: wp.array, row: wp.array, sums: Sums
    ) -> Callable[[int, int], None]:
        """What one substep adds to ``sums`` between p2g and grid_update, as a function of its number and of the row to
        read."""
        args, a = self._arguments, work.arrays
        k, kick = make_gather(self.mixture, self.walls, self.real), args.kick(span)
        low, n, dx, _ = args.frame(span)
        forces, walls, free = [], None, None
        if sums.expected_dv is not None:
            free, out = args.nodal("free", span.grid), view(sums.expected_dv, self.kernels.vec3, self.device)
            forces = [
                args.record(k.p2g_free, work.n, [a.X, a.u, a.v, a.C, m, low, dx, n, 0, free]),
                args.record(k.add_forces, work.n, [a.X, a.u, grid, free, kick, low, dx, n, 0, out]),
            ]
        if sums.nodal is not None and self.walls:
            nodal = view(sums.nodal, self.kernels.vec3, self.device)
            walls = args.record(k.add_walls, span.grid.nodes, [grid, row, args.sdf, 0, kick, dx, n, nodal])

        def add(s: int, at: int) -> None:
            if free is not None:
                free.zero_()
            for command in forces:
                set_integers(command, at=at)
                command.launch()
            if walls is not None:
                if not args.still:
                    set_integers(walls, s=s)
                walls.launch()

        return add

    # ------------------------------------------------------------------ backward
    def advance_adjoint(
        self,
        state: State,
        matter: Matter,
        span: Span,
        bars: State,
        needs: Needs,
        *,
        segment: int | None = None,
        kept: Rows | None = None,
    ) -> tuple[State, tuple[Tensor | None, Tensor | None, Tensor | None, Tensor | None]]:
        """Gradients with respect to ``state`` and to (w_e, w_p, θ, m), given those with respect to the state after
        ``span``.

        Substeps are run again from ``state``, ``segment`` at a time, so that at most n_sub/segment + segment states
        are in memory; the result does not depend on it. By default all at once if that takes less than SEGMENT_BYTES.

        Args:
            bars: gradients in the fields of a state; they are overwritten.
            needs: which of w_e, w_p, θ, m want one.
            kept: what ``advance`` kept; then nothing is run again.
        """
        per_state = sum(
            t[0].numel() for t in (state.x, state.v, state.C, state.He, state.H, state.log_J) if t is not None
        )
        per_state *= state.x.shape[0] * state.x.element_size()
        if segment is None:
            fits = (span.n_sub + 1) * per_state <= SEGMENT_BYTES
            segment = span.n_sub if fits else max(1, round(span.n_sub**0.5))
        segment = span.n_sub if kept is not None else min(segment, span.n_sub)
        with self._arguments.stream():
            starts = list(range(0, span.n_sub, segment))
            work = Rows(self.kernels, state, slots=segment + 1) if kept is None else kept
            flowed = torch.empty_like(state.He) if self.mixture.is_plastic else None
            status = torch.zeros(3, dtype=torch.int32, device=self.device)
            substeps = self._forward(work, matter, span, status, flowed)
            saved = []
            for s in starts[:-1]:
                saved.append(work.take(0))
                self._replay(substeps[s : s + segment], work.n)
                work.put(work.take(segment))
            matter_bars = tuple(
                torch.zeros_like(t) if need else None
                for t, need in zip((matter.w_e, matter.w_p, matter.theta, matter.m), needs, strict=True)
            )
            back = self._backward(work, matter, span, bars, needs, matter_bars, flowed)
            for s in reversed(starts):
                if s != starts[-1]:
                    work.put(saved.pop())
                n = min(segment, span.n_sub - s)
                if kept is None:
                    self._replay(substeps[s : s + n], work.n)
                for i in reversed(range(n)):
                    back(s + i, i * work.n, (i + 1) * work.n)
        return bars, matter_bars  # type: ignore[return-value]

    @staticmethod
    def _replay(substeps: list[Callable[[int, int], None]], n: int) -> None:
        for i, substep in enumerate(substeps):
            substep(i * n, (i + 1) * n)

    def _backward(
        self, work: Rows, matter: Matter, span: Span, bars: State,
        needs: Needs, matter_bars: tuple[Tensor | None, ...], flowed: Tensor | None,
    ) -> Callable[[int, int, int], None]:  # fmt: skip
        """One substep backwards, as a function of its number and of the rows of its two ends."""
        args, k, mix = self._arguments, self.kernels, self.mixture
        adj = make_adjoint(mix, self.walls, self.real)
        low, n, dx, dt = args.frame(span)
        grid, grid_v, grid_bar = (args.nodal(name, span.grid) for name in ("grid", "grid_v", "grid_bar"))
        a, mat, row, kick = work.arrays, args.matter(matter), args.rows(span), args.kick(span)
        He = a.He if flowed is None else view(flowed, k.mat33, self.device)
        scratch = view(flowed, k.mat33, self.device) if flowed is not None else a.He
        status = wp.zeros(3, dtype=wp.int32, device=str(self.device))
        pairs = ((bars.x, k.vec3), (bars.v, k.vec3), (bars.C, k.mat33), (bars.He, k.mat33))
        b = [view(t, d, self.device) for t, d in pairs]
        H_bar, log_J_bar = view(bars.H, k.mat33, self.device), view(bars.log_J, self.real, self.device)
        mb = [
            view(t, d, self.device)
            for t, d in zip(matter_bars, (mix.w_e_t, mix.w_p_t, mix.theta_t, self.real), strict=True)
        ]
        N, nodes = work.n, span.grid.nodes
        now = [a.X, a.u, a.v, a.C, a.He, a.log_J]
        p2g = args.record(k.p2g, N, [*now, *mat, low, dx, dt, n, 0, grid, scratch, status])
        again = args.record(adj.grid_again, nodes, [grid, row, args.sdf, 0, kick, dx, n, grid_v, grid_bar])
        g2p = args.record(
            adj.g2p_adjoint, N, [a.X, a.u, He, a.H, a.C, grid_v, low, dx, dt, n, 0, 0, *b, H_bar, log_J_bar, grid_bar]
        )
        grid_adjoint = args.record(adj.grid_adjoint, nodes, [grid, row, args.sdf, 0, kick, dx, n, grid_bar])
        p2g_adjoint = args.record(
            adj.p2g_adjoint, N, [*now, *mat, low, dx, dt, n, 0, grid_bar, *b, log_J_bar, *mb, *needs]
        )

        def step(s: int, at: int, to: int) -> None:
            set_integers(p2g, at=at)
            set_integers(g2p, at=at, to=to)
            set_integers(p2g_adjoint, at=at)
            if not args.still:
                set_integers(again, s=s)
                set_integers(grid_adjoint, s=s)
            for command in (p2g, again, g2p, grid_adjoint, p2g_adjoint):
                command.launch()

        return step
