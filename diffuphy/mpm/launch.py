"""What kernels are launched with: their arguments, made from results, and launches recorded once."""

import contextlib
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch
import warp as wp
from torch import Tensor

from diffuphy.compiling import LOCK
from diffuphy.mpm.boundary import Boundary, rows, sdf_samples
from diffuphy.mpm.grid import Grid
from diffuphy.mpm.state import Matter, Span, view


class Arguments:
    """Arguments of the kernels of one solver, and the nodal buffers that belong to it.

    Args:
        kernels: from ``kernels.make_kernels``.
        boundaries: the walls they were made for.
        gravity: acceleration [m/s²].
        dtype: torch.float32 or torch.float64.
        device: where the tensors are.
    """

    def __init__(
        self,
        kernels: SimpleNamespace,
        boundaries: Sequence[Boundary],
        gravity: Sequence[float],
        dtype: torch.dtype,
        device: torch.device,
    ):
        self.kernels, self.boundaries, self.gravity = kernels, boundaries, gravity
        self.dtype, self.device = dtype, device
        self.still = all(b.still for b in boundaries)
        self.sdf = wp.array(sdf_samples(boundaries), dtype=kernels.real, device=str(device))
        self._nodes: dict[str, Tensor] = {}

    def frame(self, span: Span) -> tuple[Any, Any, float, float]:
        """Lowest node [m], nodes along each axis, Δx [m] and Δt [s]."""
        low = self.kernels.vec3(*(o * span.grid.dx for o in span.grid.origin))
        return low, wp.vec3i(*span.grid.shape), span.grid.dx, span.dt

    def kick(self, span: Span) -> Any:
        """What gravity adds to a velocity in a substep, g Δt [m/s]."""
        return self.kernels.vec3(*(g * span.dt for g in self.gravity))

    def rows(self, span: Span) -> wp.array:
        """Wall data of every substep; one row when all walls stand still."""
        times = span.start + span.dt * np.arange(1 if self.still else span.n_sub)
        data = rows(self.boundaries, span.grid, times)
        return (
            wp.array(data, dtype=self.kernels.wall_t, device=str(self.device))
            if self.boundaries
            else wp.zeros((1, 0), dtype=self.kernels.wall_t, device=str(self.device))
        )

    def nodal(self, name: str, grid: Grid) -> wp.array:
        """Four numbers a node, zero at first; kept between frames and made larger when a block needs it."""
        kept = self._nodes.get(name)
        if kept is None or kept.shape[0] < grid.nodes:
            self._nodes[name] = kept = torch.zeros(
                (grid.nodes + grid.nodes // 4, 4), dtype=self.dtype, device=self.device
            )
        if name == "grid":
            kept[: grid.nodes].zero_()
        return view(kept, self.kernels.vec4, self.device)

    def matter(self, matter: Matter) -> list[wp.array]:
        """w_e, w_p, θ, m and vol."""
        k, mix = self.kernels, self.kernels.mixture
        pairs = (
            (matter.w_e, mix.w_e_t),
            (matter.w_p, mix.w_p_t),
            (matter.theta, mix.theta_t),
            (matter.m, k.real),
            (matter.vol, k.real),
        )
        return [view(t, d, self.device) for t, d in pairs]

    def record(self, kernel: wp.Kernel, dim: int, inputs: list[Any]) -> Any:
        """A launch that can be repeated; see ``set_integers``."""
        with LOCK:  # the first launch of a kernel builds and loads it
            return wp.launch(kernel, dim=dim, inputs=inputs, device=str(self.device), record_cmd=True)

    def stream(self) -> contextlib.AbstractContextManager[Any]:
        """Warp's launches go to torch's stream within."""
        if self.device.type == "cpu":
            return contextlib.nullcontext()
        return wp.ScopedStream(wp.stream_from_torch(torch.cuda.current_stream(self.device)))


def set_integers(command: wp.Launch, **integers: int) -> None:
    """Change integer arguments of a recorded launch, by name."""
    names = [arg.label for arg in command.kernel.adj.args]
    for name, value in integers.items():
        command.set_param_at_index_from_ctype(names.index(name), value)
