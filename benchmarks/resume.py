"""Kill a run again and again, continue it each time, and compare its results with those of an undisturbed run.

    python benchmarks/resume.py [--kills 10] [--seed 0] [--settings experiment=tiny seed=1]

The moments are drawn evenly from the time of the run, its start included. Prints where each kill hit and the digest of
every result of both runs: equal to the last bit.
"""

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
CHECKPOINT_SECONDS = 0.2
"""A short run must reach checkpoints too."""


@dataclass(frozen=True)
class Moment:
    """When to kill."""

    stage: str | None
    """After the log first names this stage; None: after the process has started."""
    delay: float
    """How long after that [s]."""


@dataclass(frozen=True)
class Hit:
    """What a kill met."""

    moment: Moment
    running: str | None
    """The stage that was running; None: none was, or the run was over before the moment came."""
    over: bool
    """The run was over."""


def command(store: Path, prompt: str, *settings: str) -> list[str]:
    fixed = (f"store={store}", "device=cpu", f"checkpoint_seconds={CHECKPOINT_SECONDS}")
    return [sys.executable, str(ROOT / "train.py"), f"prompt={prompt}", *settings, *fixed]


def results(store: Path) -> dict[str, dict]:
    """What each stage stored beside its result, in the order of the run: ``digest``, ``seconds``."""
    files = sorted(store.glob("*/*/meta.json"), key=lambda file: file.stat().st_mtime_ns)
    return {file.parent.parent.name: json.loads(file.read_text(encoding="utf-8")) for file in files}


def digests(store: Path) -> dict[str, str]:
    return {stage: meta["digest"] for stage, meta in results(store).items()}


def moments(kills: int, seconds: dict[str, float], around: float, generator: random.Random) -> list[Moment]:
    """Moments drawn evenly from the time of the run, in order, so that each finds work still to be done.

    Args:
        seconds: of each stage, in the order of the run.
        around: time of the run outside its stages, which is that of its start for the most part [s].
    """
    spans = [(None, around), *seconds.items()]
    total = around + sum(seconds.values())
    found: list[Moment] = []
    for at in sorted(generator.uniform(0, total) for _ in range(kills)):
        stage, delay = within(spans, at)
        earlier = sum(m.delay for m in found if stage is not None and m.stage == stage)
        found.append(Moment(stage, delay - earlier))  # what was done before the last kill is not done again
    return found


def within(spans: list[tuple[str | None, float]], at: float) -> tuple[str | None, float]:
    """The span that a time falls into, and how far into it."""
    for name, length in spans[:-1]:
        if at < length:
            return name, at
        at -= length
    return spans[-1][0], at


def kill_at(moment: Moment, args: list[str], log: Path, checkpoints: Path | None = None) -> Hit:
    """Start the run, and kill its whole process group when the moment has come. Its output is added to ``log``.

    Args:
        checkpoints: the store, to count the delay from the first checkpoint of the moment's stage.
    """
    before = log.stat().st_size if log.exists() else 0
    with open(log, "a", encoding="utf-8") as out:
        process = subprocess.Popen(args, cwd=ROOT, stdout=out, stderr=out, start_new_session=True)

    def said() -> str:
        return log.read_bytes()[before:].decode("utf-8", "replace")

    def begun(stage: str | None) -> bool:
        if stage is not None and checkpoints is not None:
            return any(checkpoints.glob(f"{stage}/*.partial/*/checkpoint-*"))
        return stage is None or f"  {stage}: " in said()

    while process.poll() is None and not begun(moment.stage):
        time.sleep(0.01)
    try:
        process.wait(timeout=moment.delay)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        return Hit(moment, running(said()), over=False)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, args, said())
    return Hit(moment, None, over=True)


def running(output: str) -> str | None:
    """The stage that has begun last and is not done."""
    events = [line[10:].split(": ") for line in output.splitlines() if line[2:3] == ":" and ": " in line]
    events = [e for e in events if e[1].startswith(("started", "continuing", "done", "cached"))]
    return events[-1][0] if events and events[-1][1].startswith(("started", "continuing")) else None


def finish(args: list[str], log: Path) -> float:
    """Run to the end; returns how long it took [s]."""
    start = time.perf_counter()
    with open(log, "a", encoding="utf-8") as out:
        subprocess.run(args, cwd=ROOT, stdout=out, stderr=out, check=True)
    return time.perf_counter() - start


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    parser.add_argument("--prompt", default="a rubber burger falling")
    parser.add_argument("--settings", nargs="*", default=["experiment=tiny"], help="of both runs")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        whole, killed = Path(folder) / "whole", Path(folder) / "killed"
        seconds = finish(command(whole, options.prompt, *options.settings), Path(folder) / "whole.log")
        stages = {name: meta["seconds"] for name, meta in results(whole).items()}
        around = max(0.0, seconds - sum(stages.values()))
        print(f"undisturbed: {seconds:.1f} s, of which {', '.join(f'{n} {s:.1f}' for n, s in stages.items())}")
        args, log = command(killed, options.prompt, *options.settings), Path(folder) / "killed.log"
        for moment in moments(options.kills, stages, around, random.Random(options.seed)):
            hit = kill_at(moment, args, log)
            met = "the run was over" if hit.over else f"killed in {hit.running or 'no stage'}"
            print(f"  {moment.delay:5.1f} s after {moment.stage or 'the start'}: {met}", flush=True)
        finish(args, log)
        continued = log.read_text(encoding="utf-8").count(": continuing\n")
        expected, found = digests(whole), digests(killed)
    print(f"continued from a checkpoint {continued} times")
    for stage in expected:
        verdict = "equal" if expected[stage] == found.get(stage) else "DIFFERENT"
        print(f"{stage:<12} {expected[stage][:16]} {str(found.get(stage))[:16]} {verdict}")
    return 0 if expected == found else 1


if __name__ == "__main__":
    raise SystemExit(main())
