"""The table of the stages, and the run that walks along it."""

import json
import logging
import os
from pathlib import Path
from typing import Any

from diffuphy.artifact import SCRATCH, Done, Stage, Store, check_names
from diffuphy.metrics.score import Scores
from diffuphy.plan import Line, Plan, cost_lines, make_plan, predicted, pruned_lines, stage_lines
from diffuphy.render.film.views import OtherViews, Views
from diffuphy.types import Clip, Errors, Gaussians, MaterialField, Particles, Prompt, Trajectory

log = logging.getLogger(__name__)


def stages(components: dict[str, Any]) -> list[Stage]:
    """Prompt → Gaussians → particles → material → trajectory → clip; beside them further views, and how wrong and how
    good the film is."""
    c = components
    table = [
        Stage("prompt", Prompt, c["prompt"]),
        Stage("gaussians", Gaussians, c["gaussians"], ("prompt.look",)),
        Stage("particles", Particles, c["particles"], ("gaussians", "prompt.motion")),
        Stage("material", MaterialField, c["material"], ("prompt.look", "prompt.motion", "gaussians", "particles")),
        Stage("trajectory", Trajectory, c["trajectory"], ("prompt.motion", "particles", "material")),
        Stage("clip", Clip, c["clip"], ("gaussians", "particles", "trajectory", *painted(c["clip"]))),
    ]
    if getattr(c["clip"], "also", ()):
        made_of = ("gaussians", "particles", "trajectory", "material")
        table.append(Stage("views", Views, OtherViews.of(c["clip"]), made_of))
    if "errors" in c and c["errors"].error == "on":
        made_of = ("prompt.motion", "particles", "material", "trajectory")
        table.append(Stage("errors", Errors, c["errors"], made_of))
    if "evaluate" in c and c["evaluate"].score == "on":
        made_of = ("prompt.look", "prompt.motion", "gaussians", "particles", "material", "trajectory", "clip")
        table.append(Stage("evaluate", Scores, c["evaluate"], made_of))
    return table


def painted(film: Any) -> tuple[str, ...]:
    """What a film of the material asks for besides; nothing of a component of somebody else's making."""
    return ("material",) if getattr(film, "matter", False) else ()


def last(table: list[Stage], until: str) -> str:
    """The stage to run to: with the film comes all that a reader of its report wants to know."""
    return table[-1].name if until == "clip" else until


def run(
    components: dict[str, Any],
    *,
    store: Store,
    until: str = "clip",
    force: list[str] | None = None,
    run_dir: Path | None = None,
    accuracy: float | None = None,
) -> tuple[list[Done], Plan]:
    """Run the stages a scene needs, up to ``until``.

    Args:
        components: one component a stage, by stage name.
        until: last stage to run; with the clip come errors and scores.
        force: stages to run even if their result is stored.
        run_dir: where links to the results, the plan and its text go.
        accuracy: error that the film may have, over the size of the object; None keeps the grid of the components.
    """
    force = list(force or [])
    first = stages(components)
    check_names(first, (until, *force))
    until = last(first, until)
    (prompt,) = store.run(first, "prompt", force=[f for f in force if f == "prompt"])
    words = Prompt.load(prompt.path)
    plan = make_plan(components, words, accuracy=accuracy, device=store.device)
    table = stages(plan.components)
    cached = store.look_up(table)
    known = len(Particles.load(cached["particles"])) if "particles" in cached else None
    cost = predicted(plan.components, words, particles=known, device=store.device)
    running = stage_lines(table, cached, until, force, cost)
    seen = Line.kept("viewer", store.watch is not None, "what training has so far, in a browser", "viewer=off")
    plan = Plan(plan.components, (*running, *cost_lines(running, cost), *plan.lines, seen))
    log.info("%s", plan)
    if run_dir is not None:
        run_dir.mkdir(parents=True, exist_ok=True)
        plan.save(run_dir / "plan.json")
    done = [prompt, *store.run(table, until, force=[f for f in force if f != "prompt"])[1:]]
    plan = Plan(plan.components, (*plan.lines, *_trained(done, plan)))
    if run_dir is not None:
        plan.save(run_dir / "plan.json")
        for number, d in enumerate(done, 1):
            _link(run_dir / f"{number}_{d.name}", d.path)
    return done, plan


def _trained(done: list[Done], plan: Plan) -> list[Line]:
    """What the training has decided."""
    path = next((d.path for d in done if d.name == "material"), None)
    if path is None:
        return []
    summary = path / SCRATCH / "summary.json"
    numbers = json.loads(summary.read_text(encoding="utf-8")) if summary.exists() else {}
    material = plan.components["material"]
    candidates = {"elastic": material.elastic, "plastic": material.plastic}
    return pruned_lines(MaterialField.load(path), candidates, numbers)


def _link(link: Path, target: Path) -> None:
    """Point ``link`` at ``target``, relatively; on file systems without links write the path into a text file."""
    relative = os.path.relpath(target, link.parent)
    link.unlink(missing_ok=True)
    try:
        link.symlink_to(relative, target_is_directory=True)
    except OSError:
        link.with_suffix(".path.txt").write_text(relative + "\n", encoding="utf-8")
