"""What is timed: a cube of one material that turns in free fall, 8 particles a cell; and the clock it is timed with."""

import dataclasses
import math
import os
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass

import torch
import warp as wp

from diffuphy.cost import machine
from diffuphy.material import make_mixture
from diffuphy.mpm import HalfSpace, Matter, Scene, Scheme, Solver, Span, State
from diffuphy.mpm.engine.clock import Clock
from diffuphy.mpm.state import REAL, Bars, initial_state, make_matter
from diffuphy.types import MaterialField

Laws = tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]
"""Elastic and plastic laws, and branches."""

CASES: dict[str, Laws] = {
    "neo-Hookean": (("neo_hookean",), ("identity",), ()),
    "fixed corotated": (("fixed_corotated",), ("identity",), ()),
    "Hencky, von Mises": (("hencky",), ("von_mises",), ()),
    "3 elastic, 3 plastic": (
        ("neo_hookean", "fixed_corotated", "hencky"),
        ("identity", "von_mises", "drucker_prager"),
        (),
    ),
}
SCHEMES = {"default": Scheme(), "mls": Scheme.mls()}
N_SUB = 30

VALUES = {"E": 1e5, "nu": 0.3, "yield_stress": 1e3, "friction_angle": 30.0, "cohesion": 0.0, "viscosity": 10.0}
"""Parameters of the cube [SI]; others take the default of the law."""


def now(device: str = "cpu") -> float:
    """Processor time of this process; on a GPU the time at which it has done everything [s]."""
    if device == "cpu":
        return time.process_time()
    wp.synchronize_device(device)
    return time.perf_counter()


def timed(what: Callable[[], object], device: str = "cpu") -> float:
    """Time that something takes [s]."""
    begin = now(device)
    what()
    return now(device) - begin


def describe(device: str = "cpu") -> str:
    """The machine, in words."""
    if device != "cpu":
        return f"{machine.name(device)}, torch {torch.__version__}, Warp {wp.config.version}"
    return (
        f"one of {os.cpu_count()} cores ({machine.name()}, {platform.machine()}), torch {torch.__version__}, "
        f"Warp {wp.config.version}"
    )


@dataclass(frozen=True)
class Body:
    """A cube of one material in motion, and one frame of ``N_SUB`` substeps."""

    solver: Solver
    """The solver of its scene."""
    state: State
    """Its particles."""
    matter: Matter
    """Their material."""
    span: Span
    """The frame."""

    @property
    def particles(self) -> int:
        """How many there are."""
        return len(self.state.x)

    @property
    def device(self) -> str:
        """Where it is."""
        return self.solver.device.type

    def forward(self) -> float:
        """Time of a frame [s]."""
        return timed(lambda: self.solver.advance(self.state, self.matter, self.span), self.device)

    def backward(self, kept: bool) -> float:
        """Time of the backward pass of a frame [s], from substeps that the forward pass kept or by running them
        again."""
        source = self.solver.advance(self.state, self.matter, self.span, keep=True)[2] if kept else None
        bars = Bars(*(None if t is None else torch.ones_like(t) for t in self.state.tensors()))  # type: ignore[arg-type]
        begin = now(self.device)
        self.solver.advance_adjoint(self.state, self.matter, self.span, bars, (True, True, True, True), kept=source)
        return now(self.device) - begin

    def launches(self) -> float:
        """Kernels launched a round between particles and grid, forward."""
        count, launch = [], wp.Launch.launch
        wp.Launch.launch = lambda self, *a, **k: (count.append(1), launch(self, *a, **k))[1]
        try:
            self.forward()
        finally:
            wp.Launch.launch = launch
        return len(count) / self.span.steps

    def bytes(self) -> dict[str, float]:
        """Memory of a particle's state and material, and of a node's buffers forward [byte]."""
        tensors = [t for t in (*self.state.tensors(), *self.matter.tensors()) if t is not None]
        v = self.solver.variant
        rows = 2 + v.two_passes + v.scheme.sharpen  # momentum, velocity; between passes; sharpening
        return {
            "bytes_a_particle": sum(t.nbytes for t in tensors) / self.particles,
            "bytes_a_node": rows * v.node_t._length_ * self.state.x.element_size(),
        }


def cube(n: int, dtype: torch.dtype, fill: float = 1.0) -> tuple[torch.Tensor, torch.Tensor, float]:
    """Positions and volumes of n particles in half a metre, each anywhere in the middle of its place; and Δx.

    Args:
        fill: share of the box that is occupied: the rest lies between two halves of the cube [-].
    """
    side = math.ceil(n ** (1 / 3))
    spacing = 0.5 / side
    a = torch.arange(side, dtype=dtype)
    x = torch.cartesian_prod(a, a, a)[:n]
    jitter = torch.rand(x.shape, generator=torch.Generator().manual_seed(0), dtype=dtype) - 0.5
    x = (x + 0.5 + 0.4 * jitter) * spacing
    x[: n // 2, 0] -= 0.5 * (1 / fill - 1)
    return x, torch.full((n,), spacing**3, dtype=dtype), 2 * spacing


def material(laws: Laws, n: int, dtype: torch.dtype) -> MaterialField:
    """Equal weights on every law."""
    elastic, plastic, branches = laws
    params = make_mixture(elastic, plastic, REAL[dtype], branches).params
    from diffuphy.material import ELASTIC, PLASTIC
    from diffuphy.material.branch import BRANCHES

    known = {p.name: p.default for r in (ELASTIC, PLASTIC, BRANCHES) for law in r.values() for p in law.params}
    theta = {k: torch.full((n,), VALUES.get(k, known[k]), dtype=dtype) for k in params}
    weights = [torch.full((n, len(k)), 1 / len(k), dtype=dtype) for k in (elastic, plastic)]
    return MaterialField(elastic, plastic, *weights, theta, torch.full((n,), 1000.0, dtype=dtype), branches)


def body(
    case: str | Laws, scheme: Scheme, n: int, dtype: torch.dtype, grad: bool = True, *, device: str = "cpu",
    fill: float = 1.0, floor: bool = False,
) -> Body:  # fmt: skip
    """The cube of a case, or of some laws.

    Args:
        grad: whether its backward pass is timed.
        fill: see ``cube``.
        floor: put it on a floor with friction.
    """
    laws = CASES[case] if isinstance(case, str) else case
    x, vol, dx = (t.to(device) if isinstance(t, torch.Tensor) else t for t in cube(n, dtype, fill))
    field = material(laws, n, dtype).to(device)
    walls = (HalfSpace(point=(0.0, 0.0, 0.1), friction=0.5),) if floor else ()
    scene = Scene(dx=dx, boundaries=walls, spin=(0.0, 0.0, 3.0), lift=0.0, scheme=scheme)
    mixture = make_mixture(*laws[:2], REAL[dtype], laws[2])
    matter = make_matter(field, vol, mixture.params, dtype)
    extent = x.amin(0).tolist(), x.amax(0).tolist()
    solver = Solver(mixture, walls, scene.gravity, dtype, device, particles=n, dx=dx, extent=extent, scheme=scheme,
                    grad=grad)  # fmt: skip
    state = initial_state(scene, x, matter, mixture, 0.1 * torch.sin(10 * x))
    span = Clock(scene, solver, field, matter, None).span(state)
    return Body(solver, state, matter, dataclasses.replace(span, n_sub=N_SUB))
