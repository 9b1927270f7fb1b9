"""The same motion seen in other ways: a camera that walks round, and stress, stiffness, volume and speed in colours.

python examples/cameras_and_views.py
python examples/cameras_and_views.py experiment=tiny
"""

import sys

import diffuphy
from diffuphy.making import Made


def main(*overrides: str) -> Made:
    made = diffuphy.film(
        "a jelly cube bouncing",
        "camera=turntable",
        "film.slow=2",
        "film.also=[stress,J,velocity,depth,normals]",
        *overrides,
    )
    print(*(f"{kind}: {path}" for kind, path in made.files.items()), sep="\n")
    return made


if __name__ == "__main__":
    main(*sys.argv[1:])
