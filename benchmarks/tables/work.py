"""Runs of one object through the stages of ``train.py``, and the numbers of each."""

import itertools
import json
import logging
import math
import statistics
import time
from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any

import torch
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from benchmarks.tables.look import likeness, pictures
from benchmarks.tables.protocol import Task
from benchmarks.tables.reference import error
from diffuphy import pipeline
from diffuphy.artifact import SCRATCH, Done, Stage, Store, digest
from diffuphy.composing import conf_dir, make, slug
from diffuphy.deliverables import export
from diffuphy.evaluate import world
from diffuphy.learning.probe import table_field
from diffuphy.metrics.book import Book
from diffuphy.metrics.score import Scores
from diffuphy.plan.pictures import sized
from diffuphy.quoting import protect
from diffuphy.types import Gaussians, Look, MaterialField, Particles, Prompt, SimulationDiverged, Trajectory

log = logging.getLogger(__name__)

PHYSICS = ("energy created", "penetration", "volume change", "inverted", "strain", "speed at the end")
"""Scores of a motion that need neither a film nor weights."""


def settings(overrides: Sequence[str]) -> dict[str, Any]:
    """The settings of a run of ``train.py``, and as two more stages what its motion is compared with."""
    with initialize_config_dir(str(conf_dir()), version_base="1.3"):
        cfg: Any = OmegaConf.to_container(compose("train", overrides=protect(list(overrides))), resolve=True)
    known = {"library": cfg["material"]["library"], "override": cfg["material"]["override"]}
    known |= {"scene": cfg["scene"]}
    here = "benchmarks.tables.reference"
    cfg["stages"]["reference"] = {"_target_": f"{here}.Reference", "seed": cfg["seed"], **known}
    cfg["stages"]["told"] = {"_target_": f"{here}.Told", **known}
    return cfg


def run(
    task: Task, *, size: str, store: Path, device: str, until: str = "trajectory", films: Path | None = None
) -> list[dict[str, Any]]:
    """All variants of a task, one row each; a variant that cannot be simulated has a reason instead of numbers.

    Args:
        until: ``trajectory``, or ``gaussians`` where nothing but the object is compared.
    """
    torch.set_num_threads(1)
    logging.getLogger("diffuphy").setLevel(logging.WARNING)
    rows = []
    for name in task.variants:
        row = {"prompt": task.prompt, "variant": name, "seed": task.seed}
        begin = time.perf_counter()
        try:
            shop = Store(store, device=device, progress=False)
            row |= _object(task, name, size, shop) if until == "gaussians" else _one(task, name, size, shop, films)
        except (SimulationDiverged, FloatingPointError) as trouble:
            row["why"] = str(trouble)
        print(f"{name:<22} seed {task.seed}  {task.prompt:<42} {_said(row)}  "
              f"{time.perf_counter() - begin:5.1f} s", flush=True)  # fmt: skip
        rows.append(row)
    return rows


def _said(row: dict[str, Any]) -> str:
    """The number that a row is about."""
    return next((f"{name} {row[name]:7.4f}" for name in ("error", "psnr") if name in row), "diverged")


def _made(task: Task, name: str, size: str, store: Store) -> tuple[Done, tuple[Gaussians, Any, Look]]:
    """The stage of an object, and what ``likeness`` takes."""
    components = make(settings(task.overrides(name, size, store.device))["stages"])
    prompt, made = pipeline.run(components, store=store, until="gaussians")[0]
    prior = components["gaussians"].guidance.references
    return made, (Gaussians.load(made.path), prior, Prompt.load(prompt.path).look)


def _object(task: Task, name: str, size: str, store: Store) -> dict[str, Any]:
    """The look of an object, and what it took."""
    made, seen = _made(task, name, size, store)
    took = {"gaussians": float(len(seen[0])), "seconds": made.seconds}
    return likeness(*seen) | took | {"digest": digest(made.path)[:12]}


