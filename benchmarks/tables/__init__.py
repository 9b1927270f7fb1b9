"""The tables of the paper by one command each: every method on the same objects, with seeds and error bars.

    python -m benchmarks tables quantitative                 # methods × prompts × seeds, physical error and the rest
    python -m benchmarks tables efficiency                   # seconds a step, in all, peak memory
    python -m benchmarks tables ablation                     # our method with one part left out at a time
    python -m benchmarks tables look                         # the object with one part left out, all its steps
    python -m benchmarks tables prompt                       # fuzzy sentences with and without refinement
    python -m benchmarks tables quantitative --pages         # the page again, from the rows that are there

Rows are added to those of earlier runs. Runs go through the stages of ``train.py`` and its store: what is there is not
computed again, also when it comes from a sweep with any launcher, ``python train.py -m method='glob(*)' seed=0,1,2
experiment=table report.error=off until=trajectory prompt=...``. Writes NAME.csv, NAME.md and NAME.png. docs/methods.md
says what the methods are.
"""

import argparse
import csv
import multiprocessing
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

from benchmarks.tables import gather, page
from benchmarks.tables.protocol import (
    ABLATIONS,
    FUZZY,
    METHODS,
    OBJECTS,
    PAPER,
    PROMPTS,
    REFINEMENT,
    SIZES,
    Task,
    tasks,
)

ROOT = Path(__file__).parents[2]

PLANS: Mapping[str, tuple[Sequence[str], Mapping[str, tuple[str, ...]], Mapping[str, str]]] = {
    "quantitative": (PROMPTS, METHODS, {}),
    "efficiency": (PAPER, METHODS, {}),
    "ablation": (PAPER, ABLATIONS, {p: p for p in PAPER}),
    "look": (PAPER, OBJECTS, {p: p for p in PAPER}),
    "prompt": (tuple(FUZZY), REFINEMENT, FUZZY),
}
"""Prompts, variants, and what was meant by each prompt where variants change the object, of each table."""

TITLES = {
    "quantitative": "Methods compared",
    "efficiency": "What each method takes",
    "ablation": "Our method with one part left out",
    "look": "The object with one part left out",
    "prompt": "Sentences as people write them",
}


def rows_of(jobs: Sequence[Task], processes: int, **settings: Any) -> Iterator[list[dict[str, Any]]]:
    """The rows of one object after the other, as they are done; objects are shared out over processes."""
    from benchmarks.tables.work import run

    if processes == 1:
        yield from (run(task, **settings) for task in jobs)
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, mp_context=context) as pool:
        yield from (done.result() for done in as_completed([pool.submit(run, task, **settings) for task in jobs]))


def text(name: str, rows: Sequence[gather.Row], said: str) -> str:
    """The page of a table."""
    seeds = len({r["seed"] for r in rows})
    parts = [f"# {TITLES[name]}", said, SAYS[name].format(seeds=seeds)]
    parts += [make(rows) for make in MAKES[name]]
    parts += [f"![{TITLES[name]}]({name}.png)", f"All runs: [{name}.csv]({name}.csv)."]
    return "\n\n".join(p.strip() for p in parts) + "\n"


SAYS = {
    "quantitative": "Physical error: root mean square distance to the prior's own material on a grid twice as fine, "
    "mean over frames, % of the object's size; mean ± standard deviation over at most {seeds} seeds. *given* is told "
    "that material and shows what is left to the simulation.",
    "efficiency": "The material stage; a step is one step of the optimiser (the paper's epoch): one drop simulated, "
    "filmed, compared, and its gradient. Mean over prompts ± standard deviation over at most {seeds} seeds.",
    "ablation": "In % of the object's size, mean ± standard deviation over at most {seeds} seeds; physical error as in "
    "[the comparison of methods](quantitative.md).",
    "look": "PSNR [dB] of eight views that no fit saw, against the embedded prior's own object; mean ± standard "
    "deviation over at most {seeds} seeds.",
    "prompt": "Distance to the motion of the sentence that was meant, in the centre of mass and the three root mean "
    "square extents, % of the object's size; mean ± standard deviation over at most {seeds} seeds.",
}
"""What the numbers of a table are."""

