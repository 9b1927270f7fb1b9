"""Million particle-substeps per second of processor time, forward and backward, by scheme, material and particles.

    python -m benchmarks throughput [--particles 20000 100000] [--repeat 7]

Processor time of this process, the best of some frames: on a shared machine the fastest one is the least disturbed.
A cube of neo-Hookean, fixed corotated, Hencky or mixed material turns in free fall with 8 particles a cell; walls cost
below 1 %. "default" is the scheme of a scene unless told otherwise, "mls" plain MLS-MPM.
"""

import argparse
import dataclasses
import json
import math
import os
import platform
import time
from dataclasses import dataclass
from pathlib import Path

import torch
import warp as wp

from diffuphy.material import make_mixture
from diffuphy.mpm import Matter, Scene, Scheme, Solver, Span, State
from diffuphy.mpm.clock import Clock
from diffuphy.mpm.state import REAL, Bars, initial_state, make_matter
from diffuphy.types import MaterialField

CASES = {
    "neo-Hookean": (("neo_hookean",), ("identity",)),
    "fixed corotated": (("fixed_corotated",), ("identity",)),
    "Hencky, von Mises": (("hencky",), ("von_mises",)),
    "3 elastic, 3 plastic": (
        ("neo_hookean", "fixed_corotated", "hencky"),
        ("identity", "von_mises", "drucker_prager"),
    ),
}
SCHEMES = {"default": Scheme(), "mls": Scheme.mls()}
N_SUB = 30


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

    def forward(self) -> float:
        """Processor time of a frame [s]."""
        begin = time.process_time()
        self.solver.advance(self.state, self.matter, self.span)
        return time.process_time() - begin

    def backward(self, kept: bool) -> float:
        """Processor time of the backward pass of a frame [s], from substeps that the forward pass kept or by running
        them again."""
        source = self.solver.advance(self.state, self.matter, self.span, keep=True)[2] if kept else None
        bars = Bars(*(None if t is None else torch.ones_like(t) for t in self.state.tensors()))  # type: ignore[arg-type]
        begin = time.process_time()
        self.solver.advance_adjoint(self.state, self.matter, self.span, bars, (True, True, True, True), kept=source)
        return time.process_time() - begin

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


def cube(n: int, dtype: torch.dtype) -> tuple[torch.Tensor, torch.Tensor, float]:
    """Positions and volumes of n particles in half a metre, each anywhere in the middle of its place; and Δx."""
    side = math.ceil(n ** (1 / 3))
    spacing = 0.5 / side
    a = torch.arange(side, dtype=dtype)
    x = torch.cartesian_prod(a, a, a)[:n]
    jitter = torch.rand(x.shape, generator=torch.Generator().manual_seed(0), dtype=dtype) - 0.5
    return (x + 0.5 + 0.4 * jitter) * spacing, torch.full((n,), spacing**3, dtype=dtype), 2 * spacing


def body(case: str, scheme: Scheme, n: int, dtype: torch.dtype, grad: bool = True) -> Body:
    """The cube of a case."""
    elastic, plastic = CASES[case]
    x, vol, dx = cube(n, dtype)
    values = {"E": 1e5, "nu": 0.3, "yield_stress": 1e3, "friction_angle": 30.0, "cohesion": 0.0}
    theta = {k: torch.full((n,), v, dtype=dtype) for k, v in values.items()}
    weights = [torch.full((n, len(k)), 1 / len(k), dtype=dtype) for k in (elastic, plastic)]
    field = MaterialField(elastic, plastic, *weights, theta, torch.full((n,), 1000.0, dtype=dtype))
    scene = Scene(dx=dx, boundaries=(), spin=(0.0, 0.0, 3.0), scheme=scheme)
    mixture = make_mixture(elastic, plastic, REAL[dtype])
    matter = make_matter(field, vol, mixture.params, dtype)
    solver = Solver(mixture, (), scene.gravity, dtype, "cpu", particles=n, dx=dx, scheme=scheme, grad=grad)
    state = initial_state(scene, x, matter, mixture, 0.1 * torch.sin(10 * x))
    span = Clock(scene, solver, field, matter, None).span(state)
    return Body(solver, state, matter, dataclasses.replace(span, n_sub=N_SUB))


def measure(case: str, scheme: str, n: int, dtype: torch.dtype, repeat: int) -> dict[str, float | str | int]:
    """Best frame of ``repeat``: throughput forward, time of backward relative to forward, launches and bytes. A frame
    with half kicks has one round more than it has substeps, which is part of its price."""
    b, alone = body(case, SCHEMES[scheme], n, dtype), body(case, SCHEMES[scheme], n, dtype, grad=False)
    forward, backward, kept = [], [], []
    for _ in range(repeat + 1):
        forward.append(alone.forward())
        backward.append(b.backward(kept=False))
        kept.append(b.backward(kept=True))
    best = min(forward[1:])
    return {
        "case": case,
        "scheme": scheme,
        "particles": n,
        "precision": str(dtype).split(".")[1],
        "forward_M_per_s": round(n * N_SUB / best / 1e6, 2),
        "backward_over_forward": round(min(backward[1:]) / best, 2),
        "backward_over_forward_kept": round(min(kept[1:]) / best, 2),
        "launches": alone.launches(),
        **alone.bytes(),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--particles", type=int, nargs="+", default=[1000, 20000, 100000])
    parser.add_argument("--repeat", type=int, default=7)
    parser.add_argument("--double", action="store_true", help="float64 as well")
    parser.add_argument("--out", type=Path, default=Path(__file__).resolve().parents[1] / "docs" / "benchmarks")
    options = parser.parse_args()
    torch.set_num_threads(1)
    rows = []
    for dtype in (torch.float32, torch.float64) if options.double else (torch.float32,):
        for n in options.particles:
            for case in CASES:
                for scheme in SCHEMES:
                    rows.append(measure(case, scheme, n, dtype, options.repeat))
                    print(json.dumps(rows[-1]), flush=True)
    machine = f"one of {os.cpu_count()} cores ({platform.machine()}), torch {torch.__version__}"
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "throughput.json").write_text(json.dumps({"machine": machine, "rows": rows}, indent=1))
    (options.out / "throughput.md").write_text(page(machine, rows))


def page(machine: str, rows: list[dict]) -> str:
    """The rows as a page."""
    text = f"# Simulation\n\n{machine}; process time, best of several. Kept: the forward pass keeps its substeps.\n\n"
    text += "| laws | scheme | particles | precision | forward [M particle-substeps/s] | backward/forward "
    text += "| the same, kept | launches | B a particle | B a node |\n"
    text += "|---|---|---|---|---|---|---|---|---|---|\n"
    for r in rows:
        text += f"| {r['case']} | {r['scheme']} | {r['particles']} | {r['precision']} | {r['forward_M_per_s']} "
        text += f"| {r['backward_over_forward']} | {r['backward_over_forward_kept']} | {r['launches']:.0f} "
        text += f"| {r['bytes_a_particle']:.0f} | {r['bytes_a_node']} |\n"
    return text


if __name__ == "__main__":
    main()
