"""One object, two materials: the buns are jelly, the patty is clay. Which particle is what is found by the material
stage from the words, and shown: films of the laws, of stiffness and of stress.

    python examples/two_materials.py
    python examples/two_materials.py experiment=tiny

Writes outputs/examples/runs/a-jelly-burger-with-a-clay-patty-falling-…/. 29 seconds of one core, with experiment=tiny.
"""

import sys

import diffuphy
from diffuphy.making import Made


def main(*settings: str) -> Made:
    common = ("store=outputs/examples", "film.also=[material,E,stress]", *settings)
    made = diffuphy.film("a jelly burger with a clay patty falling", *common)
    field = made.result("material")
    for law, weight in zip(field.plastic, field.w_p.T, strict=True):
        print(f"{law}: {weight.mean():.0%} of the particles")
    print(*(f"{kind}: {path}" for kind, path in made.files.items()), sep="\n")
    return made


if __name__ == "__main__":
    main(*sys.argv[1:])
