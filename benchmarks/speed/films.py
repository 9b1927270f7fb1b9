"""What the stages of small films take, apart from compiling; and what was predicted for them.

Every film is a process of its own, so that memory is that of a user's run. Kernels that are built or loaded on the way
are timed apart: a plan cannot know which ones a machine has built before.
"""

import dataclasses
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]

Film = tuple[str, tuple[str, ...]]
"""A prompt, and settings."""

FIRM = "+material.stiffness=[4.5,6.3]"
"""Heavy grains as soft as the softest hypothesis of the scan would be turned inside out by their own weight."""

SMALL = ("experiment=tiny", "scene.seconds=0.3")

LEARN: tuple[Film, ...] = (
    ("a rubber ball falling", SMALL),
    ("a sand ball collapsing", (*SMALL, "fit.steps=60", "sample.cells=12", "film.width=256", "film.height=256", FIRM)),
    ("a metal duck bouncing", (*SMALL, "fit.cameras.size=96", "fit.cameras.bank=24", "material.steps=12")),
    ("a jelly bear thrown", (*SMALL, "fit.init.count=3000", "fit.steps=120", "material.probe.particles=1000")),
    ("a honey cup melting", (*SMALL, "sample.cells=24", "fit.cameras.bank=4", "material.probe.image=64")),
)
"""Films from which the prices of stages are learnt."""

USUAL = ("experiment=tiny", "material.stiffness_steps=4")
"""Small, with a scan fine enough that it decides on a stiffness and not between two extremes."""

TEST: tuple[Film, ...] = (
    ("a rubber burger falling on a surface", USUAL),
    ("a sand snowman collapsing", (*USUAL, FIRM)),
    ("a jelly bouncing", (*USUAL, "sample.cells=20")),
    ("pancakes melting", (*USUAL, "material.steps=8")),
    ("a clay mug thrown", (*USUAL, "scene.seconds=0.8")),
    ("a snow ball falling", (*USUAL, "film.width=256", "film.height=256")),
    ("a foam cake squashed", (*USUAL, "fit.cameras.size=64", "fit.steps=300")),
    ("a water ball falling", (*USUAL, "sample.cells=12")),
    ("a plastic ball sliding", (*USUAL, "material.probe.particles=600")),
    ("a steel ball bouncing", (*USUAL, "scene.scheme.order=3", "scene.seconds=0.3")),
)
"""Films whose cost is predicted and then measured; none of them taught a price."""


def run(film: Film) -> dict[str, Any]:
    """Make a film in a process of its own and in a store that is thrown away; see ``main`` for what comes back."""
    prompt, settings = film
    with tempfile.TemporaryDirectory() as store:
        command = [sys.executable, "-c", "from benchmarks.speed.films import main; main()", store]
        command += [f"prompt={prompt}", *settings]
        done = subprocess.run(command, cwd=ROOT, check=False, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{prompt!r} failed:\n{done.stderr[-2000:]}")
    return json.loads(done.stdout.splitlines()[-1])


def expected(film: Film) -> dict[str, Any]:
    """What a plan counts for a film before anything of it exists: work and sizes of each stage, and points."""
    from hydra import compose, initialize_config_dir
    from omegaconf import OmegaConf

    from diffuphy.composing import conf_dir, make
    from diffuphy.cost.body import body
    from diffuphy.cost.stages import STAGES
    from diffuphy.plan import make_plan
    from diffuphy.quoting import protect
    from diffuphy.workspace import Workspace

    text, settings = film
    with initialize_config_dir(str(conf_dir()), version_base="1.3"):
        tree: Any = OmegaConf.to_container(compose("train", protect([f"prompt={text}", *settings])), resolve=True)
    components = make(tree["stages"])
    prompt = components["prompt"](work=Workspace())
    components = make_plan(components, prompt).components
    guess = body(components, prompt)
    counted = {name: count(components, prompt.motion, guess) for name, count in STAGES.items()}
    return {
        "stages": {name: {"work": c.work, "sizes": c.sizes} for name, c in counted.items()},
        "particles": round(guess.particles),
        "gaussians": round(guess.gaussians),
        "rounds": round(counted["trajectory"].work["round"]),
    }


class Watch:
    """Times stages, and what is built or loaded in them."""

    def __init__(self) -> None:
        import warp as wp

        from diffuphy.artifact import Store

        self.stages: dict[str, dict[str, float]] = {}
        self.built, self._depth = 0.0, 0
        load, compute = wp.Module.load, Store._compute

        def timed_load(module: Any, *args: Any, **options: Any) -> Any:
            self._depth += 1
            begin = time.thread_time()
            try:
                return load(module, *args, **options)
            finally:
                self._depth -= 1
                self.built += (time.thread_time() - begin) * (self._depth == 0)

        def timed_compute(store: Store, stage: Any, path: Path, done: Any, types: Any) -> None:
            begin, clock, built = time.process_time(), time.perf_counter(), self.built
            compute(store, stage, path, done, types)
            spent = self.built - built
            meta = json.loads((path / "meta.json").read_text(encoding="utf-8"))
            self.stages[stage.name] = {
                "processor": time.process_time() - begin - spent,
                "seconds": time.perf_counter() - clock,
                "built": spent,
                "bytes": 1e6 * meta["megabytes"],
            }

        wp.Module.load = timed_load  # type: ignore[method-assign]
        Store._compute = timed_compute  # type: ignore[method-assign]


def main() -> None:
    """Make one film; print what its stages took, how many points and rounds there were, and what work that was."""
    store, *arguments = sys.argv[1:]
    from diffuphy import pipeline
    from diffuphy.cli import main as film
    from diffuphy.cost.body import body
    from diffuphy.cost.stages import STAGES
    from diffuphy.types import Gaussians, Particles, Prompt

    watch, plans = Watch(), []
    make = pipeline.make_plan
    pipeline.make_plan = lambda *a, **k: (plans.append(make(*a, **k)), plans[-1])[1]
    if film([*arguments, f"store={store}", "device=cpu"]):
        raise SystemExit(2)
    components = plans[-1].components
    at = {name: next((Path(store) / name).glob("*/meta.json")).parent for name in STAGES}
    prompt = Prompt.load(at["prompt"])
    made = len(Particles.load(at["particles"])), len(Gaussians.load(at["gaussians"]))
    known = dataclasses.replace(body(components, prompt), particles=made[0], gaussians=made[1])
    stages: dict[str, Any] = {}
    for name, count in STAGES.items():
        counted = count(components, prompt.motion, known)
        stages[name] = watch.stages[name] | {"work": counted.work, "sizes": counted.sizes}
    rows = (at["trajectory"] / "work" / "metrics.jsonl").read_text().splitlines()
    taken = sum(json.loads(row)["substeps"] + 1 for row in rows)
    work = stages["trajectory"]["work"]
    stages["trajectory"]["work"] = {
        u: n if u.startswith("frame") else taken / work["round"] * n for u, n in work.items()
    }
    print(json.dumps({
        "prompt": arguments[0].partition("=")[2],
        "settings": arguments[1:],
        "stages": stages,
        "particles": made[0],
        "gaussians": made[1],
        "rounds": taken,
        "cores": os.cpu_count(),
    }))  # fmt: skip


if __name__ == "__main__":
    main()
