"""A scene file of PhysGaussian, as it is: what each of its numbers means here, then the film.

python examples/physgaussian_scene.py scene.file=my_scene.json
python examples/physgaussian_scene.py experiment=tiny  # a jelly cube, clamped at its foot, pushed once
"""

import json
import sys
from pathlib import Path

import diffuphy
from diffuphy.making import Made
from diffuphy.physgaussian import read, table

SWAY = {
    "material": "jelly", "E": 2e5, "nu": 0.3, "density": 200, "g": [0, 0, 0], "n_grid": 40, "grid_lim": 2,
    "substep_dt": 1e-4, "frame_dt": 4e-2, "frame_num": 25,
    "boundary_conditions": [
        {"type": "cuboid", "point": [1, 1, 0.4], "size": [0.6, 0.6, 0.12], "velocity": [0, 0, 0], "start_time": 0, "end_time": 1e3, "reset": 1},
        {"type": "particle_impulse", "force": [0.18, 0, 0], "num_dt": 1, "start_time": 0, "point": [1, 1, 1.3], "size": [0.6, 0.6, 0.4]},
    ],
}  # fmt: skip


def main(*overrides: str) -> Made:
    given = list(overrides)
    if not any(o.startswith("scene.file=") for o in given):
        file = Path("outputs/examples/sway.json")
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps(SWAY))
        given.append(f"scene.file={file}")
    print(table(read(next(o for o in given if o.startswith("scene.file=")).partition("=")[2])))
    made = diffuphy.film("a jelly cube falling", "scene=physgaussian", "material=physgaussian", *given)
    print(made.files["film"])
    return made


if __name__ == "__main__":
    main(*sys.argv[1:])
