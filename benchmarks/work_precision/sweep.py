"""Every run of a case: which are made, in which order, and what becomes of their samples."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from benchmarks.work_precision.cases import Case
from benchmarks.work_precision.choice import CHOICES, DEFAULT, Choice, named
from benchmarks.work_precision.peers import CODES, Child, Code, PeerTrial, has
from benchmarks.work_precision.problem import Sample, Trial
from benchmarks.work_precision.rows import Row
from benchmarks.work_precision.timing import Timed, interleaved, noise

log = logging.getLogger(__name__)

MOST_WORK = {"default": 8e6, "peer": 8e5, "CFL": 2e6}
"""Particle-substeps of the largest run that is made of an axis."""
OTHER = 2.5e6
"""The same of the other axes."""
BUDGET, QUICK_BUDGET = 0.5, 0.1
"""For the repeats of one run [s]."""
QUICK = ("default", "plain MLS", "plain APIC", "float64")
"""Series of the quick form."""


class Runner(Protocol):
    """Something that is timed."""

    particles: Any
    rounds: Any

    def run(self) -> Sample: ...

    def error(self) -> float: ...


@dataclass
class Entry:
    """A run to be made, and the fields of its row that are known before."""

    runner: Runner
    fields: dict[str, Any]
    paired: bool = False
    """A second time the default, to see what equal runs differ by."""
    error: float = field(default=float("nan"))

    def sample(self) -> Sample:
        return self.runner.run()


@dataclass(frozen=True)
class Swept:
    """All rows of a case, and the A/A noise of its seconds."""

    rows: list[Row]
    noise: float


def settings(choice: Choice) -> dict[str, Any]:
    """What a row says of a choice."""
    s = choice.scheme
    return {
        "series": choice.series, "axis": choice.axis, "cfl": choice.cfl, "precision": choice.precision,
        "order": s.order, "force": s.force, "per": choice.per,
    }  # fmt: skip


def choices_of(case: Case, quick: bool) -> tuple[Choice, ...]:
    """What is varied for a case."""
    return tuple(c for c in (named(*QUICK) if quick else CHOICES) if c.series not in case.leave_out)


def own(case: Case, quick: bool) -> list[Entry]:
    """Runs of this solver."""
    entries = []
    for choice in choices_of(case, quick):
        for n in case.quick if quick else case.resolutions:
            if (choice.per * n) % 1 or (choice.per * 1.5 * n) % 1:
                continue  # no whole number of particles
            trial = Trial(case.build(n, choice.per), choice)
            if trial.particles * trial.rounds > MOST_WORK.get(choice.axis, OTHER):
                break
            known = {"case": case.id, "cells": n, "dx": trial.problem.dx} | settings(choice)
            entries.append(Entry(trial, known))
    return entries


def others(case: Case, quick: bool, python: str | None, folder: Path) -> tuple[list[Entry], list[Child], list[str]]:
    """Runs of other codes, the processes they run in, and what is left out and why."""
    entries, children, missing = [], [], []
    for code in CODES:
        if code.family not in case.peers:
            continue
        if code.package and (python is None or not has(python, code.package)):
            missing.append(how_to(code, python))
            continue
        child = Child(code, python or "", folder)
        children.append(child)
        try:
            PeerTrial(case.build(case.resolutions[0], 2), child, folder).run()  # compiles
        except RuntimeError as error:
            missing.append(f"{code.series} is left out of {case.id}: {error}")
            continue
        for n in (case.quick if quick else case.resolutions)[: 1 if quick else None]:
            problem = case.build(n, 2)
            steps = problem.steps(code.cfl)[1] * problem.frames
            if len(problem.body.x) * steps > MOST_WORK["peer"] or steps > code.most:
                break
            trial = PeerTrial(problem, child, folder)
            known = {
                "case": case.id, "cells": n, "dx": problem.dx, "series": code.series, "axis": "peer", "cfl": code.cfl,
                "precision": "float32", "order": 2, "force": code.force, "per": 2.0,
            }  # fmt: skip
            entries.append(Entry(trial, known))
    return entries, children, missing


def how_to(code: Code, python: str | None) -> str:
    where = "no --peers-python was given" if python is None else f"{Path(python).name} has no {code.package}"
    return (
        f"{code.series} is left out: {where}; python -m venv peers, peers/bin/pip install {code.package}, "
        "then --peers-python peers/bin/python"
    )


def swept(entries: Sequence[Entry], budget: float, say: Callable[[str], None] = log.info) -> Swept:
    """Make all runs: the smallest of each series once to compile, then all in turns."""
    compiled: dict[str, Sample] = {}
    for e in entries:
        if e.fields["series"] not in compiled:
            compiled[e.fields["series"]] = e.sample()
            e.fields["compiling"] = True
    twice = [e for e in entries if e.fields["series"] == DEFAULT.series and not e.paired]
    # what is compiled is quick; a pair of the longest would cost more than it tells
    pairs = [Entry(e.runner, e.fields, paired=True) for e in twice[:-1] or twice]
    everything = [*entries, *pairs]
    say(f"{len(entries)} runs, {len(pairs)} of them twice")
    firsts = [compiled[e.fields["series"]] for e in everything]
    timed = interleaved([e.sample for e in everything], firsts, budget)
    rows = [row_of(e, t) for e, t in zip(entries, timed, strict=False)]
    by_entry = {id(e.runner): t for e, t in zip(entries, timed, strict=False)}
    again = timed[len(entries) :]
    same = [(by_entry[id(e.runner)].seconds, t.seconds) for e, t in zip(pairs, again, strict=True)]
    return Swept(rows, noise(same))


def row_of(e: Entry, t: Timed) -> Row:
    """The row of a run."""
    known = dict(e.fields)
    compiling = t.compile if known.pop("compiling", False) else None
    low, high = t.quartiles
    extra = {k: getattr(e.runner, k) for k in ("megabytes", "forward") if hasattr(e.runner, k)}
    return Row(
        **known, particles=e.runner.particles, rounds=e.runner.rounds, error=e.runner.error(), seconds=t.seconds,
        low=low, high=high, wall=sorted(s.wall for s in t.samples)[len(t.samples) // 2], compiling=compiling,
        samples=" ".join(f"{s.seconds:.4g}" for s in t.samples), **extra,
    )  # fmt: skip


def sweep(case: Case, *, quick: bool, python: str | None, folder: Path) -> tuple[Swept, list[str]]:
    """All runs of a case, and what is missing."""
    entries = own(case, quick)
    theirs, children, missing = others(case, quick, python, folder)
    try:
        return swept([*entries, *theirs], QUICK_BUDGET if quick else BUDGET), missing
    finally:
        for child in children:
            child.close()
