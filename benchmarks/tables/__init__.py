"""The tables of the paper by one command each: every method on the same objects, with seeds and error bars.

    python -m benchmarks tables quantitative                 # methods × prompts × seeds, physical error and the rest
    python -m benchmarks tables efficiency                   # seconds a step, in all, peak memory
    python -m benchmarks tables ablation                     # our method with one part left out at a time
    python -m benchmarks tables prompt                       # fuzzy sentences with and without refinement
    python -m benchmarks tables quantitative --pages         # the page again, from the rows that are there

Runs go through the stages of ``train.py`` and its store: what is there is not computed again, also when it comes from a
sweep, ``python train.py -m method='glob(*)' seed=0,1,2 experiment=table report.error=off until=trajectory prompt=...``
with any launcher. Writes NAME.csv, NAME.md and NAME.png. docs/methods.md says what the methods are.
"""

import argparse
import csv
import multiprocessing
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

from benchmarks.tables import gather, page
from benchmarks.tables.protocol import ABLATIONS, FUZZY, METHODS, PAPER, PROMPTS, REFINEMENT, SIZES, Task, tasks

ROOT = Path(__file__).parents[2]

PLANS: Mapping[str, tuple[Sequence[str], Mapping[str, tuple[str, ...]], Mapping[str, str]]] = {
    "quantitative": (PROMPTS, METHODS, {}),
    "efficiency": (PAPER, METHODS, {}),
    "ablation": (PAPER, ABLATIONS, {}),
    "prompt": (tuple(FUZZY), REFINEMENT, FUZZY),
}
"""Prompts, variants, and what fuzzy prompts mean, of each table."""

TITLES = {
    "quantitative": "Methods compared",
    "efficiency": "What each method takes",
    "ablation": "Our method with one part left out",
    "prompt": "Sentences as people write them",
}


def rows_of(jobs: Sequence[Task], processes: int, **settings: Any) -> list[dict[str, Any]]:
    """All rows, by prompt, seed and variant; objects are shared out over processes, the runs of one stay together."""
    from benchmarks.tables.work import run

    found: dict[int, list[dict[str, Any]]] = {}
    if processes == 1:
        found = {k: run(task, **settings) for k, task in enumerate(jobs)}
    else:
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(processes, mp_context=context) as pool:
            waiting = {pool.submit(run, task, **settings): k for k, task in enumerate(jobs)}
            for done in as_completed(waiting):
                found[waiting[done]] = done.result()
    return [row for k in sorted(found) for row in found[k]]


def text(name: str, rows: Sequence[gather.Row], said: str) -> str:
    """The page of a table."""
    seeds = len({r["seed"] for r in rows})
    parts = [f"# {TITLES[name]}", said, SAYS[name].format(seeds=seeds)]
    parts += [make(rows) for make in MAKES[name]]
    parts += [f"![{TITLES[name]}]({name}.png)", f"All runs: [{name}.csv]({name}.csv)."]
    return "\n\n".join(p.strip() for p in parts) + "\n"


SAYS = {
    "quantitative": "Physical error: root mean square distance to the prior's own material on a grid twice as fine, "
    "mean over frames, % of the object's size; mean ± standard deviation over {seeds} seeds. *given* is told that "
    "material and shows what is left to the simulation.",
    "efficiency": "The material stage; a step is one step of the optimiser (the paper's epoch): one drop simulated, "
    "filmed, compared, and its gradient. Mean over prompts ± standard deviation over {seeds} seeds.",
    "ablation": "Physical error as in [the comparison of methods](quantitative.md), %; mean ± standard deviation over "
    "{seeds} seeds.",
    "prompt": "Distance to the motion of the sentence that was meant, in the centre of mass and the three root mean "
    "square extents, % of the object's size; mean ± standard deviation over {seeds} seeds.",
}
"""What the numbers of a table are."""

MAKES: Mapping[str, Sequence[Callable[[Sequence[gather.Row]], str]]] = {
    "quantitative": (page.by_prompt, page.lead, page.measures, page.weights),
    "efficiency": (page.efficiency,),
    "ablation": (page.by_prompt, page.measures, page.weights),
    "prompt": (page.by_prompt,),
}
"""What a page is made of."""


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks tables", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("table", choices=list(PLANS))
    parser.add_argument("--prompts", nargs="+", default=None)
    parser.add_argument("--methods", nargs="+", default=None, help="columns of the table to run; by default all")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument("--size", choices=list(SIZES), default="small")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--films", action="store_true", help="make and score the films, and list them for a user study")
    parser.add_argument("--pages", action="store_true", help="run nothing; write the page of the rows that are there")
    parser.add_argument("--store", type=Path, default=ROOT / "outputs")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "benchmarks" / "tables")
    options = parser.parse_args(arguments)
    prompts, variants, meant = PLANS[options.table]
    if options.methods and (unknown := set(options.methods) - set(variants)):
        parser.error(f"{sorted(unknown)[0]!r} is none of {', '.join(variants)}")
    variants = {n: v for n, v in variants.items() if n in (options.methods or variants)}
    options.out.mkdir(parents=True, exist_ok=True)
    rows_file = options.out / f"{options.table}.csv"
    if options.pages:
        rows = gather.read(rows_file)
    else:
        films = options.out / "films" if options.films else None
        rows = rows_of(
            tasks(options.prompts or prompts, options.seeds, variants, meant), options.jobs,
            size=options.size, store=options.store.resolve(), device=options.device, films=films,
        )  # fmt: skip
        gather.write(rows, rows_file)
    said = f"`python -m benchmarks tables {options.table} --size {options.size}`; {machine(options.device)}."
    (options.out / f"{options.table}.md").write_text(text(options.table, rows, said), encoding="utf-8")
    page.figure(rows, options.out / f"{options.table}.png")
    if any("film" in r for r in rows):
        list_films(rows, options.out / "films.csv")
    print(text(options.table, rows, said))
    return 0


def machine(device: str) -> str:
    """The machine, in words."""
    from benchmarks.speed.body import describe

    return describe(device)


def list_films(rows: Sequence[gather.Row], path: Path) -> None:
    """The films of the first seed of each prompt and method, as ``benchmarks study build`` takes them."""
    first = {(r["prompt"], r["variant"]): r["film"] for r in sorted(rows, key=lambda r: -r["seed"]) if "film" in r}
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["prompt", "method", "path"])
        writer.writerows([p, m, os.path.relpath(film, path.parent)] for (p, m), film in first.items())
