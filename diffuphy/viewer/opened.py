"""A finished run as objects."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from diffuphy.mpm.trajectory import Play
from diffuphy.render import Film
from diffuphy.types import Gaussians, MaterialField, Motion, Particles, Prompt, Trajectory

RESULTS: dict[str, Any] = {
    "prompt": Prompt,
    "gaussians": Gaussians,
    "particles": Particles,
    "material": MaterialField,
    "trajectory": Trajectory,
}
"""What a run must have to be looked at, by stage."""


@dataclass(frozen=True)
class Run:
    """Results of a run on one device, and the components that made its motion and its film."""

    folder: Path
    """Where the run's files are."""
    motion: Motion
    """What happens, in words."""
    gaussians: Gaussians
    """What it looks like, in the object's frame."""
    particles: Particles
    """At rest, in metres."""
    field: MaterialField
    """What they are made of."""
    trajectory: Trajectory
    """The film's motion; kept in main memory."""
    play: Play
    """Makes the scene of particles, and a motion of both."""
    film: Film
    """Makes the pictures."""

    @classmethod
    def open(cls, folder: Path | str, device: str = "cpu") -> Self:
        """Read a run folder.

        Args:
            device: where simulations will be.

        Raises:
            ValueError: what is no folder of a finished run, or holds settings that no longer make a component.
        """
        folder = Path(folder)
        found = {name: _result(folder, name) for name in RESULTS}
        if not folder.is_dir() or not any(found.values()):
            raise ValueError(
                f"{folder} is no run folder: give the one that a run ended with, such as outputs/runs/NAME"
            )
        if absent := [name for name, path in found.items() if path is None]:
            raise ValueError(f"{folder} has no {absent[0]} yet: run its command again, without until=, to finish it")
        results = {name: RESULTS[name].load(path) for name, path in found.items()}
        components = _components(folder, results["prompt"].motion)
        return cls(
            folder,
            results["prompt"].motion,
            *(results[name].to(device) for name in ("gaussians", "particles", "material")),
            results["trajectory"],
            components["trajectory"],
            components["clip"],
        )


def _result(folder: Path, name: str) -> Path | None:
    """The folder of a stage's result: a link, or where there are none a text file that says where it is."""
    for link in sorted(folder.glob(f"[0-9]*_{name}")):
        if (link / "result.json").exists():
            return link
    for note in sorted(folder.glob(f"[0-9]*_{name}.path.txt")):
        path = folder / note.read_text(encoding="utf-8").strip()
        if (path / "result.json").exists():
            return path
    return None


def _components(folder: Path, motion: Motion) -> dict[str, Any]:
    """Those of motion and film, as the run's settings and its accuracy make them."""
    from omegaconf import OmegaConf

    from diffuphy.accuracy import choose
    from diffuphy.composing import make

    file = folder / ".hydra" / "config.yaml"
    if not file.exists():
        raise ValueError(f"{file} is missing: it says with which settings the run was made; run its command again")
    config = OmegaConf.load(file)
    accuracy = config.get("accuracy")
    names = ["trajectory", "clip"] if accuracy is None else ["particles", "trajectory", "clip"]
    components = make({name: OmegaConf.to_container(config.stages[name], resolve=True) for name in names})
    return components if accuracy is None else choose(accuracy, motion).applied(components)
