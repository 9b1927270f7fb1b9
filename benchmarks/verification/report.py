"""Runs cases, and writes what they measured as a page and as JSON."""

import argparse
import json
import os
import platform
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
import warp as wp

import diffuphy
from benchmarks.verification.case import CASES, SETTINGS, Check, Setting, interval

DOCS = Path(__file__).resolve().parents[2] / "docs"

HEAD = """# Verification

What the solver must reproduce, and what it does. Every reference is a closed form, a conservation law or a solution
made to be exact; every interval is that of theory or of an independent code, never of this one. `python -m benchmarks
verification --tier 0 --scheme all` writes this page; `tests/verification` fails when a case leaves its interval.
"""


@dataclass(frozen=True)
class Result:
    """One case under one setting."""

    id: str
    scheme: str
    checks: list[Check]
    seconds: float = 0.0
    """Wall time with compilation [s]."""

    @property
    def ok(self) -> bool:
        return all(c.ok for c in self.checks)


def run(id: str, setting: Setting) -> Result:
    """Measure a case.

    Raises:
        KeyError: there is no such case.
    """
    start = time.perf_counter()
    checks = CASES[id].measure(setting)
    return Result(id, setting.name, checks, time.perf_counter() - start)


def chosen(ids: list[str], tier: int | None, schemes: list[str]) -> list[tuple[str, Setting]]:
    """Cases and settings that the options name, each case under all its settings before the next; the plain transfers
    leave long cases out unless these are asked for.

    Raises:
        ValueError: a case or a scheme that does not exist.
    """
    ordered = sorted(CASES.values(), key=lambda c: c.place)
    if unknown := [i for i in ids if i not in CASES]:
        raise ValueError(f"there is no case {unknown[0]!r}; known: {', '.join(c.id for c in ordered)}")
    names = list(SETTINGS) if "all" in schemes else schemes
    if unknown := [n for n in names if n not in SETTINGS]:
        raise ValueError(f"this solver has no scheme {unknown[0]!r}; known: {', '.join(SETTINGS)}, all")
    cases = [c for c in ordered if (not ids or c.id in ids) and (tier is None or c.tier == tier)]
    plain = bool(ids) or tier is not None  # otherwise the baselines are not shown where it takes minutes
    return [
        (c.id, SETTINGS[n]) for c in cases for n in names if n in c.schemes and (plain or not c.tier or n == "default")
    ]


def machine() -> str:
    """Where and with what it was measured."""
    versions = f"Python {platform.python_version()}, torch {torch.__version__}, Warp {wp.config.version}"
    cores = f"one of {os.cpu_count()} cores ({platform.machine()})"
    return f"{cores}, {platform.system()}; diffuphy {diffuphy.__version__}, {versions}"


def number(x: float | None) -> str:
    """Five digits, nothing if there is none."""
    return "" if x is None else f"{x:.5g}"


def page(results: list[Result], where: str) -> str:
    """The table of all checks, and the equation of every case."""
    failed = [r for r in results if not r.ok]
    total = sum(len(r.checks) for r in results)
    text = HEAD + f"\nMeasured on {where}. {len(results)} cases, {total} checks, {len(failed)} cases outside.\n"
    text += "\nWhy each interval is what it is: in the docstring of its case in `benchmarks/verification`.\n"
    for scheme in dict.fromkeys(r.scheme for r in results):
        text += f"\n## Transfer: {scheme}\n\n| case | what | reference | measured | accepted | |\n"
        text += "|---|---|---|---|---|---|\n"
        for r in (r for r in results if r.scheme == scheme):
            for c in r.checks:
                cells = (r.id, escaped(c.what) + (f" [{c.unit}]" if c.unit else ""), number(c.reference))
                cells += (number(c.measured), interval(c.lo, c.hi), "ok" if c.ok else "**outside**")
                text += "| " + " | ".join(cells) + " |\n"
    text += "\n## Equations\n\n| case | | |\n|---|---|---|\n"
    for id in dict.fromkeys(r.id for r in results):
        case = CASES[id]
        text += f"| {id} | {case.title}{', long' if case.tier else ''} | {escaped(case.equation)} |\n"
    return text


def escaped(text: str) -> str:
    """Bars end a cell of a table."""
    return text.replace("|", "\\|")


def write(results: list[Result], out: Path) -> None:
    """``verification.md`` and ``benchmarks/verification.json`` under ``out``."""
    where = machine()
    folder = out / "benchmarks"
    folder.mkdir(parents=True, exist_ok=True)
    rows = [asdict(r) | {"seconds": round(r.seconds, 1)} for r in results]
    (folder / "verification.json").write_text(
        json.dumps({"machine": where, "results": rows}, indent=1, ensure_ascii=False) + "\n", encoding="utf-8"
    )
    (out / "verification.md").write_text(page(results, where), encoding="utf-8")


def main() -> int:
    import benchmarks.verification as package

    parser = argparse.ArgumentParser(
        prog="python -m benchmarks verification",
        description=package.__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("ids", nargs="*", help="cases; all if none is named")
    parser.add_argument("--tier", type=int, choices=(0, 1), help="0: seconds each, 1: up to minutes; both if left out")
    parser.add_argument(
        "--scheme", nargs="+", default=["default"], help="default, mls, apic or all; long cases only default"
    )
    parser.add_argument("--out", type=Path, default=DOCS, help="folder for verification.md and benchmarks/*.json")
    options = parser.parse_args()
    torch.set_num_threads(1)
    try:
        todo = chosen(options.ids, options.tier, options.scheme)
    except ValueError as error:
        parser.error(str(error))
    results = []
    for id, setting in todo:
        result = run(id, setting)
        results.append(result)
        print(f"{id:<4} {setting.name:<8} {result.seconds:6.1f} s  {'ok' if result.ok else 'OUTSIDE'}", flush=True)
        for check in (c for c in result.checks if not c.ok):
            print(f"     {check}", file=sys.stderr, flush=True)
    write(results, options.out)
    return int(not all(r.ok for r in results))
