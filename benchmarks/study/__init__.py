"""A user study that anyone can repeat: a blind page of films, ratings in files, and the statistics.

    python -m benchmarks study build films.csv study/            # prompt,method,path → study/page/ and study/key.json
    python -m benchmarks study score study/key.json ratings/*.json --out study/
    python -m benchmarks study power --people 10 20 40 --studies 200   # how many are needed, before asking anyone

``study/page`` is a static folder: it opens from the disk or from any web server, asks nothing of the network and names
no method anywhere. Every participant saves one file of ratings and sends it back; ``key.json`` stays at home.
DiffuPhyGS (2025), table 1 has 20 participants, 4 methods, 5 prompts and mean opinion scores from 1 to 5 on two
criteria; this asks the same, and then shows pairs, which need fewer people for the same certainty. docs/user_study.md.
"""

import argparse
import csv
import sys
from pathlib import Path

from benchmarks.study.design import Film, Refused, make
from benchmarks.study.power import power
from benchmarks.study.ratings import Key, read
from benchmarks.study.report import report


def films(table: Path) -> list[Film]:
    """The films of a table with the columns prompt, method and path (relative to the table)."""
    with table.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    needed = {"prompt", "method", "path"}
    if not rows or needed - set(rows[0]):
        raise Refused(f"{table} must have the columns prompt, method and path and at least one row")
    return [Film(r["prompt"], r["method"], (table.parent / r["path"]).resolve()) for r in rows]


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks study", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    builds = commands.add_parser("build", help="films → a page to rate them on, and its key")
    builds.add_argument("films", type=Path, help="CSV with the columns prompt, method, path")
    builds.add_argument("out", type=Path)
    builds.add_argument("--parts", choices=["scores", "pairs", "both"], default="both")
    builds.add_argument("--catch", type=int, default=2, help="pairs of a film with itself, to see who looks")
    builds.add_argument("--seed", type=int, default=0)
    scoring = commands.add_parser("score", help="ratings → tables with error bars")
    scoring.add_argument("key", type=Path)
    scoring.add_argument("ratings", type=Path, nargs="+")
    scoring.add_argument("--ours", default="DiffuPhyGS", help="the method that the others are compared with")
    scoring.add_argument("--missed", type=int, default=1, help="catch trials that a participant may answer wrongly")
    scoring.add_argument("--out", type=Path, default=None, help="folder for study.md and its CSV files")
    powering = commands.add_parser("power", help="how often a study of this size finds a difference that is there")
    powering.add_argument("--people", type=int, nargs="+", default=[5, 10, 20, 40])
    powering.add_argument("--prompts", type=int, default=5)
    powering.add_argument("--rivals", type=int, default=3)
    powering.add_argument("--gap", type=float, default=0.5, help="points on the scale from 1 to 5")
    powering.add_argument("--studies", type=int, default=200)
    options = parser.parse_args(arguments)
    try:
        if options.command == "power":
            for people in options.people:
                share = power(people, options.prompts, options.rivals, options.gap, studies=options.studies)
                print(f"{people:4d} people: {share:.0%}")
        elif options.command == "build":
            page = make(films(options.films), options.out, parts=options.parts, catch=options.catch, seed=options.seed)
            print(f"page  {page}\nkey   {options.out / 'key.json'}  (keep it: it says which film is whose)")
        else:
            text = report(
                read(Key.load(options.key), options.ratings, missed=options.missed), options.ours, options.out
            )
            print(text)
    except (Refused, OSError) as trouble:
        print(f"error: {trouble}", file=sys.stderr)
        return 2
    return 0
