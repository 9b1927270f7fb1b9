"""What every value of a scene file means here, as a table to print."""

import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from diffuphy.mpm.scene import STABLE
from diffuphy.physgaussian.grains import meaning as filling
from diffuphy.physgaussian.matter import STRENGTHS, SUBSTANCES, matter
from diffuphy.physgaussian.scene_file import SceneFile
from diffuphy.physgaussian.views import rig
from diffuphy.physgaussian.world import world

WIDTH = 118
"""Characters of a line."""

PREPARED = {
    "opacity_threshold": "sample.opacity={}: below it a Gaussian is not matter",
    "rotation_degree": "turn the Gaussians before: particles stand in the turned box, the vertical along z",
    "rotation_axis": "with rotation_degree",
    "sim_area": "cut the Gaussians before: what is outside takes no part",
}
"""Keys about the Gaussians before they are simulated."""

VIEWED = (
    "mpm_space_viewpoint_center", "default_camera_index", "show_hint", "init_azimuthm", "init_elevation",
    "init_radius", "move_camera", "delta_a", "delta_e", "delta_r",
)  # fmt: skip
"""Keys about the camera."""


@dataclass(frozen=True)
class Row:
    """One value of a scene file."""

    key: str
    """Where it stands."""
    there: str
    """What it says there."""
    here: str
    """What it means here."""


def rows(file: SceneFile, particles: int | None = None) -> list[Row]:
    """Every value that the file gives, and the defaults that the motion depends on."""
    return [*_matter(file), *_motion(file), *_conditions(file, particles), *_rest(file, particles)]


def _row(file: SceneFile, key: str, here: str, unit: str = "") -> Row:
    default = "" if key in file.given else " (default)"
    return Row(key, f"{_text(file[key])}{unit and ' ' + unit}{default}", here)


def _text(value: Any) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(map(_text, value))}]"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _matter(file: SceneFile) -> Iterator[Row]:
    substance = SUBSTANCES[file["material"]](file)
    yield _row(file, "material", f"{substance.elastic} + {substance.plastic}: {substance.remark}")
    yield _row(file, "E", "Young's modulus, the same", "Pa")
    yield _row(file, "nu", "Poisson's ratio, the same")
    yield _row(file, "density", "the same; masses are density × volume, whatever the number of particles", "kg/m³")
    for key in STRENGTHS:
        if key in substance.uses:
            theta = ", ".join(f"{k} = {v:.4g}" for k, v in substance.theta.items())
            empty = "; with none it flows at once" if key == "yield_stress" and not file[key] else ""
            yield _row(file, key, f"see material: {theta}{empty}")
        elif key in file.given:
            yield _row(file, key, f"not used: {file['material']} does not read it")
    for k, (region, piece) in enumerate(zip(file.regions, matter(file).pieces[1:], strict=True)):
        there = ", ".join(f"{name} {_text(region[name])}" for name in ("E", "nu", "density"))
        yield Row(f"additional_material_params[{k}]", there, f"material.pieces[{k + 1}]: {piece.low} to {piece.high} m")


def _motion(file: SceneFile) -> Iterator[Row]:
    dt, dx = file["substep_dt"], file.dx
    yield _row(file, "scale", "the longest side of the object, in metres: refine.default_size", "m")
    yield _row(file, "g", "gravity" + ("" if "g" in file.given else "; there a file without it stops"), "m/s²")
    yield _row(file, "grid_lim", f"their Δx = grid_lim/n_grid = {dx:.4g} m; the grid here has no sides", "m")
    yield _row(file, "n_grid", "not used: Δx follows from the particles, eight in a cell")
    safe = f"more than the {STABLE} up to which explicit steps are stable" if file.cfl > STABLE else "stable"
    yield _row(
        file, "substep_dt",
        f"not used: Δt follows from the material. Their waves of {file.wave:.4g} m/s cross {file.cfl:.3g} cells in a "
        f"substep, {safe}", "s",
    )  # fmt: skip
    lost = file["frame_dt"] - file.substeps * dt
    cut = f"; there {file.substeps} substeps make {file.substeps * dt:.6g} s" if abs(lost) > 1e-3 * dt else ""
    yield _row(file, "frame_dt", f"scene.fps = {1.0 / file['frame_dt']:.6g}{cut}", "s")
    yield _row(file, "frame_num", f"scene.seconds = {file['frame_num'] * file['frame_dt']:.6g}")
    scale = file["grid_v_damping_scale"]
    drag = world(file).damping
    here = f"τ = −substep_dt/ln scale = {drag.time:.4g} s, for any Δt" if drag else "nothing: only less than 1 damps"
    if drag or "grid_v_damping_scale" in file.given:
        yield Row("grid_v_damping_scale", f"{scale:g} a substep", here)
    if "rpic_damping" in file.given:
        yield _row(file, "rpic_damping", "not used: the transfer here conserves both momenta and loses less than APIC")
    if "pic_damping" in file.given:
        yield _row(file, "pic_damping", "not used; nor there")


