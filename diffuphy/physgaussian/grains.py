"""The particles of a scene file: what ``particle_filling`` means here."""

from typing import Any

from diffuphy.mpm.sampling.filling import DIRECTIONS, Direction, Rays
from diffuphy.mpm.sampling.sample import Sample
from diffuphy.physgaussian.frame import Frame
from diffuphy.physgaussian.scene_file import SceneFile

CELLS_OF_CELL = 4
"""Cells of their filling lattice along one of the grid, where the file does not say."""


def direction(number: int, frame: Frame) -> Direction | None:
    """Their ray 0 … 5, +x −x +y −y +z −z of the box, in the frame of a film; other numbers are none."""
    if not 0 <= number < len(DIRECTIONS):
        return None
    axis = [0.0, 0.0, 0.0]
    axis[number // 2] = -1.0 if number % 2 else 1.0
    turned = frame.vector((axis[0], axis[1], axis[2]))
    k = next(k for k in range(3) if turned[k])
    return DIRECTIONS[2 * k + (turned[k] < 0)]


def rays(file: SceneFile) -> Rays:
    """Their filling of the file's object.

    Raises:
        ValueError: a file without ``particle_filling``.
    """
    f = file.filling
    if f is None:
        raise ValueError("the scene file has no particle_filling; use sample=flood or sample=none")
    frame, side = Frame(file["mpm_space_vertical_upward_axis"]), file["grid_lim"]
    b = f["boundary"] or (0.0, side, 0.0, side, 0.0, side)
    low, high = frame.corners(
        ((b[0] + b[1]) / 2, (b[2] + b[3]) / 2, (b[4] + b[5]) / 2),
        ((b[1] - b[0]) / 2, (b[3] - b[2]) / 2, (b[5] - b[4]) / 2),
    )
    excluded = f["search_exclude_direction"]
    excluded = excluded if isinstance(excluded, tuple) else (excluded,)
    return Rays(
        threshold=f["search_threshold"],
        exclude=tuple(d for n in excluded if (d := direction(n, frame)) is not None),
        parity=direction(f["ray_cast_direction"], frame),
        n_grid=f["n_grid"] or CELLS_OF_CELL * file["n_grid"],
        box=(low[0], high[0], low[1], high[1], low[2], high[2]),
    )


def grains(file: SceneFile, **settings: Any) -> Sample:
    """Particles as the file says: its opacity threshold, its filling.

    Args:
        settings: of ``Sample``, in the place of those that the file implies.
    """
    told: dict[str, Any] = {"opacity": file["opacity_threshold"], "filling": rays(file)}
    if (threshold := file.filling["density_threshold"]) > 0.0:  # type: ignore[index]
        told["threshold"] = threshold
    return Sample(**told | settings)


def meaning(file: SceneFile) -> str:
    """One sentence for the table."""
    r = rays(file)
    box = ", ".join(f"{v:.4g}" for v in r.box or ())
    return (
        f"sample=physgaussian: density {r.threshold:g} stops rays, {', '.join(r.exclude) or 'none'} excluded, parity "
        f"along {r.parity or 'none'}, {r.n_grid} cells over [{box}] m; shell from density "
        f"{file.filling['density_threshold']:g}. "  # type: ignore[index]
        "One particle a cell of their own lattice, at most sample.max_particles, the field as it is, not smoothed. The "
        "default, sample=flood, needs none of them"
    )
