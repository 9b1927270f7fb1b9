"""PhysGaussian scene files: read, checked, and played with our walls, drives and materials.

read        file → ``SceneFile``, every key checked, defaults filled in
scene       file → the component that plays it (``mpm.stated.Stated``)
camera      file → what holds the camera of its film (``render.film.rigs``)
material    file → the component that says what it is made of (``material.stated.StatedMaterial``)
sample      file → the component that makes its particles, filled as it says (``mpm.Sample``)
gaussians   file → the component that reads a trained scene as it prepares it (``text2gs.load.LoadGaussians``)
table       what every value means here, and what differs on purpose
"""

import logging
from typing import Any

from diffuphy.material.stated import StatedMaterial
from diffuphy.mpm.sampling.sample import Sample
from diffuphy.mpm.scheme import Scheme
from diffuphy.mpm.stated import Stated
from diffuphy.physgaussian.grains import grains
from diffuphy.physgaussian.matter import matter
from diffuphy.physgaussian.preparation import prepared
from diffuphy.physgaussian.scene_file import SceneFile, read
from diffuphy.physgaussian.table import table
from diffuphy.physgaussian.world import world
from diffuphy.text2gs.load import LoadGaussians

__all__ = ["SceneFile", "camera", "gaussians", "material", "played", "read", "sample", "scene", "table"]

log = logging.getLogger(__name__)


def _named(file: str | None) -> SceneFile:
    if not file:
        raise ValueError("scene.file is not set: name a PhysGaussian scene file, scene.file=scene.json")
    return read(file)


def played(file: SceneFile, particles: int | None = None, **settings: Any) -> Stated:
    """The component that plays a scene file.

    Args:
        particles: of the scene for which the file was written; see ``world``.
        settings: of ``Stated``, in the place of those that the file implies; None keeps the file's.
    """
    there = world(file, particles)
    told: dict[str, Any] = {
        "seconds": file["frame_num"] * file["frame_dt"],
        "fps": 1.0 / file["frame_dt"],
        "size": file["scale"],
        "height": there.frame.height,
        "gravity": there.frame.vector(file["g"]),
        "boundaries": there.boundaries,
        "drives": there.drives,
        "pushes": there.pushes,
        "scheme": Scheme(contact="elastic"),
    }
    return Stated(**told | {name: value for name, value in settings.items() if value is not None})


def scene(
    file: str | None = None,
    particles: int | None = None,
    seconds: float | None = None,
    fps: float | None = None,
    **settings: Any,
) -> Stated:
    """Component of the trajectory stage: plays the scene file at a path, and logs what it means.

    The results do not depend on the path but on what the file says.

    Args:
        file: path of the scene file.
        particles: of the scene for which it was written; None: as many as there are.
        seconds, fps: length [s] and rate [1/s] of the film in the place of the file's.
        settings: others of ``Stated``.

    Raises:
        ValueError: see ``read``, and for what has no meaning here.
    """
    if particles is not None and particles < 1:
        raise ValueError(f"scene.particles must be at least 1, got {particles}; null takes as many as there are")
    written = _named(file)
    log.info("%s", table(written, particles))
    return played(written, particles, seconds=seconds, fps=fps, **settings)


def camera(file: str | None = None, scene: Any = None, fov: float = 32.0) -> Any:
    """What holds the camera of the film: that of the scene file at a path; see ``physgaussian.views.filmed``.

    Args:
        scene: who reads the Gaussians of the scene; None where they are not given.
        fov: angle across the shorter side, where no camera of the scene says it [deg].

    Raises:
        ValueError: see ``read``, and for a camera that the file does not describe.
    """
    from diffuphy.physgaussian.views import filmed

    return filmed(_named(file), scene, fov)


def material(file: str | None = None, **fitting: Any) -> StatedMaterial:
    """Component of the material stage: what the scene file at a path says that the object is made of.

    Args:
        fitting: settings of a fit, which presets of whole runs change; they are logged, and change nothing.

    Raises:
        ValueError: see ``read``.
    """
    if fitting:
        log.info("material: %s not used: the scene file gives the material, nothing is fitted", ", ".join(fitting))
    return matter(_named(file))


def sample(file: str | None = None, **settings: Any) -> Sample:
    """Component of the particle stage: fills the object as the scene file at a path says.

    Args:
        settings: of ``Sample``, in the place of those that the file implies.

    Raises:
        ValueError: see ``read``, and for a file that fills nothing.
    """
    return grains(_named(file), **settings)


def gaussians(path: str, file: str | None = None, **settings: Any) -> LoadGaussians:
    """Component of the Gaussians' stage: a trained scene, prepared as the scene file at a path says.

    Args:
        path: of the Gaussians: a file, or the folder of a trained scene.
        file: path of the scene file.
        settings: of ``LoadGaussians``, in the place of those that the file implies; None keeps the file's.

    Raises:
        ValueError: see ``read`` and ``LoadGaussians``.
    """
    return prepared(path, _named(file), **{name: value for name, value in settings.items() if value is not None})
