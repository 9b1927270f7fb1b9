"""From a sentence to a physically true 3D film.

    prompt → Gaussians → particles → material field → trajectory → film

``diffuphy.film("a rubber burger falling")`` is ``python train.py prompt="a rubber burger falling"`` from Python.
Start reading at :mod:`diffuphy.types`, then :mod:`diffuphy.pipeline`. Importing the package loads nothing heavy.
"""

__version__ = "0.1.0"


def __getattr__(name: str) -> object:
    if name == "film":  # brings Hydra
        from diffuphy.making import film

        return film
    raise AttributeError(f"module 'diffuphy' has no attribute {name!r}")