MAKES: Mapping[str, Sequence[Callable[[Sequence[gather.Row]], str]]] = {
    "quantitative": (page.by_prompt, page.lead, page.measures, page.weights),
    "efficiency": (page.efficiency,),
    "ablation": (page.ablations, page.parts, page.twins, page.measures, page.weights),
    "look": (page.by_look, page.object_parts, page.twins),
    "prompt": (page.by_prompt, page.looks, page.twins),
}
"""What a page is made of."""

SHOWN = {
    "efficiency": ("cpu_seconds", "processor time of the material [s]"),
    "ablation": ("meant", "distance to the motion of what was meant / size"),
    "prompt": ("error", "distance to the motion of what was meant / size"),
}
"""Number and label of the figure, where it is not the error."""


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks tables", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("table", choices=list(PLANS))
    parser.add_argument("--prompts", nargs="+", default=None)
    parser.add_argument("--methods", nargs="+", default=None, help="columns of the table to run; by default all")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument("--size", choices=list(SIZES), help="small, but for look, whose objects are not done so soon")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--films", action="store_true", help="make and score the films, and list them for a user study")
    parser.add_argument("--pages", action="store_true", help="run nothing; write the page of the rows that are there")
    parser.add_argument("--fresh", action="store_true", help="forget the rows that are there; else they are kept")
    parser.add_argument("--store", type=Path, default=ROOT / "outputs")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "benchmarks" / "tables")
    options = parser.parse_args(arguments)
    prompts, variants, meant = PLANS[options.table]
    if options.methods and (unknown := set(options.methods) - set(variants)):
        parser.error(f"{sorted(unknown)[0]!r} is none of {', '.join(variants)}")
    variants = {n: v for n, v in variants.items() if n in (options.methods or variants)}
    options.out.mkdir(parents=True, exist_ok=True)
    rows_file = options.out / f"{options.table}.csv"
    rows: Sequence[gather.Row] = gather.read(rows_file) if rows_file.exists() and not options.fresh else []
    jobs = [] if options.pages else tasks(options.prompts or prompts, options.seeds, variants, meant)
    films = options.out / "films" if options.films else None
    size = options.size or ("default" if options.table == "look" else "small")
    until = "gaussians" if options.table == "look" else "trajectory"
    its = {"size": size, "store": options.store.resolve(), "device": options.device, "until": until, "films": films}
    for found in rows_of(jobs, options.jobs, **its):
        rows = gather.merged(rows, found)
        gather.write(rows, rows_file)
    if not rows:
        parser.error(f"there are no rows in {rows_file} yet; run without --pages")
    said = f"`python -m benchmarks tables {options.table} --size {size}`; {machine(options.device)}."
    (options.out / f"{options.table}.md").write_text(text(options.table, rows, said), encoding="utf-8")
    if options.table != "look":
        page.figure(rows, options.out / f"{options.table}.png", *SHOWN.get(options.table, ()))
    elif jobs:
        draw(jobs, size, options.store.resolve(), options.device, options.out / "look.png")
    if any("film" in r for r in rows):
        list_films(rows, options.out / "films.csv")
    print(text(options.table, rows, said))
    return 0


def draw(jobs: Sequence[Task], size: str, store: Path, device: str, path: Path) -> None:
    """The objects of the first seed, a row for each prompt: the prior's own, then every variant's."""
    from benchmarks.tables.look import sheet
    from benchmarks.tables.work import objects

    first = [job for job in jobs if job.seed == jobs[0].seed]
    sheet([objects(job, size, store, device) for job in first], ["the prior's", *jobs[0].variants]).save(path)


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
