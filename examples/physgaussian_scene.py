"""A scene file of PhysGaussian, as it is: what each of its numbers means here, then the film.

    python examples/physgaussian_scene.py scene.file=my_scene.json refine.default_size=1.0
    python examples/physgaussian_scene.py experiment=tiny            # a plant, held at its foot and pushed once

``refine.default_size`` is the file's scale. Writes outputs/examples/sway.json and
outputs/examples/runs/a-cactus-falling-…/. 10 seconds of one core, with experiment=tiny.
"""

import json
import sys
from pathlib import Path

import diffuphy
from diffuphy.making import Made
from diffuphy.physgaussian import read, table

SWAY = {
    "material": "jelly", "E": 6e4, "nu": 0.3, "density": 200, "g": [0, 0, 0],
    "n_grid": 40, "grid_lim": 2, "substep_dt": 1e-4, "frame_dt": 4e-2, "frame_num": 25,
    "boundary_conditions": [
        {"type": "cuboid", "point": [1, 1, 0.6], "size": [0.6, 0.6, 0.15], "velocity": [0, 0, 0],
         "start_time": 0, "end_time": 1e3, "reset": 1},
        {"type": "particle_impulse", "force": [0.3, 0, 0], "num_dt": 100, "start_time": 0,
         "point": [1, 1, 1.3], "size": [0.6, 0.6, 0.4]},
    ],
}  # fmt: skip
"""A plant of jelly, held at its foot and pushed once at its top, without gravity."""


def write_sway(file: Path) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(SWAY))


def main(*settings: str) -> Made:
    given = list(settings)
    if not any(o.startswith("scene.file=") for o in given):
        file = Path("outputs/examples/sway.json")
        write_sway(file)
        given += [
            f"scene.file={file}",
            "scene.particles=10000",
        ]  # its forces are per particle: for how many it was made
    print(table(read(next(o for o in given if o.startswith("scene.file=")).partition("=")[2])))
    made = diffuphy.film("a cactus falling", "scene=physgaussian", "store=outputs/examples", *given)
    print(made.folder)
    return made


if __name__ == "__main__":
    main(*sys.argv[1:])