def objects(task: Task, size: str, store: Path, device: str) -> list[torch.Tensor]:
    """Pictures of the prior's own object and of those of all variants, each (n, S, S, 3)."""
    shop = Store(store, device=device, progress=False)
    pairs = [pictures(*_made(task, name, size, shop)[1]) for name in task.variants]
    return [pairs[0][1].rgb, *(made.rgb for made, _ in pairs)]


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
    row = _motion(components, store, at) if task.meant in ("", task.prompt) else {}
    if task.meant == task.prompt:
        row["floor"] = _floor(components, store, at)
    if task.meant:
        row |= _meant(task, size, store, at) | _digest(at)
    row |= {"cpu_seconds": cpu, "seconds": material.seconds, "step_seconds": _step(material.path)}
    row |= {"megabytes": material.megabytes, "device_megabytes": device_memory} | _summary(material.path)
    if films is not None:
        folder = films / slug(task.prompt, name, str(task.seed))
        folder.mkdir(parents=True, exist_ok=True)
        text = OmegaConf.to_yaml(cfg, resolve=False)
        files = export(folder, done, plan, title=task.prompt, settings=text, outputs=["mp4"])
        row["film"] = str(files["film"])
        row |= {s.name: s.value for s in Scores.load(at["evaluate"]).scores}
    return row


def _besides(components: dict[str, Any], store: Store, name: str) -> dict[str, Done]:
    """The first stages, and what their object does in the hands of ``reference`` or ``told``."""
    inputs = ("prompt.look", "prompt.motion", "particles")
    stage = Stage(name, Trajectory, components[name], inputs)
    components = components | sized(components)  # the particles of the film, as its plan resolves them
    return {d.name: d for d in store.run([*pipeline.stages(components)[:3], stage], name)}


def _motion(components: dict[str, Any], store: Store, at: dict[str, Path]) -> dict[str, float]:
    """The error of the motion, and checks that any motion must pass."""
    prompt, particles = Prompt.load(at["prompt"]), Particles.load(at["particles"])
    film, field = Trajectory.load(at["trajectory"]), MaterialField.load(at["material"])
    book, there = Book(), world(components["trajectory"].scene(prompt.motion, particles))
    book.physics(film, field.rho * particles.vol, particles.vol, there, prompt.motion.size)
    return _error(film, components, store, at) | {s.name: s.value for s in book.scores if s.name in PHYSICS}


def _error(film: Trajectory, components: dict[str, Any], store: Store, at: dict[str, Path]) -> dict[str, float]:
    """The error of a motion of this object against what the prior has in mind of it."""
    reference = Trajectory.load(_besides(components, store, "reference")["reference"].path)
    prompt, particles = Prompt.load(at["prompt"]), Particles.load(at["particles"])
    known = components["reference"]
    mass = table_field(known.library, prompt.look, prompt.motion, particles, known.override).rho * particles.vol
    return error(film, reference, mass / mass.sum(), prompt.motion.size)


def _floor(components: dict[str, Any], store: Store, at: dict[str, Path]) -> float:
    """The error that this object would have with the prior's own material: finding it leaves no less."""
    told = Trajectory.load(_besides(components, store, "told")["told"].path)
    return _error(told, components, store, at)["error"]


def _meant(task: Task, size: str, store: Store, at: dict[str, Path]) -> dict[str, float]:
    """How far motion and look are from those of the object that was meant, which has other particles: compared are the
    centre of mass, the three lengths √(Σ m (x − x̄)²) along the axes, and pictures; none needs a partner for each
    particle.
    """
    other = Task(task.meant, task.seed, {"": ()})
    wanted = make(settings(other.overrides("", size, store.device))["stages"])
    reference = _besides(wanted, store, "reference")
    film, aim = Trajectory.load(at["trajectory"]), Trajectory.load(reference["reference"].path)
    prompt = Prompt.load(reference["prompt"].path)
    (a, wide_a), (b, wide_b) = (_moments(t) for t in (film, aim))
    com, shape = (a - b).norm(dim=1), (wide_a - wide_b).norm(dim=1)
    parts = {"error": torch.hypot(com, shape), "com": com, "shape": shape}
    found = {name: float(e[1:].mean()) / prompt.motion.size for name, e in parts.items()}
    seen = likeness(Gaussians.load(at["gaussians"]), wanted["gaussians"].guidance.references, prompt.look)
    return (found if task.meant != task.prompt else {"meant": found["error"]}) | seen


def _digest(at: dict[str, Path]) -> dict[str, str]:
    """What tells the object and motion of a run from those of another."""
    both = "".join(digest(at[name]) for name in ("gaussians", "trajectory"))
    return {"digest": sha256(both.encode()).hexdigest()[:12]}


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