def _conditions(file: SceneFile, particles: int | None) -> Iterator[Row]:
    for played in world(file, particles).meanings:
        c = played.condition
        kinds = ", ".join(type(thing).__name__ for thing in played.made) or "nothing"
        there = ", ".join(f"{k} {_text(v)}" for k, v in c.values.items())
        yield Row(f"{c.place} {c.kind}", there, f"{kinds}: {played.remark}")


def _rest(file: SceneFile, particles: int | None) -> Iterator[Row]:
    height = world(file, particles).frame.height
    yield Row("[1, 1, 1]", "the middle of the object", f"scene.height = {height:.4g} m above the floor that is drawn")
    up = "mpm_space_vertical_upward_axis"
    if up in file.given:
        yield _row(file, up, "turned to z, with all walls and drives")
    for key, here in PREPARED.items():
        if key in file.given:
            idle = key.startswith("rotation") and not any(file["rotation_degree"])
            yield _row(file, key, "nothing is turned" if idle else here.format(_text(file[key])))
    if file.filling is not None:
        yield Row("particle_filling", f"{len(file.filling)} settings", filling(file))
    if viewed := [key for key in VIEWED if key in file.given]:
        there = ", ".join(_text(file[key]) for key in viewed)
        yield Row(", ".join(viewed), there, _camera(file))
    if "z_offset" in file.given:
        yield _row(file, "z_offset", "not used: it places surroundings, which are no particles here")
    for key in file.unknown:
        yield Row(key, "", "unknown: no program of this family reads it")


def _camera(file: SceneFile) -> str:
    if file["default_camera_index"] >= 0:
        index = int(file["default_camera_index"])
        return f"camera=physgaussian: view {index} of the scene's cameras.json; without your Gaussians camera=resting"
    if file["init_azimuthm"] is None or file["init_elevation"] is None or file["init_radius"] is None:
        return "not used: azimuth, elevation and radius must all be given"
    made = rig(file, 1.0, 32.0)
    return (
        f"camera=physgaussian: azimuth {made.azimuth:.4g} degrees, the other way round; {made.step[0]:.4g}, "
        f"{made.step[1]:.4g} degrees and {made.step[2]:.4g} a frame; radii in lengths of the Gaussians' file; without "
        "them at rest in its first direction"
    )


def table(file: SceneFile, particles: int | None = None) -> str:
    """The table as text: key, value there, meaning here; long cells go on in the next line."""
    found = [Row("scene file", "there", "here"), *rows(file, particles)]
    widths = [min(most, max(len(getattr(r, name)) for r in found)) for name, most in (("key", 38), ("there", 30))]
    widths.append(WIDTH - sum(widths) - 4)
    lines = []
    for row in found:
        cells = [
            textwrap.wrap(text, width, break_long_words=True) or [""]
            for text, width in zip((row.key, row.there, row.here), widths, strict=True)
        ]
        for k in range(max(map(len, cells))):
            parts = [(cell[k] if k < len(cell) else "").ljust(w) for cell, w in zip(cells, widths, strict=True)]
            lines.append("  ".join(parts).rstrip())
    return "\n".join(lines)
