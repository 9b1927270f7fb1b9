"""From outcomes to raw numbers, pictures and the generated part of docs/numerics/stability.md."""

import argparse
import concurrent.futures
import contextlib
import csv
import dataclasses
import json
import logging
import math
import multiprocessing
import os
import platform
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import torch

from benchmarks.stability import courant, design, endurance, extremes
from benchmarks.stability.cells import MATTERS, Outcome, run_pair
from benchmarks.stability.pictures import draw_corners, draw_courant, draw_map
from benchmarks.stability.verdict import LIMITS
from benchmarks.stability.words import generated, short, silent, tally

log = logging.getLogger(__name__)

DOCS = Path(__file__).resolve().parents[2] / "docs"
INSIDE = 60
"""Cells of each matter anywhere inside."""
TASKS = 3
"""Matters after which a process is replaced: it keeps the code of all that it has seen, two gigabytes for all."""


@dataclasses.dataclass(frozen=True)
class Share:
    """All that is measured on one matter."""

    matter: str
    cells: list[tuple[str, Outcome]]
    """Kind of place in the map, and outcome."""
    courants: list[courant.Courant]
    long: list[tuple[str, Outcome]]
    """The same of runs of a hundred thousand substeps."""
    seconds: float


def study(matter: str, quick: bool) -> Share:
    """The part of the work that one process does."""
    torch.set_num_threads(1)
    begin = time.process_time()
    places = [*design.lines(matter), *design.corners(matter), *design.inside(matter, INSIDE)]
    if quick:
        places = places[:: len(places) // 6]
    cells = [(axis, outcome) for axis, cell in places for outcome in run_pair(cell)]
    nus = courant.NUS[1:2] if quick else courant.NUS
    courants = [courant.largest(matter, nu, alone) for alone in (False, True) for nu in nus]
    substeps = 1000 if quick else endurance.SUBSTEPS
    long = [(place, endurance.endure(cell, substeps)) for place, cell in endurance.bodies(matter)]
    return Share(matter, cells, courants, long, time.process_time() - begin)


def studied(quick: bool, jobs: int, matters: list[str]) -> Iterator[Share]:
    """Matter after matter, in ``jobs`` processes; the quick form in this one. None of them outlives this generator or
    the process that runs it, however that ends."""
    if quick:
        yield from (study(m, quick) for m in matters)
        return
    spawn = multiprocessing.get_context("spawn")
    for first in range(0, len(matters), jobs * TASKS):  # max_tasks_per_child hangs in Python 3.11 (CPython gh-115634)
        some = matters[first : first + jobs * TASKS]
        with concurrent.futures.ProcessPoolExecutor(jobs, mp_context=spawn, initializer=tethered) as pool:
            try:
                for share in pool.map(study, some, [quick] * len(some)):
                    log.info("%s: %s", share.matter, tally([row(axis, o) for axis, o in share.cells]))
                    yield share
            except BaseException:  # Ctrl-C above all: the pool would first wait for what is being measured
                for child in multiprocessing.active_children():
                    child.terminate()
                raise


def tethered() -> None:
    """Make this process end with the one that started it, even where that is killed."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def apart(quick: bool, jobs: int) -> dict[str, Any]:
    """What concerns no matter of the map, and room for what does."""
    return {
        "machine": f"{jobs} of {os.cpu_count()} cores ({platform.machine()}), torch {torch.__version__}",
        "cells": [],
        "courant": [],
        "long": [],
        "contracts": extremes.contracts(("D3", "D11") if quick else None),
        "refusals": extremes.refusals(),
        "far": extremes.far(),
        "seconds": {},
    }


def added(data: dict[str, Any], share: Share) -> dict[str, Any]:
    """The data with those of a matter in place of what was known of it; in the order of ``MATTERS``."""
    found = {
        "cells": [row(axis, o) for axis, o in share.cells],
        "courant": [dataclasses.asdict(c) for c in share.courants],
        "long": [row(place, o) for place, o in share.long],
    }
    order = list(MATTERS)
    rows = {k: [*(r for r in data[k] if r["matter"] != share.matter), *new] for k, new in found.items()}
    for its in rows.values():
        its.sort(key=lambda r: order.index(r["matter"]))
    return data | rows | {"seconds": data["seconds"] | {share.matter: round(share.seconds, 1)}}


def row(axis: str, o: Outcome) -> dict[str, object]:
    """An outcome as one line of the raw numbers."""
    numbers = {k: float(f"{o.measured.get(k, math.nan):.4g}") for k in LIMITS}
    cell = {k: float(f"{v:.6g}") if isinstance(v, float) else v for k, v in dataclasses.asdict(o.cell).items()}
    rest = {"lost": float(f"{o.lost:.4g}"), "substeps": o.substeps, "halvings": o.halvings}
    end = {"seconds": round(o.seconds, 3), "verdict": o.verdict.kind, "cured": o.cured, "why": o.verdict.why}
    return {"place": axis, **cell, **numbers, **rest, **end}


def put(page: Path, texts: dict[str, str]) -> None:
    """Replace what lies between the marks of a page, by their names; marks that it has not come at its end."""
    old = page.read_text(encoding="utf-8") if page.exists() else ""
    for name, text in texts.items():
        begin, end = f"<!-- {name} -->\n", f"<!-- /{name} -->\n"
        head, _, rest = old.partition(begin)
        old = head + begin + text + end + rest.partition(end)[2]
    page.write_text(old, encoding="utf-8")


def write(data: dict, raw: Path, pages: Path) -> None:
    """Raw numbers, pictures, page."""
    raw.mkdir(parents=True, exist_ok=True)
    pages.mkdir(parents=True, exist_ok=True)
    with (raw / "cells.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(data["cells"][0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows([*data["cells"], *data["long"]])
    rest = {k: v for k, v in data.items() if k not in ("cells", "long")}
    (raw / "stability.json").write_text(json.dumps(rest, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    draw_map(pages / "stability_lines.png", data["cells"])
    draw_corners(pages / "stability_corners.png", data["cells"])
    draw_courant(pages / "stability_steps.png", data["courant"])
    put(pages / "stability.md", {"short": short(data), "measured": generated(data)})


def read(raw: Path) -> dict:
    """What ``write`` left, with what is said to impossible input asked again: that takes a moment."""

    def number(text: str) -> float | str:
        try:
            return float(text)
        except ValueError:
            return text

    with (raw / "cells.csv").open(newline="", encoding="utf-8") as file:
        rows = [{k: number(v) for k, v in r.items()} for r in csv.DictReader(file)]
    data = json.loads((raw / "stability.json").read_text(encoding="utf-8"))
    for r in rows:
        r.update({k: int(r[k]) for k in ("side", "substeps", "halvings")})
        r.update({k: math.nan for k in LIMITS if k not in r})
    long = ("long", "small")
    data["cells"] = [r for r in rows if r["place"] not in long]
    data["long"] = [r for r in rows if r["place"] in long]
    return data | {"refusals": extremes.refusals()}


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks stability",
        description=__import__("benchmarks.stability").stability.__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--quick", action="store_true", help="one matter, a few cells, short long runs")
    parser.add_argument(
        "--matter",
        nargs="+",
        choices=MATTERS,
        metavar="M",
        help="some only, beside what the raw numbers hold of the others; names as in the page",
    )
    parser.add_argument("--jobs", type=int, default=min(2, os.cpu_count() or 1), help="processes")
    parser.add_argument("--again", action="store_true", help="page and pictures from the raw numbers that are there")
    parser.add_argument("--out", type=Path, help="a folder for everything; by default docs/")
    options = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    logging.getLogger("diffuphy").setLevel(logging.WARNING)
    torch.set_num_threads(1)
    matters = options.matter or (["neo_hookean"] if options.quick else list(MATTERS))
    raw, pages = (DOCS / "benchmarks" / "stability", DOCS / "numerics") if options.out is None else (options.out,) * 2
    partial = options.again or (options.matter and (raw / "cells.csv").exists())
    data = read(raw) if partial else apart(options.quick, options.jobs)
    if options.again:
        write(data, raw, pages)
    else:
        with contextlib.closing(studied(options.quick, options.jobs, matters)) as shares:
            for share in shares:
                data = added(data, share)
                write(data, raw, pages)  # a run that is stopped leaves what it has
    print(short(data))
    bad = sum(r["kind"] == "silent" for r in data["refusals"]) + sum(len(r["outside"]) for r in data["contracts"])
    return int(bad + len(silent(data)) > 0)
