"""The files of a run, one small writer a format; ``python -m diffuphy.export RUN FORMAT ...``."""

from collections.abc import Callable, Sequence
from pathlib import Path

from diffuphy.formats import arrays, film, page, splats, surface
from diffuphy.formats.options import Options
from diffuphy.formats.run import Run

FORMATS: dict[str, Callable[[Run, Options], list[Path]]] = {
    "mp4": film.mp4,
    "webm": film.webm,
    "gif": film.gif,
    "png": film.png,
    "ply": splats.ply,
    "npz": arrays.npz,
    "html": page.html,
    "sog": splats.compressed("sog"),
    "spz": splats.compressed("spz"),
    "compressed.ply": splats.compressed("compressed.ply"),
    "glb": surface.meshes("glb"),
    "obj": surface.meshes("obj"),
    "mesh.ply": surface.meshes("mesh.ply"),
}
"""Writers by format; what each writes is the first line of its docstring."""


def check(names: Sequence[str]) -> tuple[str, ...]:
    """The formats asked for.

    Raises:
        ValueError: one that there is not.
    """
    for name in names:
        if name not in FORMATS:
            raise ValueError(f"outputs are {', '.join(FORMATS)}; got {name!r}")
    return tuple(dict.fromkeys(names))


def write(run: Run, names: Sequence[str], options: Options) -> dict[str, list[Path]]:
    """Write a run in several formats; returns the files or folders of each.

    Raises:
        ValueError: an unknown format, a program or package that is missing, or a result that the run has not.
    """
    options.folder.mkdir(parents=True, exist_ok=True)
    return {name: FORMATS[name](run, options) for name in check(names)}
