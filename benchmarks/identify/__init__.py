"""Which materials can be found from a clip: how well, from how far, in what time, and what cannot be.

    python -m benchmarks identify                      # everything but takes; goes on where it stopped
    python -m benchmarks identify stiffness --runs 2   # the material stage: from how far away E is found
    python -m benchmarks identify parameters           # least squares: E, nu, yield stress, friction, viscosity, halves
    python -m benchmarks identify laws                 # the scan: is the right plastic law found
    python -m benchmarks identify seen resolution      # Fisher information; what discretisation does
    python -m benchmarks identify takes                # stiffness of a burger, by what the training looks at
    python -m benchmarks identify page                 # tables and figures from what is there

A ball is dropped. The clip it is found from is never made by the discretisation that fits it ("fine": half the grid
spacing, half the Courant number, another draw of particles, another place on the grid), or for comparison by the same
resolution ("same": another draw of particles and another place on the grid). Writes docs/benchmarks/identify*.
"""

import argparse
from pathlib import Path

import torch

from benchmarks.identify import laws, page, recover, seen, takes, trained

OUT = Path(__file__).parents[2] / "docs" / "benchmarks"
PARTS = ("seen", "resolution", "parameters", "stiffness", "laws")


def quick(out: Path) -> None:
    """A little of each part, to see that it runs."""
    seen.study(out, ["two halves"])
    rows = recover.open_rows(out)
    recover.recover(rows, recover.SPECIMENS["rubber"], 0, "same", ["particles", "1 camera"])
    laws.study(out, 1, ("same",))
    trained.descents(trained.open_rows(out), 1, 1, ("same",), distances=(0.3,))
    page.write(out)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks identify", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("parts", nargs="*", metavar="part", help=f"{', '.join(PARTS)}, takes or page; the first five")
    parser.add_argument("--truths", type=int, default=5, help="truths of each specimen, and of each law")
    parser.add_argument("--runs", type=int, default=2, help="runs from each distance and side")
    parser.add_argument("--stages", type=int, default=40, help="runs of the whole stage against a finer reference")
    parser.add_argument("--steps", type=int, default=40, help="optimiser steps without a scan; half as many after one")
    parser.add_argument("--specimens", nargs="*", default=(), choices=sorted(recover.SPECIMENS))
    parser.add_argument("--quick", action="store_true", help="a little of each, to see that it runs")
    parser.add_argument("--out", type=Path, default=OUT)
    options = parser.parse_args(arguments)
    if unknown := set(options.parts) - {*PARTS, "takes", "page"}:
        parser.error(f"no part {sorted(unknown)[0]!r}; there are {', '.join(PARTS)}, takes and page")
    torch.set_num_threads(1)
    if options.quick:
        quick(options.out)
        return 0
    parts = options.parts or PARTS
    if "seen" in parts:
        seen.study(options.out)
    if "resolution" in parts:
        seen.biases(options.out)
    if "parameters" in parts:
        recover.study(options.out, options.specimens, options.truths)
    if "stiffness" in parts:
        trained.stages(trained.open_rows(options.out), options.stages, options.steps // 2)
        trained.descents(trained.open_rows(options.out), options.runs, options.steps)
    if "laws" in parts:
        laws.study(options.out, options.truths)
    if "takes" in parts:
        takes.study(options.out, options.steps)
    page.write(options.out)
    return 0
