"""From settings to a film, for the command line and for Python:

import diffuphy

made = diffuphy.film("a rubber burger falling", "experiment=tiny")
made.files["film"]                      # outputs/runs/a-rubber-burger-falling-…/film.mp4
made.result("trajectory").x             # positions, shape (T + 1, N, 3) [m]
"""

import contextlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import hydra
from omegaconf import DictConfig, OmegaConf, open_dict

from diffuphy.composing import conf_dir, device, make, set_threads
from diffuphy.quoting import protect

if TYPE_CHECKING:
    from diffuphy.artifact import Done
    from diffuphy.plan import Plan


@dataclass(frozen=True)
class Made:
    """What a run has made."""

    folder: Path
    """The run's folder."""
    files: dict[str, Path]
    """Film, contact sheet, report and the like, by kind."""
    done: "tuple[Done, ...]"
    """Every stage that was needed: its result's place, seconds, memory."""
    plan: "Plan"
    """What was run, kept and left out, and why."""

    def result(self, stage: str) -> Any:
        """The result of a stage (``prompt``, ``gaussians``, ``particles``, ``material``, ``trajectory``, ``clip``,
        ``errors``, ``evaluate``).

        Raises:
            KeyError: the run did not get that far.
        """
        from diffuphy.pipeline import stages

        place = {d.name: d.path for d in self.done}
        if stage not in place:
            raise KeyError(f"this run has no stage {stage!r}; it has {', '.join(place)}")
        return next(s.out for s in stages(self.plan.components) if s.name == stage).load(place[stage])


def film(prompt: str, *overrides: str, **settings: Any) -> Made:
    """Make a film, as ``python train.py prompt=... OVERRIDES`` does; what is stored is not computed again.

    Args:
        prompt: the sentence.
        overrides: as on the command line: ``"experiment=fast"``, ``"scene.seconds=1"``, ``"film.floor=false"``.
        settings: the same for settings of one word: ``seed=3``, ``store="films"``, ``until="trajectory"``.

    Raises:
        Whatever the command line would say in one line: ``ValueError`` and Hydra's errors for settings, ``OSError``
        for files, ``SimulationDiverged``.
    """
    given = [*overrides, *(f"{key}={value}" for key, value in settings.items())]
    with hydra.initialize_config_dir(str(conf_dir()), version_base="1.3"):
        cfg = hydra.compose("train", protect([f"prompt={prompt}", *given]), return_hydra_config=True)
        folder = Path(cfg.hydra.run.dir)
        with open_dict(cfg):
            del cfg["hydra"]
    kept = folder / ".hydra" / "config.yaml"  # as the command line leaves it: viewer and exporter read it
    kept.parent.mkdir(parents=True, exist_ok=True)
    OmegaConf.save(cfg, kept)
    return make_film(cfg, folder)


def make_film(cfg: DictConfig, folder: Path) -> Made:
    """Build the components, run the pipeline, write what a person takes away into ``folder``."""
    from diffuphy import pipeline
    from diffuphy.artifact import Store
    from diffuphy.deliverables import export
    from diffuphy.formats import check as check_outputs
    from diffuphy.settings import check

    settings = OmegaConf.to_container(cfg, resolve=True)
    assert isinstance(settings, dict)
    check(settings)
    check_outputs(settings["outputs"])
    cfg.device = device(cfg.device)
    set_threads(cfg.threads)
    force = [cfg.force] if isinstance(cfg.force, str) else list(cfg.force)
    components = make(settings["stages"])
    with watching(cfg.viewer) as watch:
        store = Store(Path(cfg.store), device=cfg.device, interval=cfg.checkpoint_seconds, watch=watch)
        done, plan = pipeline.run(
            components, store=store, until=cfg.until, force=force, run_dir=folder, accuracy=cfg.accuracy
        )
    text = OmegaConf.to_yaml(cfg, resolve=False)
    files = export(folder, done, plan, title=cfg.prompt, settings=text, outputs=settings["outputs"])
    return Made(folder, files, tuple(done), plan)


def watching(viewer: str) -> contextlib.AbstractContextManager[Any]:
    """Who shows what a stage has so far; None, and nothing is imported, unless it is asked for."""
    if viewer == "off":
        return contextlib.nullcontext()
    from diffuphy.viewer.training import Training

    return contextlib.closing(Training.start())
