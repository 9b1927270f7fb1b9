"""One object, two materials: the bun bounces, the patty keeps its dent. The films show stiffness and stress as well.

python examples/two_materials.py
python examples/two_materials.py experiment=tiny
"""

import sys

import diffuphy
from diffuphy.making import Made


def main(*overrides: str) -> Made:
    made = diffuphy.film("a jelly burger with a clay patty falling", "film.also=[E,stress]", *overrides)
    field = made.result("material")
    for law, weight in zip(field.plastic, field.w_p.T, strict=True):
        print(f"{law}: {weight.mean():.0%} of the particles")
    print(*(f"{kind}: {path}" for kind, path in made.files.items()), sep="\n")
    return made


if __name__ == "__main__":
    main(*sys.argv[1:])
