"""The camera of a scene file as a rig of ours."""

import logging
import math
from typing import Any

import numpy as np

from diffuphy.physgaussian.frame import Frame
from diffuphy.physgaussian.scene_file import SceneFile
from diffuphy.physgaussian.world import world
from diffuphy.render.film.captured import Captured
from diffuphy.render.film.rigs import Increments, Resting, Rig

log = logging.getLogger(__name__)

ACROSS = ((1.0, 1.0, 1.0), (0.72, 0.37, -0.67))
"""Directions from which azimuths are counted there, made horizontal; the second where the first is vertical already."""


def horizon(file: SceneFile, frame: Frame) -> float:
    """Azimuth of their azimuth 0, from +x towards +y [deg].

    There azimuths are counted from (1, 1, 1), made horizontal in the axes of the Gaussians' file, before
    ``rotation_degree`` turns them.
    """
    turn = np.eye(3)
    for degrees, axis in zip(file["rotation_degree"], file["rotation_axis"], strict=True):
        a, (i, j) = math.radians(degrees), ((1, 2), (2, 0), (0, 1))[int(axis)]
        one = np.eye(3)
        one[i, i] = one[j, j] = math.cos(a)
        one[j, i] = math.sin(a)
        one[i, j] = -one[j, i]
        turn = one @ turn
    turn = frame.turn @ turn  # from the file's axes to ours
    up = turn.T @ [0.0, 0.0, 1.0]
    first, second = (np.asarray(v) for v in ACROSS)
    across = second if abs(float(first @ up)) < 0.01 else first
    x, y, _ = turn @ (across - (across @ up) * up)
    return math.degrees(math.atan2(y, x))


def rig(file: SceneFile, unit: float, fov: float) -> Increments:
    """Their camera that goes round ``mpm_space_viewpoint_center``. Azimuths run the other way round there: their second
    horizontal axis is first × up.

    Args:
        unit: metres a length of the Gaussians' file, in which radii are.
        fov: angle across the shorter side [deg].

    Raises:
        ValueError: the file does not say where the camera is.
    """
    if missing := [k for k in ("init_azimuthm", "init_elevation", "init_radius") if file[k] is None]:
        raise ValueError(f"default_camera_index is -1, and {', '.join(missing)} must be given for its camera")
    frame = world(file).frame
    moves = bool(file["move_camera"])
    step = [float(file[k] or 0.0) if moves else 0.0 for k in ("delta_a", "delta_e", "delta_r")]
    return Increments(
        azimuth=horizon(file, frame) - file["init_azimuthm"],
        elevation=file["init_elevation"],
        radius=file["init_radius"] * unit,
        step=(-step[0], step[1], step[2] * unit),
        center=frame.point(file["mpm_space_viewpoint_center"]),
        fov=fov,
    )


def filmed(file: SceneFile, scene: Any = None, fov: float = 32.0) -> Rig:
    """What holds the camera of a scene file.

    Args:
        scene: who has read the Gaussians that it was written for (``text2gs.load.LoadGaussians``); its cameras.json has
            their camera ``default_camera_index``. None: a camera at rest in their
            direction, or that of the film, which sees the whole motion.
        fov: without ``scene`` [deg].
    """
    index = int(file["default_camera_index"])
    if index < 0 and scene is not None:
        return rig(file, file["scale"] / scene.longest(), fov)
    if index < 0:
        log.info("camera: init_radius is in lengths of Gaussians that are not given; the whole motion is framed")
        made = rig(file, 1.0, fov)
        return Resting(azimuth=made.azimuth, elevation=made.elevation, fov=fov)
    if scene is None:
        log.info("camera: default_camera_index = %d is one of cameras.json, of a scene that is not given", index)
        return Resting()
    return Captured(scene, scene.path, (index,))
