"""Runs of one object through the stages of ``train.py``, and the numbers of each."""

import itertools
import json
import logging
import math
import statistics
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from benchmarks.tables.protocol import Task
from benchmarks.tables.reference import error
from diffuphy import pipeline
from diffuphy.artifact import SCRATCH, Done, Stage, Store
from diffuphy.composing import conf_dir, make, slug
from diffuphy.deliverables import export
from diffuphy.evaluate import world
from diffuphy.learning.probe import table_field
from diffuphy.metrics.book import Book
from diffuphy.metrics.score import Scores
from diffuphy.plan.pictures import sized
from diffuphy.quoting import protect
from diffuphy.types import MaterialField, Particles, Prompt, SimulationDiverged, Trajectory

log = logging.getLogger(__name__)

PHYSICS = ("energy created", "penetration", "volume change", "inverted", "strain", "speed at the end")
"""Scores of a motion that need neither a film nor weights."""


def settings(overrides: Sequence[str]) -> dict[str, Any]:
    """The settings of a run of ``train.py``, and the reference as one more stage."""
    with initialize_config_dir(str(conf_dir()), version_base="1.3"):
        cfg = OmegaConf.to_container(compose("train", overrides=protect(list(overrides))), resolve=True)
    assert isinstance(cfg, dict)
    known = {"library": cfg["material"]["library"], "override": cfg["material"]["override"]}
    cfg["stages"]["reference"] = {
        "_target_": "benchmarks.tables.reference.Reference", "scene": cfg["scene"], "seed": cfg["seed"], **known,
    }  # fmt: skip
    return cfg


def run(task: Task, *, size: str, store: Path, device: str, films: Path | None = None) -> list[dict[str, Any]]:
    """All variants of a task, one row each; a variant that cannot be simulated has a reason instead of numbers."""
    torch.set_num_threads(1)
    logging.getLogger("diffuphy").setLevel(logging.WARNING)
    rows = []
    for name in task.variants:
        row = {"prompt": task.prompt, "variant": name, "seed": task.seed}
        begin = time.perf_counter()
        try:
            row |= _one(task, name, size, Store(store, device=device, progress=False), films)
        except (SimulationDiverged, FloatingPointError) as trouble:
            row["why"] = str(trouble)
        print(f"{name:<22} seed {task.seed}  {task.prompt:<42} error {row.get('error', math.nan):7.4f}  "
              f"{time.perf_counter() - begin:5.1f} s", flush=True)  # fmt: skip
        rows.append(row)
    return rows


def _one(task: Task, name: str, size: str, store: Store, films: Path | None) -> dict[str, Any]:
    cfg = settings(task.overrides(name, size, store.device))
    components = make(cfg["stages"])
    pipeline.run(components, store=store, until="particles")
    at_work = time.process_time()
    if store.device != "cpu":
        torch.cuda.reset_peak_memory_stats()
    *_, material = pipeline.run(components, store=store, until="material")[0]
    cpu = _remembered(store.root, material, time.process_time() - at_work)
    device_memory = torch.cuda.max_memory_allocated() / 1e6 if store.device != "cpu" else math.nan
    done, plan = pipeline.run(components, store=store, until="trajectory" if films is None else "clip")
    at = {d.name: d.path for d in done}
    row = _motion(components, store, at) if not task.meant else _meant(task, cfg, size, store, at)
    row |= {"cpu_seconds": cpu, "seconds": material.seconds, "step_seconds": _step(material.path)}
    row |= {"megabytes": material.megabytes, "device_megabytes": device_memory} | _summary(material.path)
    if films is not None:
        folder = films / slug(task.prompt, name, str(task.seed))
        text = OmegaConf.to_yaml(cfg, resolve=False)
        files = export(folder, done, plan, title=task.prompt, settings=text, outputs=["mp4"])
        row["film"] = str(files["film"])
        row |= {s.name: s.value for s in Scores.load(at["evaluate"]).scores}
    return row


def _reference(components: dict[str, Any], store: Store) -> dict[str, Done]:
    """The first stages, and what the prior has in mind of this object."""
    inputs = ("prompt.look", "prompt.motion", "particles")
    stage = Stage("reference", Trajectory, components["reference"], inputs)
    components = components | sized(components)  # the particles of the film, as its plan resolves them
    return {d.name: d for d in store.run([*pipeline.stages(components)[:3], stage], "reference")}


def _motion(components: dict[str, Any], store: Store, at: dict[str, Path]) -> dict[str, float]:
    """The error of the motion, and checks that any motion must pass."""
    reference = Trajectory.load(_reference(components, store)["reference"].path)
    prompt, particles = Prompt.load(at["prompt"]), Particles.load(at["particles"])
    film, field = Trajectory.load(at["trajectory"]), MaterialField.load(at["material"])
    known = components["reference"]
    mass = table_field(known.library, prompt.look, prompt.motion, particles, known.override).rho * particles.vol
    found = error(film, reference, mass / mass.sum(), prompt.motion.size)
    book, there = Book(), world(components["trajectory"].scene(prompt.motion, particles))
    book.physics(film, field.rho * particles.vol, particles.vol, there, prompt.motion.size)
    return found | {s.name: s.value for s in book.scores if s.name in PHYSICS}


def _meant(task: Task, cfg: dict[str, Any], size: str, store: Store, at: dict[str, Path]) -> dict[str, float]:
    """The error of a motion against that of another sentence, whose object has other particles: of the centre of mass
    and of the three lengths √(Σ m (x − x̄)²) along the axes, which need no partner for each particle."""
    other = Task(task.meant, task.seed, {"": ()})
    wanted = make(settings(other.overrides("", size, store.device))["stages"])
    reference = _reference(wanted, store)
    film, aim = Trajectory.load(at["trajectory"]), Trajectory.load(reference["reference"].path)
    length = Prompt.load(reference["prompt"].path).motion.size
    (a, wide_a), (b, wide_b) = (_moments(t) for t in (film, aim))
    com, shape = (a - b).norm(dim=1), (wide_a - wide_b).norm(dim=1)
    whole = torch.hypot(com, shape)
    return {n: float(e[1:].mean()) / length for n, e in (("error", whole), ("com", com), ("shape", shape))}


def _moments(film: Trajectory) -> tuple[torch.Tensor, torch.Tensor]:
    """Middle and root mean square extents of each frame, each (T, 3) [m]."""
    x = film.x.double()
    return x.mean(1), x.std(1, correction=0)


def _remembered(root: Path, material: Done, cpu: float) -> float:
    """Processor time of a material stage when it ran [s]; kept beside the store's results."""
    file = root / "tables" / f"{material.path.name}.json"
    if not material.cached:
        file.parent.mkdir(exist_ok=True)
        file.write_text(json.dumps({"cpu_seconds": cpu}))
    return json.loads(file.read_text())["cpu_seconds"] if file.exists() else math.nan


def _step(material: Path) -> float:
    """Median time from one optimiser step to the next [s]; NaN without two of them."""
    log_file = material / SCRATCH / "metrics.jsonl"
    lines = [json.loads(line) for line in log_file.read_text().splitlines()] if log_file.exists() else []
    times = [line["time"] for line in lines if "loss" in line]
    return statistics.median(b - a for a, b in itertools.pairwise(times)) if len(times) > 1 else math.nan


def _summary(material: Path) -> dict[str, float]:
    """What the stage says of its own result."""
    file = material / SCRATCH / "summary.json"
    told = json.loads(file.read_text()) if file.exists() else {}
    return {name: told[name] for name in ("hardened_loss", "held_out_motion", "log10_E") if name in told}
