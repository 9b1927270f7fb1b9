"""What may stand in a scene file: every key with its kind, range and default, and how a value is read."""

import math
import reprlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

Reader = Callable[[Any], Any]
"""A value of the file → the value; raises ValueError with what it must be."""

REQUIRED: Any = object()
"""The default of a key that must be given."""


@dataclass(frozen=True)
class Key:
    """One key of an object of the file."""

    read: Reader
    """How its value is read."""
    default: Any = REQUIRED
    """Its value where the file does not have it."""


def shown(value: Any) -> str:
    """A value of a file in an error message: one line, and short."""
    return reprlib.repr(value).replace("\n", " ")


def _is_number(value: Any) -> bool:
    try:
        return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:  # a whole number beyond all floats
        return False


def number(low: float, high: float) -> Reader:
    """A number in [low, high]."""

    def read(value: Any) -> float:
        if not _is_number(value) or not low <= value <= high:
            raise ValueError(f"must be a number in [{low:g}, {high:g}], got {shown(value)}")
        return float(value)

    return read


def whole(low: int, high: int) -> Reader:
    """A whole number in [low, high], written with or without a decimal point."""

    def read(value: Any) -> int:
        if not _is_number(value) or value != int(value) or not low <= value <= high:
            raise ValueError(f"must be a whole number in [{low}, {high}], got {shown(value)}")
        return int(value)

    return read


def flag(value: Any) -> bool:
    """0 or 1, false or true."""
    if not isinstance(value, bool | int) or value not in (0, 1):
        raise ValueError(f"must be 0, 1, false or true, got {shown(value)}")
    return bool(value)


def one_of(*words: str) -> Reader:
    """One of some words."""

    def read(value: Any) -> str:
        if not isinstance(value, str) or value not in words:
            raise ValueError(f"must be one of {', '.join(words)}, got {shown(value)}")
        return value

    return read


def several(each: Reader, count: int | None = None, most: int = 1000) -> Reader:
    """A list of values of one kind: ``count`` of them, or at most ``most``."""

    def read(value: Any) -> tuple[Any, ...]:
        if not isinstance(value, list) or (len(value) != count if count is not None else len(value) > most):
            want = f"a list of {count} values" if count is not None else f"a list of at most {most} values"
            raise ValueError(f"must be {want}, got {shown(value)}")
        return tuple(each(v) for v in value)

    return read


def either(*readers: Reader) -> Reader:
    """What the first of some readers takes."""

    def read(value: Any) -> Any:
        said = []
        for reader in readers:
            try:
                return reader(value)
            except ValueError as no:
                said.append(str(no).partition(", got ")[0].removeprefix("must be "))
        raise ValueError(f"must be {' or '.join(said)}, got {shown(value)}")

    return read


def optional(reader: Reader) -> Reader:
    """The same or null."""
    return lambda value: None if value is None else reader(value)


LEAST, MOST = 1e-12, 1e15
"""Between them lies every positive quantity of a scene in SI units; what is computed from such numbers is finite."""

NUMBER, POSITIVE, NOT_NEGATIVE = number(-MOST, MOST), number(LEAST, MOST), number(0.0, MOST)
VECTOR, SIZES, TIME = several(NUMBER, 3), several(POSITIVE, 3), NOT_NEGATIVE
AXIS = whole(0, 2)


def direction(value: Any) -> tuple[float, float, float]:
    """Three numbers that are not all 0."""
    v = VECTOR(value)
    if not math.hypot(*v) > 0.0:
        raise ValueError(f"must not be zero, got {shown(value)}")
    return v


def box(value: Any) -> tuple[float, ...]:
    """[xmin, xmax, ymin, ymax, zmin, zmax] with an inside."""
    b = several(NUMBER, 6)(value)
    if not all(b[i] < b[i + 1] for i in (0, 2, 4)):
        raise ValueError(f"must be [xmin, xmax, ymin, ymax, zmin, zmax] with min < max, got {shown(value)}")
    return b


MATERIALS = ("jelly", "metal", "sand", "foam", "snow", "plasticine")

FILLING: Mapping[str, Key] = {
    "n_grid": Key(whole(1, 10_000), None),
    "density_threshold": Key(NOT_NEGATIVE, 5.0),
    "search_threshold": Key(NOT_NEGATIVE, 3.0),
    "max_particles_num": Key(whole(1, 10**9), 2_000_000),
    "max_partciels_per_cell": Key(whole(1, 1000), 1),
    "search_exclude_direction": Key(either(whole(-1, 6), several(whole(-1, 6), most=6)), 5),
    "ray_cast_direction": Key(whole(-1, 6), 4),
    "boundary": Key(optional(box), None),
    "smooth": Key(flag, False),
    "visualize": Key(flag, False),
}

REGION: Mapping[str, Key] = {
    "point": Key(VECTOR),
    "size": Key(SIZES),
    "E": Key(POSITIVE),
    "nu": Key(number(0.0, 0.4999)),
    "density": Key(optional(POSITIVE), None),
}
"""One of ``additional_material_params``; without a density that of the file."""

