"""What kernels are launched with, and how: arguments made from results, launches recorded once, threads in step."""

import contextlib
import threading
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import torch
import warp as wp
from torch import Tensor

from diffuphy.compiling import LOCK
from diffuphy.mpm.boundary import N_WALL, Boundary, rows, sdf_samples
from diffuphy.mpm.drive import Drive, drive_rows, make_drives
from diffuphy.mpm.mirror import Mirrors
from diffuphy.mpm.state import Matter, Rows, Span, view
from diffuphy.mpm.variant import Variant

Range = tuple[int, int]
"""First index and number of what one thread works on."""


@dataclass(frozen=True)
class Lanes:
    """How particles share nodes. Particle p scatters into copy p // ``per`` of the nodes, so that no two threads write
    one row; the copies of a scene are summed where they are read. The sums do not depend on how threads interleave."""

    scenes: int
    """Scenes with the same particles, one after the other."""
    particles: int
    """Particles of one scene."""
    threads: int
    """Threads that launch."""

    @property
    def copies(self) -> int:
        """Copies of the nodes of one scene."""
        return self.threads if self.scenes == 1 else 1

    @property
    def per(self) -> int:
        """Particles of a copy."""
        return -(-self.particles // self.copies)

    def of_particles(self) -> list[Range]:
        """The particles of each thread: whole lanes."""
        lanes, total = self.copies * self.scenes, self.particles * self.scenes
        cuts = [min(total, self.per * (lanes * t // self.threads)) for t in range(self.threads + 1)]
        return [(a, b - a) for a, b in pairwise(cuts)]

    def of_nodes(self, nodes: int) -> list[Range]:
        """The nodes of each thread."""
        total = nodes * self.scenes
        cuts = [total * t // self.threads for t in range(self.threads + 1)]
        return [(a, b - a) for a, b in pairwise(cuts)]


class Arguments:
    """What the kernels of one solver are launched with, and the nodal buffers that belong to it."""

    def __init__(
        self,
        variant: Variant,
        boundaries: Sequence[Boundary],
        drives: Sequence[Drive],
        planes: Mirrors,
        gravity: Sequence[float],
        lanes: Lanes,
        device: torch.device,
    ):
        self.variant, self.boundaries, self.drives, self.planes = variant, boundaries, drives, planes
        self.gravity, self.lanes, self.device = variant.vec3(*gravity), lanes, device
        self.still = all(b.still for b in boundaries)
        self.sdf = self.array(sdf_samples(boundaries), variant.real)
        self._nodes: dict[str, Tensor] = {}

    def array(self, data: np.ndarray, kind: Any) -> wp.array:
        """Numbers as a Warp array on the device."""
        return wp.array(data, dtype=kind, device=str(self.device))

    def view(self, t: Tensor | None, kind: Any) -> wp.array:
        """A tensor as a Warp array; an empty one for None."""
        return view(t, kind, self.device)

    def zeros(self, count: int | tuple[int, ...], kind: Any) -> wp.array:
        """Zeros."""
        return wp.zeros(count, dtype=kind, device=str(self.device))

    def walls(self, span: Span) -> wp.array:
        """Wall data of every round; one row when all walls stand still."""
        kind = wp.types.vector(N_WALL, self.variant.real)
        if not self.boundaries:
            return wp.zeros((1, 0), dtype=kind, device=str(self.device))
        times = span.start + span.dt * np.arange(1 if self.still else span.steps)
        if span.half_kick and not self.still:  # the last kick belongs to what ends with the frame
            times[-1] -= 1e-6 * span.dt
        return self.array(rows(self.boundaries, span.grid, times), kind)

    def driven(self, span: Span, matter: Matter) -> wp.array:
        """Drive data of every round."""
        kind = make_drives(self.variant.drives, self.variant.real).drive_t
        if not self.drives:
            return wp.zeros((1, 0), dtype=kind, device=str(self.device))
        starts, kicks = span.start + span.dt * np.arange(span.steps), span.table()[:, 1]
        assert matter.tag is not None
        data = drive_rows(self.drives, span.grid, starts, span.dt, matter.m, matter.tag, kicks)
        return self.array(data, kind)

    def nodal(self, name: str, count: int, kind: Any, clear: bool = False) -> wp.array:
        """A row a node, zero at first; kept between frames and made larger when a block needs it."""
        kept = self._nodes.get(name)
        if kept is None or kept.shape[0] < count:
            dtype = torch.float32 if self.variant.real is wp.float32 else torch.float64
            self._nodes[name] = kept = torch.zeros((count + count // 4, kind._length_), dtype=dtype, device=self.device)
        elif clear:
            kept[:count].zero_()
        return view(kept, kind, self.device)

    def record(self, kernel: wp.Kernel, ranges: Iterable[Range], inputs: list[Any]) -> list["Command"]:
        """One repeatable launch a thread; each begins at its own ``start``."""
        return [Command(kernel, first, count, inputs, str(self.device)) for first, count in ranges]

    def stream(self) -> contextlib.AbstractContextManager[Any]:
        """Warp's launches go to torch's stream within."""
        if self.device.type == "cpu":
            return contextlib.nullcontext()
        return wp.ScopedStream(wp.stream_from_torch(torch.cuda.current_stream(self.device)))


class Bound:
    """Arguments as they are in one frame."""

    def __init__(self, args: Arguments, work: Rows, matter: Matter, span: Span, body: Tensor | None):
        v, grid, lanes = args.variant, span.grid, args.lanes
        self.args, self.variant, self.span, self.arrays = args, v, span, work.arrays
        self.particles, self.nodes = lanes.of_particles(), lanes.of_nodes(grid.nodes)
        self.low, self.dx, self.n = v.vec3(*grid.low), grid.dx, wp.vec3i(*grid.shape)
        self.steps, self.walls = args.array(span.table(), v.step_t), args.walls(span)
        low, high = args.planes.planes(grid)
        self.planes = wp.vec3i(*low), wp.vec3i(*high), wp.vec3i(*(int(s) for s in args.planes.sticky))
        mix = v.mixture
        kinds = (mix.w_e_t, mix.w_p_t, mix.theta_t, v.real, v.real)
        self.matter = [args.view(t, d) for t, d in zip(matter.tensors(), kinds, strict=True)]
        self.body, self.tag = args.view(body, v.vec3), args.view(matter.tag, wp.int32)
        self.drive = args.driven(span, matter)
        count = grid.nodes * lanes.scenes
        self.grid = args.nodal("grid", count * lanes.copies, v.node_t, clear=True)
        self.acc = args.nodal("acc", count if v.two_passes else 1, v.node_t)
        self.sigma = args.nodal("sigma", count if v.scheme.sharpen else 1, v.node_t)
        self.grid_v = args.nodal("grid_v", count, v.node_t)

    @property
    def status(self) -> wp.array:
        """Nobody has done anything wrong."""
        return self.args.zeros(3, wp.int32)


class Command:
    """A launch that can be repeated with other whole numbers."""

    def __init__(self, kernel: wp.Kernel, first: int, count: int, inputs: list[Any], device: str):
        self._places = {arg.label: k for k, arg in enumerate(kernel.adj.args)}
        with LOCK:  # the first launch of a kernel builds and loads it
            self._launch: Any = wp.launch(kernel, dim=count, inputs=inputs, device=device, record_cmd=True)
        self._set("start", first)

    def _set(self, name: str, value: int) -> None:
        self._launch.set_param_at_index_from_ctype(self._places[name], value)

    def __call__(self, numbers: dict[str, int]) -> None:
        """Launch it with those of ``numbers`` that it takes."""
        for name, value in numbers.items():
            if name in self._places:
                self._set(name, value)
        self._launch.launch()


class Program:
    """Phases, each of one command a thread; a phase begins when the one before has ended in every thread."""

    def __init__(self, phases: list[list[Command]]):
        self.phases = phases
        self.threads = len(phases[0])

    def run(self, rounds: Sequence[dict[str, int]], before: Callable[[int], None] | None = None) -> None:
        """All phases once for every set of numbers; ``before`` is told the number of each round first."""
        if before is not None:
            for numbers in rounds:
                before(numbers["s"])
                self.run([numbers])
            return
        if self.threads == 1:
            for numbers in rounds:
                for (command,) in self.phases:
                    command(numbers)
            return
        barrier, errors = threading.Barrier(self.threads), []

        def work(t: int) -> None:
            try:
                for numbers in rounds:
                    for phase in self.phases:
                        phase[t](numbers)
                        barrier.wait()
            except threading.BrokenBarrierError:
                pass
            except BaseException as error:
                errors.append(error)
                barrier.abort()

        others = [threading.Thread(target=work, args=(t,)) for t in range(1, self.threads)]
        for thread in others:
            thread.start()
        work(0)
        for thread in others:
            thread.join()
        if errors:
            raise errors[0]
