"""List and run the benchmarks.

    python -m benchmarks                             # what there is
    python -m benchmarks speed --repeat 21           # one, with its own options
    python -m benchmarks numerics                    # the full forms behind docs/numerics, one after the other
    python -m benchmarks all                         # the quick form of each, to see that it runs; keeps nothing

Numbers that the documentation quotes come from the full forms, one at a time, on a machine with nothing else to do.
"""

import argparse
import ast
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

HERE = Path(__file__).resolve().parent

QUICK = {
    "contact": ("--quick", "--out", "{out}"),
    "errors": ("--quick", "--out", "{out}"),
    "filling": ("--objects", "duck", "--steps", "20", "--out", "{out}"),
    "films": (
        "--prompts",
        "a ball falling",
        "--options",
        "experiment=tiny",
        "--store",
        "{out}/store",
        "--out",
        "{out}",
    ),
    "gallery": ("knot", "--settings", "experiment=tiny", "--store", "{out}/store", "--out", "{out}"),
    "gaussians": ("--objects", "burger", "--steps", "20", "--out", "{out}"),
    "gradients": ("--quick", "--out", "{out}"),
    "identify": ("--quick", "--out", "{out}"),
    "leaving_out": ("--cells", "3", "--repeat", "2", "--features", "decomposition", "walls", "--out", "{out}"),
    "library_sheet": ("burger", "duck", "--out", "{out}/library.png"),
    "peers": ("--particles", "2000", "--repeat", "2", "--out", "{out}"),
    "physgaussian": ("--tiny", "--scenes", "jam", "--count", "2000", "--store", "{out}/store", "--out", "{out}"),
    "pretrain": ("train", "--steps", "2", "--drafts", "1", "--folder", "{out}"),
    "resume": ("--kills", "1"),
    "speed": ("--quick",),
    "stability": ("--quick", "--jobs", "1", "--out", "{out}"),
    "stiffness_and_yield": (
        "--starts",
        "both twice",
        "--seeds",
        "1",
        "--particles",
        "200",
        "--steps",
        "1",
        "--out",
        "{out}",
    ),
    "study": ("power", "--people", "5", "--studies", "20"),
    "two_regions": (
        "--ways",
        "start",
        "--seeds",
        "0",
        "--particles",
        "200",
        "--image",
        "32",
        "--steps",
        "1",
        "--out",
        "{out}",
    ),
    "velocity_forms": ("--targets", "5.0", "--starts", "2", "--steps", "0", "--out", "{out}"),
    "tables": (
        "quantitative",
        "--prompts",
        "a jelly bouncing",
        "--methods",
        "PhysGaussian",
        "given",
        "--seeds",
        "0",
        "--store",
        "{out}/store",
        "--out",
        "{out}",
    ),
    "video_memory": ("--frames", "4", "--repeat", "1", "--out", "{out}"),
    "verification": ("--tier", "0", "--out", "{out}"),
    "work_precision": ("--quick", "--out", "{out}"),
}
"""Options under which each script takes about a minute; ``{out}`` is a folder that is thrown away."""

NUMERICS = ("work_precision", "stability", "gradients", "errors", "speed", "leaving_out")
"""What ``docs/numerics`` is made of; each page says how long its part took, the map of stability takes longest."""


def scripts() -> dict[str, str]:
    """First sentence of every benchmark, a file or a folder, by name."""
    found = {p.stem: p for p in HERE.glob("*.py") if not p.stem.startswith("_")}
    found |= {p.parent.name: p for p in HERE.glob("*/__init__.py")}
    return {name: docstring(found[name]).splitlines()[0] for name in sorted(found)}


def docstring(path: Path) -> str:
    return ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""


def run(name: str, options: list[str]) -> int:
    """Run a benchmark in a process of its own, which is killed if this one is told to end; its exit status."""
    command = [sys.executable, "-m", f"benchmarks.{name}", *options]
    return subprocess.run(command, cwd=HERE.parent, check=False).returncode


def run_each(options: dict[str, Sequence[str]]) -> int:
    """Run these benchmarks one after the other; returns whether one failed."""
    failed = []
    for name, its in options.items():
        print(f"== {name}", flush=True)
        start = time.perf_counter()
        if run(name, list(its)):
            failed.append(name)
        print(f"== {name}: {time.perf_counter() - start:.0f} s", flush=True)
    if failed:
        print(f"failed: {', '.join(failed)}", file=sys.stderr)
    return len(failed) > 0


def run_all() -> int:
    """The quick form of each."""
    with tempfile.TemporaryDirectory() as out:
        return run_each({name: [o.format(out=out) for o in QUICK[name]] for name in scripts()})


def main() -> int:
    known = scripts()
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("name", nargs="?", choices=[*known, "numerics", "all"], metavar="name")
    parser.add_argument("options", nargs=argparse.REMAINDER, help="passed on to the benchmark")
    arguments = parser.parse_args()
    if arguments.name is None:
        width = max(map(len, known))
        print("\n".join(f"{name:<{width}}  {says}" for name, says in known.items()))
        return 0
    if arguments.name == "numerics":
        return run_each(dict.fromkeys(NUMERICS, ()))
    return run_all() if arguments.name == "all" else run(arguments.name, arguments.options)


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, lambda number, _frame: sys.exit(128 + number))  # as an exception, like Ctrl-C
    raise SystemExit(main())
