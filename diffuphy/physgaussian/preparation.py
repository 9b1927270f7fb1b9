"""How a scene file prepares its Gaussians: turned, cut out, and the haze taken away, then set upright."""

import math
from typing import Any

from diffuphy.physgaussian.frame import Frame
from diffuphy.physgaussian.scene_file import SceneFile
from diffuphy.render.scenes.placement import Axis
from diffuphy.text2gs.load import LoadGaussians

AXES: tuple[Axis, Axis, Axis] = ("x", "y", "z")
"""The numbers of ``rotation_axis``."""

UPRIGHT: dict[tuple[int, int], tuple[Axis, float]] = {
    (0, 1): ("y", -90.0),
    (0, -1): ("y", 90.0),
    (1, 1): ("x", 90.0),
    (1, -1): ("x", -90.0),
    (2, -1): ("x", 180.0),
}
"""The turn [deg] that takes an axis, by number and sign, to z: Q of ``Frame``."""


def prepared(path: str, file: SceneFile, **settings: Any) -> LoadGaussians:
    """The component that reads a trained scene as a scene file prepares it.

    The axes of the Gaussians' file are turned about ``rotation_axis`` by ``rotation_degree``, first things first; those
    in ``sim_area`` are the object; more transparent ones than ``opacity_threshold`` go. Then the vertical of the file,
    ``mpm_space_vertical_upward_axis``, is turned to z.

    Args:
        path: of the Gaussians, see ``LoadGaussians``.
        settings: others of ``LoadGaussians``, in the place of what the file says.
    """
    up = file["mpm_space_vertical_upward_axis"]
    frame = Frame(up)
    turns = [(AXES[axis], angle) for axis, angle in zip(file["rotation_axis"], file["rotation_degree"], strict=True)]
    along = next(k for k in range(3) if up[k])
    if upright := UPRIGHT.get((along, int(math.copysign(1, up[along])))):
        turns.append(upright)
    told: dict[str, Any] = {"up": "z_up", "turns": tuple(turns), "min_opacity": min(file["opacity_threshold"], 0.999)}
    if (area := file["sim_area"]) is not None:
        ends = [frame.vector(area[k::2]) for k in (0, 1)]
        told["region"] = tuple(f(a, b) for a, b in zip(*ends, strict=True) for f in (min, max))
    return LoadGaussians(path, **told | settings)
