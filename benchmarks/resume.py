"""Kill a run at random moments, start it again each time, and compare its results with those of an undisturbed run.

    python benchmarks/resume.py --kills 10 --experiment tiny

Prints the digest of every result of both runs; they must be equal bit by bit.
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
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def command(store: Path, prompt: str, experiment: str) -> list[str]:
    settings = [f"prompt={prompt}", f"experiment={experiment}", f"store={store}", "device=cpu"]
    return [sys.executable, str(ROOT / "train.py"), *settings]


def digests(store: Path) -> dict[str, str]:
    """Digest of every stored result, by stage."""
    found = sorted(store.glob("*/*/meta.json"))
    return {meta.parent.parent.name: json.loads(meta.read_text())["digest"] for meta in found}


def run_killed(args: list[str], log: Path, delays: list[float]) -> list[float]:
    """Run with a SIGKILL after each delay [s]; then to the end. Returns the delays that hit a living process."""
    hits = []
    for delay in delays:
        with open(log, "a") as out:
            process = subprocess.Popen(args, stdout=out, stderr=out, start_new_session=True)
            try:
                process.wait(timeout=delay)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
                hits.append(delay)
    with open(log, "a") as out:
        subprocess.run(args, stdout=out, stderr=out, check=True)
    return hits


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=10)
    parser.add_argument("--experiment", default="tiny")
    parser.add_argument("--prompt", default="a rubber burger falling")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        stores = Path(folder) / "whole", Path(folder) / "killed"
        start = time.perf_counter()
        with open(Path(folder) / "whole.log", "w") as out:
            subprocess.run(command(stores[0], options.prompt, options.experiment), stdout=out, stderr=out, check=True)
        whole = time.perf_counter() - start
        rng = random.Random(options.seed)
        # delays that grow, so that every stage is hit: each start has to get past what is already stored
        delays = [rng.uniform(0.05, 0.9) * whole for _ in range(options.kills)]
        hits = run_killed(command(stores[1], options.prompt, options.experiment), Path(folder) / "killed.log", delays)
        expected, found = (digests(s) for s in stores)
    print(f"undisturbed run {whole:.1f} s; {len(hits)} kills after {', '.join(f'{h:.1f}' for h in hits)} s")
    for stage in expected:
        same = expected[stage] == found.get(stage)
        print(f"{stage:<12} {expected[stage][:16]} {str(found.get(stage))[:16]} {'equal' if same else 'DIFFERENT'}")
    return 0 if expected == found else 1


if __name__ == "__main__":
    raise SystemExit(main())