_SPAN = {"start_time": Key(TIME), "end_time": Key(TIME)}
_OPEN_SPAN = {"start_time": Key(TIME, 0.0), "end_time": Key(TIME, 1e3)}
_FORCE = {"force": Key(VECTOR), "num_dt": Key(whole(1, 10**9), 1), "start_time": Key(TIME, 0.0)}

CONDITIONS: Mapping[str, Mapping[str, Key]] = {
    "bounding_box": {},
    "cuboid": {
        "point": Key(VECTOR), "size": Key(SIZES), "velocity": Key(VECTOR), **_OPEN_SPAN, "reset": Key(flag, False),
    },
    "surface_collider": {
        "point": Key(VECTOR), "normal": Key(direction), "friction": Key(NOT_NEGATIVE), **_SPAN,
        "surface": Key(one_of("sticky", "slip", "separate", "collide", "cut")),
    },
    "particle_impulse": {
        **_FORCE, "point": Key(VECTOR, (1.0, 1.0, 1.0)), "size": Key(SIZES, (1.0, 1.0, 1.0)),
    },
    "enforce_particle_translation": {
        "point": Key(VECTOR), "size": Key(SIZES), "velocity": Key(VECTOR), **_SPAN,
    },
    "enforce_particle_velocity_rotation": {
        "point": Key(VECTOR), "normal": Key(direction), "half_height_and_radius": Key(several(POSITIVE, 2)),
        "rotation_scale": Key(NUMBER), "translation_scale": Key(NUMBER), **_SPAN,
    },
    "release_particles_sequentially": {
        "normal": Key(direction), "start_position": Key(NUMBER), "end_position": Key(NUMBER),
        "num_layers": Key(whole(1, 10**6)), **_SPAN,
    },
    "object_impulse": dict(_FORCE),
    "object_tear": {**_FORCE, "force": Key(either(VECTOR, NUMBER)), "axis": Key(AXIS, 0)},
    "enforce_scene_translation": {"velocity": Key(VECTOR), **_SPAN},
    "sdf_collider": {"bound": Key(POSITIVE), "dim": Key(AXIS), **_SPAN},
}  # fmt: skip
"""Kinds of boundary conditions: seven of PhysGaussian, three of DecoupledGaussian, one of OmniPhysGS, whose other one
is the surface "collide"."""

KEYS: Mapping[str, Key] = {
    "material": Key(one_of(*MATERIALS), "jelly"),
    "E": Key(POSITIVE, 1e5),
    "nu": Key(number(0.0, 0.4999), 0.4),
    "density": Key(POSITIVE, 200.0),
    "g": Key(VECTOR, (0.0, 0.0, -9.8)),
    "yield_stress": Key(NOT_NEGATIVE, 0.0),
    "hardening": Key(flag, False),
    "xi": Key(NOT_NEGATIVE, 0.0),
    "softening": Key(NOT_NEGATIVE, 0.1),
    "friction_angle": Key(number(0.0, 89.0), 25.0),
    "plastic_viscosity": Key(NOT_NEGATIVE, 0.0),
    "rpic_damping": Key(number(-MOST, 1.0), 0.0),
    "pic_damping": Key(NUMBER, 0.0),
    "grid_v_damping_scale": Key(POSITIVE, 1.1),
    "grid_lim": Key(POSITIVE, 2.0),
    "n_grid": Key(whole(8, 10_000), 50),
    "substep_dt": Key(POSITIVE, 1e-4),
    "frame_dt": Key(POSITIVE, 1e-2),
    "frame_num": Key(whole(1, 10**6), 100),
    "additional_material_params": Key(several(lambda v: v), ()),
    "boundary_conditions": Key(several(lambda v: v), ()),
    "opacity_threshold": Key(number(0.0, 1.0), 0.02),
    "rotation_degree": Key(several(NUMBER, most=100), ()),
    "rotation_axis": Key(several(AXIS, most=100), ()),
    "sim_area": Key(optional(box), None),
    "scale": Key(POSITIVE, 1.0),
    "particle_filling": Key(optional(lambda v: v), None),
    "mpm_space_viewpoint_center": Key(VECTOR, (1.0, 1.0, 1.0)),
    "mpm_space_vertical_upward_axis": Key(direction, (0.0, 0.0, 1.0)),
    "default_camera_index": Key(whole(-1, 10**9), 0),
    "show_hint": Key(flag, False),
    "init_azimuthm": Key(optional(NUMBER), None),
    "init_elevation": Key(optional(NUMBER), None),
    "init_radius": Key(optional(POSITIVE), None),
    "move_camera": Key(flag, False),
    "delta_a": Key(optional(NUMBER), None),
    "delta_e": Key(optional(NUMBER), None),
    "delta_r": Key(optional(NUMBER), None),
    "z_offset": Key(NUMBER, 0.0),
}
"""Keys of the file itself; the last one is DecoupledGaussian's."""
