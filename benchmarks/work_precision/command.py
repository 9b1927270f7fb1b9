"""The command line: which cases, how thoroughly, and where the results go."""

import argparse
import inspect
import json
import logging
import tempfile
from pathlib import Path

import torch
import warp as wp

from benchmarks.work_precision import gradient, pictures
from benchmarks.work_precision.cases import CASES, Case
from benchmarks.work_precision.choice import named
from benchmarks.work_precision.figure import MEMORY, SECONDS, WORK, figure
from benchmarks.work_precision.page import Section, page
from benchmarks.work_precision.problem import Trial
from benchmarks.work_precision.references import Against, keep, kept, reference, uncertainty
from benchmarks.work_precision.report import machine, table, verdict
from benchmarks.work_precision.rows import Row, read, write
from benchmarks.work_precision.sweep import Swept, sweep

log = logging.getLogger(__name__)

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PEERS = ROOT / "peers/bin/python"
"""Where other codes are looked for."""
MEASURES = {"W6": gradient, "W7": pictures}
"""Cases that are not films."""
ORDER = ("W1", "W1b", "W2", "W3", "W4", "W5", "W6", "W7", "W8")
SECOND = {"W6": (MEMORY,), "W7": ()}
"""What the second panel shows instead of particle-substeps."""


def section(id: str, rows: list[Row], noise: float) -> Section:
    """A case with its words."""
    if id in CASES:
        c = CASES[id]
        about = " ".join((inspect.getdoc(c.build) or "").split()).removeprefix(f"{id}: ")
        return Section(id, c.title, c.norm, f"cells along the {c.unit}", about[0].upper() + about[1:], rows, noise)
    module = MEASURES[id]
    about = (inspect.getdoc(module) or "").removeprefix(f"{id}: ")
    unit = "cells along the bar" if id == "W6" else "pixels along a side"
    return Section(id, module.TITLE, module.NORM, unit, about[0].upper() + about[1:], rows, noise)


def measure(id: str, quick: bool, python: str | None, folder: Path) -> tuple[Swept | None, list[str]]:
    """Run a case; nothing, and why, where its reference has not been made."""
    if id in CASES:
        if CASES[id].reference and id not in kept():
            return None, [
                f"{id} is left out: its reference is missing; python -m benchmarks work_precision --references"
            ]
        return sweep(CASES[id], quick=quick, python=python, folder=folder)
    return MEASURES[id].sweep(quick=quick), []


def draw(s: Section, where: str) -> str:
    """The figure of a case."""
    note = f"{where} · A/A {100 * s.noise:.1f} %"
    axes = (SECONDS, *SECOND.get(s.id, (WORK,)))
    return figure(f"{s.id}  {s.title}", s.norm, note, s.rows, axes, uncertainty(s.id))


def store(out: Path, s: Section, where: str, quick: bool = False) -> None:
    """Rows and figure of a case, and what goes with all its rows."""
    write(out / f"{s.id}.csv", s.rows)
    (out / f"{s.id}.svg").write_text(draw(s, where), encoding="utf-8")
    file = out / "runs.json"
    known = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    known[s.id] = {"machine": where, "noise": round(s.noise, 5), "form": "quick" if quick else "full"}
    file.write_text(json.dumps(dict(sorted(known.items())), indent=1) + "\n", encoding="utf-8")


def stored(out: Path) -> list[Section]:
    """All cases that a folder holds."""
    known = json.loads((out / "runs.json").read_text(encoding="utf-8"))
    return [section(id, read(out / f"{id}.csv"), known[id]["noise"]) for id in ORDER if id in known]


def make_references() -> None:
    """Run the fine grids of all cases that need them."""
    found = {}
    for case in CASES.values():
        if case.reference:
            values = {c: [observed(case, c, n) for n in case.reference] for c in ("default", "plain APIC")}
            found[case.id] = reference(values, case.reference)
            log.info("%s: orders %s, known to %.2g", case.id, found[case.id]["orders"], found[case.id]["uncertainty"])
    keep(found)


def observed(case: Case, series: str, n: int) -> torch.Tensor:
    """What a case compares, of one run."""
    (choice,) = named(series)
    trial = Trial(case.build(n, choice.per), choice)
    log.info("%s, %s, %d cells: %.0f s", case.id, series, n, trial.run().seconds)
    assert isinstance(trial.problem.error, Against)
    return trial.problem.error.observe([s.x.double() for s in trial.states])


def parsed(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks work_precision", description=__doc__)
    parser.add_argument("--cases", nargs="+", choices=ORDER, default=ORDER, metavar="W", help="some of W1 … W8")
    parser.add_argument("--quick", action="store_true", help="few settings and resolutions, to see that it runs")
    parser.add_argument(
        "--peers-python", metavar="PATH", default=str(PEERS) if PEERS.exists() else None,
        help="interpreter with taichi and newton; peers/bin/python if there is one",
    )  # fmt: skip
    parser.add_argument("--out", type=Path, help="folder for files and page instead of docs/")
    parser.add_argument("--references", action="store_true", help="only make the references of W3, W5 and W8 again")
    parser.add_argument("--page", action="store_true", help="only draw and write again from the files")
    return parser.parse_args(arguments)


def main(arguments: list[str] | None = None) -> int:
    """Run what is asked for; returns the exit status."""
    options = parsed(arguments)
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    logging.getLogger("diffuphy").setLevel(logging.WARNING)
    torch.set_num_threads(1)
    wp.config.quiet = True
    if options.references:
        make_references()
        return 0
    out = options.out or DOCS / "benchmarks" / "work_precision"
    out.mkdir(parents=True, exist_ok=True)
    where, missing = machine(), []
    with tempfile.TemporaryDirectory() as folder:
        for id in () if options.page else options.cases:
            log.info("%s", id)
            found, left_out = measure(id, options.quick, options.peers_python, Path(folder))
            missing += [line for line in left_out if line not in missing]
            if found is None:
                continue
            s = section(id, found.rows, found.noise)
            store(out, s, where, options.quick)
            log.info("%s\n%s", table(s.rows), verdict(s.rows, s.noise))
    for line in missing:
        log.info("%s", line)
    finish(out, options.out, missing)
    return 0


def finish(out: Path, given: Path | None, missing: list[str]) -> None:
    """The page, from all that the folder holds."""
    sections = stored(out)
    known = json.loads((out / "runs.json").read_text(encoding="utf-8"))
    for s in sections:
        (out / f"{s.id}.svg").write_text(draw(s, known[s.id]["machine"]), encoding="utf-8")
    absent = [id for id in ORDER if id not in known]
    if absent:
        missing = [*missing, f"{', '.join(absent)}: not run yet"]
    machines = " / ".join(dict.fromkeys(known[s.id]["machine"] for s in sections))
    quick = [s.id for s in sections if known[s.id]["form"] == "quick"]
    if quick:
        missing = [f"The quick form ran {', '.join(quick)}: few settings, coarse grids, short repeats", *missing]
    where = (given or DOCS / "numerics") / "accuracy.md"
    where.parent.mkdir(parents=True, exist_ok=True)
    where.write_text(page(machines, sections, missing), encoding="utf-8")
