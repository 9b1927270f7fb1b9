"""A trained scene in the layout of 3D Gaussian splatting, dropped as clay.

python examples/own_scene.py gaussians.path=scene.ply
python examples/own_scene.py experiment=tiny           # writes a scene of its own first: the duck of the library
"""

import sys
from pathlib import Path

import diffuphy
from diffuphy.making import Made
from diffuphy.render.ply import write


def main(*overrides: str) -> Made:
    given = list(overrides)
    if not any(o.startswith("gaussians.path=") for o in given):
        scene = Path("outputs/examples/duck.ply")
        scene.parent.mkdir(parents=True, exist_ok=True)
        duck = diffuphy.film("a rubber duck falling", "until=gaussians", *given)
        write(scene, duck.result("gaussians"))
        given.append(f"gaussians.path={scene}")
    made = diffuphy.film("a 30 cm clay duck falling", "gaussians=ply", *given)
    print(made.files["film"])
    return made


if __name__ == "__main__":
    main(*sys.argv[1:])
