"""``python -m diffuphy.convert scene.json``, or ``diffuphy-convert`` when installed: a PhysGaussian scene file as a
preset of ours, and a table of what each value means here."""

import argparse
import dataclasses
import math
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

FOLDER = "experiment"
"""Folder of presets inside a folder of settings."""


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(prog="diffuphy-convert", description="A PhysGaussian scene file as a preset of ours.")
    p.add_argument("scene", help="the scene file, JSON")
    p.add_argument("-o", "--out", metavar="FOLDER", help="write FOLDER/experiment/NAME.yaml (default: print the table)")
    count = "particles of the scene that the file was written for: its forces are per particle (as many as here)"
    p.add_argument("--particles", type=int, metavar="N", help=count)
    return p


def settings(component: Any) -> Any:
    """A component as the settings that make it: ``_target_``, and every field that is not at its default."""
    if dataclasses.is_dataclass(component) and not isinstance(component, type):
        found = {"_target_": f"{type(component).__module__}.{type(component).__qualname__}"}
        for f in dataclasses.fields(component):
            value = getattr(component, f.name)
            default = f.default_factory() if f.default_factory is not dataclasses.MISSING else f.default
            if f.init and (default is dataclasses.MISSING or value != default):
                found[f.name] = settings(value)
        return found
    if isinstance(component, dict):
        return {name: settings(value) for name, value in component.items()}
    if isinstance(component, list | tuple):
        return [settings(value) for value in component]
    if isinstance(component, float) and not math.isfinite(component):
        raise ValueError(f"{component} has no place in a file of settings")
    return component


def preset(path: Path, particles: int | None = None) -> str:
    """The preset that plays a scene file, YAML."""
    from omegaconf import OmegaConf

    from diffuphy.physgaussian import material, played, read

    file = read(path)
    matter = settings(material(str(path)))
    del matter["_target_"]  # that of the group stays, which bears the settings of a fit that other groups bring
    body = {
        "refine": {"default_size": file["scale"]},
        "scene": settings(played(file, particles)),
        "material": matter,
    }
    head = (
        f"# @package _global_\n# The scene of {path.name}, in metres, seconds, kilograms; the floor is z = 0, "
        "the object above the origin.\ndefaults:\n  - override /scene: stated\n  - override /material: stated\n"
    )
    return head + OmegaConf.to_yaml(OmegaConf.create(body))


def name_of(path: Path) -> str:
    """What the preset of a scene file is called: its stem, with what no name may hold as underscores."""
    return re.sub(r"\W+", "_", path.stem, flags=re.ASCII).strip("_") or "scene"


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command.

    Returns:
        Exit status: 0 done, 2 a scene file that cannot be read or has no meaning here.
    """
    options = parser().parse_args(argv)
    path = Path(options.scene)
    from diffuphy.physgaussian import read, table

    try:
        if options.particles is not None and options.particles < 1:
            raise ValueError(f"--particles must be at least 1, got {options.particles}")
        print(table(read(path), options.particles))
        text = preset(path, options.particles)
        if options.out is None:
            return 0
        written = Path(options.out) / FOLDER / f"{name_of(path)}.yaml"
        written.parent.mkdir(parents=True, exist_ok=True)
        written.write_text(text, encoding="utf-8")
    except (ValueError, OSError) as error:
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    print(f"\nwritten  {written}\nplay it  python train.py --config-dir {options.out} experiment={name_of(path)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
