"""What kernels are launched with, and how: arguments made from results, launches recorded once, threads in step."""

import contextlib
import dataclasses
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
from diffuphy.mpm.drive import Drive, drive_rows, drive_signature, make_drives
from diffuphy.mpm.engine.active import Active
from diffuphy.mpm.span import Span
from diffuphy.mpm.state import Matter, Rows, view
from diffuphy.mpm.substep.barrier import Halted, Step
from diffuphy.mpm.substep.mirror import Mirrors
from diffuphy.mpm.substep.variant import Variant

Range = tuple[int, int]
"""First index and number of what one thread works on."""

NUMBERS = ("s", "ws", "at", "to")
"""Arguments that differ between rounds: the round, its row of wall data, first rows of its state and of the next."""


def alone(ranges: list[Range]) -> list[Range]:
    """The same work for the first thread, none for the others."""
    total = sum(count for _, count in ranges)
    return [(ranges[0][0], total)] + [(ranges[0][0] + total, 0)] * (len(ranges) - 1)


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

    def of_nodes(self, total: int) -> list[Range]:
        """The nodes of each thread, out of those of all scenes that are worked on."""
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

    def steer(self, drives: Sequence[Drive]) -> None:
        """Take other drives: kernels are compiled for their kinds and regions alone.

        Raises:
            ValueError: other kinds or regions.
        """
        was, now = drive_signature(self.drives), drive_signature(drives)
        if was != now:
            raise ValueError(f"steering must keep the kinds and regions of drives, {was}, got {now}")
        self.drives = tuple(drives)

    def array(self, data: np.ndarray, kind: Any) -> wp.array:
        """Numbers as a Warp array on the device."""
        return wp.array(data, dtype=kind, device=str(self.device))

    def view(self, t: Tensor | None, kind: Any) -> wp.array:
        """A tensor as a Warp array; an empty one for None."""
        return view(t, kind, self.device)

    def zeros(self, count: int | tuple[int, ...], kind: Any) -> wp.array:
        """Zeros."""
        return wp.zeros(count, dtype=kind, device=str(self.device))

    def times(self, span: Span) -> np.ndarray:
        """When walls are looked at, in every round [s]; once when all walls stand still."""
        times = span.start + span.dt * np.arange(1 if self.still else span.steps)
        if span.half_kick and not self.still:  # the last kick belongs to what ends with the frame
            times[-1] -= 1e-6 * span.dt
        return times

    def walls(self, span: Span) -> wp.array:
        """Wall data of these times."""
        kind = wp.types.vector(N_WALL, self.variant.real)
        if not self.boundaries:
            return wp.zeros((1, 0), dtype=kind, device=str(self.device))
        return self.array(
            rows(self.boundaries, span.grid, self.times(span), self.variant.scheme.contact == "elastic"), kind
        )

    def driven(self, span: Span, matter: Matter) -> wp.array:
        """Drive data of every round."""
        kind = make_drives(self.variant.drives, self.variant.real).drive_t
        if not self.drives:
            return wp.zeros((1, 0), dtype=kind, device=str(self.device))
        starts, kicks = span.start + span.dt * np.arange(span.steps), span.table()[:, 1]
        assert matter.tag is not None
        data = drive_rows(self.drives, span.grid, starts, span.dt, matter.m, matter.tag, kicks)
        return self.array(data, kind)

    def nodal(self, name: str, count: int, kind: Any, clear: Tensor | slice | None = None) -> wp.array:
        """A row a node, zero at first; kept between frames and made larger when a block needs it.

        Args:
            clear: rows that are to be zero again.
        """
        kept = self._nodes.get(name)
        if kept is None or kept.shape[0] < count:
            self._nodes[name] = kept = self._untouched(count + count // 4, kind._length_)
        elif clear is not None:
            kept[clear] = 0.0
        return view(kept, kind, self.device)

    def _untouched(self, rows: int, columns: int) -> Tensor:
        """Zeros; on a CPU the system finds memory for a page when something is written to it."""
        double = self.variant.real is wp.float64
        if self.device.type == "cpu":
            return torch.from_numpy(np.zeros((rows, columns), np.float64 if double else np.float32))
        dtype = torch.float64 if double else torch.float32
        return torch.zeros((rows, columns), dtype=dtype, device=self.device)

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

    def __init__(
        self, args: Arguments, work: Rows, matter: Matter, span: Span, body: Tensor | None, active: Active | None = None
    ):
        v, grid, lanes = dataclasses.replace(args.variant, sparse=active is not None), span.grid, args.lanes
        self.args, self.variant, self.span, self.arrays = args, v, span, work.arrays
        self.particles, self.nodes = lanes.of_particles(), lanes.of_nodes(self._choose(active))
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
        self.grid = args.nodal("grid", count * lanes.copies, v.node_t, clear=self.rows)
        self.acc = args.nodal("acc", count if v.two_passes else 1, v.node_t)
        self.load = args.nodal("load", count, v.node_t) if v.loads else self.acc
        self.pins = self.pin = self.acc
        if v.obstructs:
            self.pins = args.nodal("pins", count * lanes.copies, v.node_t, clear=self.rows)
            self.pin = args.nodal("pin", count, v.node_t)
        self.sigma = args.nodal("sigma", count if v.scheme.sharpen else 1, v.node_t)
        self.grid_v = args.nodal("grid_v", count, v.node_t)

    def _choose(self, active: Active | None) -> int:
        """Which nodes are worked on; their number."""
        args, nodes = self.args, self.span.grid.nodes
        lanes = args.lanes
        self.cells = args.view(None if active is None else active.cells, wp.uint8)
        if active is None:
            self.active = args.view(None, wp.int32)
            self.rows: Tensor | slice = slice(0, nodes * lanes.scenes * lanes.copies)
            return nodes * lanes.scenes
        copies = torch.arange(lanes.scenes * lanes.copies, device=args.device)[:, None] * nodes
        self.rows = (copies + active.nodes).flatten()
        worked = self.rows[: lanes.scenes * len(active.nodes)].to(torch.int32)  # scenes have one copy, or there is one
        self.active = args.view(worked, wp.int32)
        return len(worked)

    @property
    def status(self) -> wp.array:
        """Nobody has done anything wrong."""
        return self.args.zeros(3, wp.int32)


class Command:
    """A launch that can be repeated with other whole numbers."""

    def __init__(self, kernel: wp.Kernel, first: int, count: int, inputs: list[Any], device: str):
        self.empty = count == 0
        if self.empty:
            return
        places = {arg.label: k for k, arg in enumerate(kernel.adj.args)}
        self._takes = [(name, places[name]) for name in NUMBERS if name in places]
        with LOCK:  # the first launch of a kernel builds and loads it
            launch = wp.launch(kernel, dim=count, inputs=inputs, device=device, record_cmd=True)
        assert launch is not None  # it is when a command is recorded
        self._launch = launch
        self._inputs = inputs  # a recorded launch has the addresses of its arrays and does not keep them
        self._launch.set_param_at_index_from_ctype(places["start"], first)

    def __call__(self, numbers: dict[str, int]) -> None:
        """Launch it with those of ``numbers`` that it takes."""
        for name, place in self._takes:
            self._launch.set_param_at_index_from_ctype(place, numbers[name])
        self._launch.launch()


class Program:
    """Phases, each of one command a thread; a phase begins when the one before has ended in every thread. The last
    phase of a round and the first of the next need not wait for each other: a thread works on its own particles in
    both, and writes nodes of its own copy only."""

    def __init__(self, phases: list[list[Command]]):
        self.phases = phases
        self.threads = len(phases[0])

    def run(self, rounds: Sequence[dict[str, int]], before: Callable[[int], None] | None = None) -> None:
        """All phases once for every set of numbers; ``before`` is told the number of each round first.

        Raises:
            Whatever a command or ``before`` raises, in whichever thread; the others stop at their next phase.
        """
        if self.threads == 1:
            for numbers in rounds:
                if before is not None:
                    before(numbers["s"])
                for (command,) in self.phases:
                    command(numbers)
            return
        step, errors = Step(self.threads), []

        def work(t: int) -> None:
            try:
                for numbers in rounds:
                    if before is not None:
                        step.wait(t)
                        if t == 0:
                            before(numbers["s"])
                        step.wait(t)
                    last = len(self.phases) - 1
                    for k, phase in enumerate(self.phases):
                        if not phase[t].empty:
                            phase[t](numbers)
                        if k < last:
                            step.wait(t)
            except Halted:
                pass
            except BaseException as error:
                errors.append(error)
                step.halted = True

        others = [threading.Thread(target=work, args=(t,)) for t in range(1, self.threads)]
        for thread in others:
            thread.start()
        work(0)
        for thread in others:
            thread.join()
        if errors:
            raise errors[0]
