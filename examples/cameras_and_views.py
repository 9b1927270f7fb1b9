"""The same motion seen in other ways: a camera that walks round, and stress, stiffness, volume and speed in colours.

    python examples/cameras_and_views.py
    python examples/cameras_and_views.py experiment=tiny

Half as fast as physics. Writes outputs/examples/runs/a-jelly-cube-bouncing-…/: film.mp4 and a film of each view.
18 seconds of one core, with experiment=tiny.
"""

import sys

import diffuphy
from diffuphy.making import Made


def main(*settings: str) -> Made:
    made = diffuphy.film(
        "a jelly cube bouncing",
        "store=outputs/examples",
        "camera=turntable",
        "film.slow=2",
        "film.also=[stress,J,velocity,depth,normals]",
        *settings,
    )
    print(*(f"{kind}: {path}" for kind, path in made.files.items()), sep="\n")
    return made


if __name__ == "__main__":
    main(*sys.argv[1:])
