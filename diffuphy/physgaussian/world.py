"""Walls and drives of a scene file as ours: ``mpm.boundary``, ``mpm.drive``, in the frame of the particles."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from diffuphy.mpm.boundary import Boundary, Box, HalfSpace, container
from diffuphy.mpm.drive import Drag, Drive, Held, InBox, InCylinder, Release
from diffuphy.mpm.stated import Push
from diffuphy.physgaussian.frame import MIDDLE, Frame
from diffuphy.physgaussian.scene_file import Condition, SceneFile

PADDING = 3
"""Cells between a bounding box and the sides of the grid."""

RESET = 15
"""Substeps for which a cuboid stops what it has moved."""

FOREVER = 900.0
"""Times from which on something lasts for good [s]; files write 1e3 there."""

Made = tuple[Boundary | Drive | Push, ...]


@dataclass(frozen=True)
class Meaning:
    """What one boundary condition is here."""

    condition: Condition
    """That of the file."""
    made: Made
    """What stands for it, in the order in which it acts."""
    remark: str = ""
    """What differs on purpose."""


@dataclass(frozen=True)
class World:
    """All that acts on the particles of a scene file."""

    meanings: tuple[Meaning, ...]
    """Of every boundary condition, in the order of the file."""
    damping: Drag | None
    """What ``grid_v_damping_scale`` is; None where it does nothing."""
    frame: Frame
    """The map from the box to the particles."""

    def _of(self, kind: Any) -> tuple[Any, ...]:
        return tuple(thing for m in self.meanings for thing in m.made if isinstance(thing, kind))

    @property
    def boundaries(self) -> tuple[Boundary, ...]:
        return self._of(Boundary)

    @property
    def drives(self) -> tuple[Drive, ...]:
        return (*((self.damping,) if self.damping else ()), *self._of(Drive))

    @property
    def pushes(self) -> tuple[Push, ...]:
        return self._of(Push)


def world(file: SceneFile, particles: int | None = None) -> World:
    """Walls and drives of a scene file.

    Args:
        particles: how many particles the scene had for which the file was written: its forces are per particle. None:
            as many as there are here.

    Raises:
        ValueError: a condition that has no meaning, by its place in the file.
    """
    up = file["mpm_space_vertical_upward_axis"]
    frame = Frame(up, -ground(file, Frame(up)))
    meanings = []
    for c in file.conditions:
        try:
            made, remark = MEANINGS[c.kind](file, frame, c, particles)
        except ValueError as e:
            raise ValueError(f"{c.place}: {e}") from None
        meanings.append(Meaning(c, made, remark))
    return World(tuple(meanings), damping(file["grid_v_damping_scale"], file["substep_dt"]), frame)


def ground(file: SceneFile, frame: Frame) -> float:
    """Where the floor of the film is drawn, above the middle of the object [m]: at the highest plane beneath it, else
    at the bottom of the bounding box if there is gravity, else where the object may reach down to."""
    under = -0.5 * file["scale"]
    planes = [
        frame.point(c["point"])[2]
        for c in file.conditions
        if c.kind == "surface_collider" and _is_floor(frame.vector(c["normal"]))
    ]
    if planes := [z for z in planes if z < 0.0]:
        return max(planes)
    if any(file["g"]) and any(c.kind == "bounding_box" for c in file.conditions):
        low, _high = _inside(file, frame)
        return low[2]
    return under


def _is_floor(normal: tuple[float, float, float]) -> bool:
    return normal[2] > 0.0 and not any(normal[:2])


def _inside(file: SceneFile, frame: Frame) -> tuple[Any, Any]:
    """Corners of the bounding box."""
    half = 0.5 * file["grid_lim"]
    return frame.corners((half,) * 3, (half - PADDING * file.dx,) * 3)


def damping(scale: float, dt: float) -> Drag | None:
    """A factor per substep as a rate: v(t) = v₀ scale^(t/Δt) = v₀ e^(−t/τ),  τ = −Δt/ln scale; only < 1 acts."""
    return Drag(time=-dt / math.log(scale)) if scale < 1.0 else None


def _span(c: Condition) -> dict[str, float]:
    end = c["end_time"]
    return {"start": c["start_time"], "end": end if end < FOREVER else math.inf}


def _in_box(frame: Frame, c: Condition) -> InBox:
    low, high = frame.corners(c["point"], c["size"])
    return InBox(low=low, high=high)


def _bounding_box(file: SceneFile, frame: Frame, c: Condition, particles: int | None) -> tuple[Made, str]:
    low, high = _inside(file, frame)
    return container(low, high), f"six walls {PADDING} cells inside the grid that push and do not rub, as there"


def _cuboid(file: SceneFile, frame: Frame, c: Condition, particles: int | None) -> tuple[Made, str]:
    span = _span(c)
    stops = RESET * file["substep_dt"] if c["reset"] and span["end"] < math.inf else 0.0
    wall = Box(
        center=frame.point(c["point"]), size=frame.edges(c["size"]), kind="sticky",
        velocity=frame.vector(c["velocity"]), reset=stops, **span,
    )  # fmt: skip
    remark = "holds what is in it"
    if c["reset"]:
        remark += "; reset stops the box alone, there it stops the whole grid" + ("" if stops else " (it never ends)")
    return (wall,), remark


def _surface(file: SceneFile, frame: Frame, c: Condition, particles: int | None) -> tuple[Made, str]:
    surface, friction = c["surface"], c["friction"]
    if surface == "cut":
        raise ValueError(
            "surface 'cut' acts between heights of 0.40 and 0.53 m that are written into that program; state a cuboid"
        )
    kind = {"sticky": "sticky", "slip": "slip"}.get(surface, "separate")
    wall = HalfSpace(
        point=frame.point(c["point"]), normal=frame.vector(c["normal"]), kind=kind,
        friction=friction if kind == "separate" else 0.0, **_span(c),
    )  # fmt: skip
    remarks = {
        "sticky": "holds, as there",
        "slip": "slips; there every surface holds",
        "separate": f"lets go, rubs with μ = {friction:g}; there every surface holds",
        "collide": "pushes, and the body rebounds as its material does; there velocities behind it are mirrored",
    }
    unused = f"; friction = {friction:g} not used: this surface has none" if friction and kind != "separate" else ""
    return (wall,), remarks[surface] + unused


def _push(file: SceneFile, c: Condition, force: Any, where: Any, particles: int | None) -> Push:
    lasts = c["num_dt"] * file["substep_dt"]
    each = tuple(float(f) * lasts for f in force)
    return Push(each=each, where=where, start=c["start_time"], duration=lasts, of=particles)  # type: ignore[arg-type]


def _told(particles: int | None) -> str:
    count = f"{particles} particles" if particles else "as many particles as here; scene.particles says how many"
    return f"force per particle × num_dt × substep_dt = an impulse each, for {count}"


def _impulse(file: SceneFile, frame: Frame, c: Condition, particles: int | None) -> tuple[Made, str]:
    push = _push(file, c, frame.vector(c["force"]), _in_box(frame, c), particles)
    return (push,), _told(particles)


def _object_impulse(file: SceneFile, frame: Frame, c: Condition, particles: int | None) -> tuple[Made, str]:
    return (_push(file, c, frame.vector(c["force"]), None, particles),), _told(particles)


def _tear(file: SceneFile, frame: Frame, c: Condition, particles: int | None) -> tuple[Made, str]:
    unit = np.eye(3)[c["axis"]]
    force = c["force"] if isinstance(c["force"], tuple) else tuple(c["force"] * unit)
    pushes = []
    for side in (1.0, -1.0):
        center = np.asarray(MIDDLE) + side * 0.5 * file["scale"] * unit
        half = np.where(unit > 0, 0.5 * file["scale"], file["scale"])
        low, high = frame.corners(tuple(center), tuple(half))
        outwards = frame.vector(tuple(side * np.asarray(force)))
        pushes.append(_push(file, c, outwards, InBox(low=low, high=high), particles))
    return tuple(pushes), "the half beyond the middle along axis is pushed by force, the other by its opposite"


def _translation(file: SceneFile, frame: Frame, c: Condition, particles: int | None) -> tuple[Made, str]:
    held = Held(where=_in_box(frame, c), velocity=frame.vector(c["velocity"]), **_span(c))
    return (held,), "these particles move as one rigid piece; there their velocity alone is set, before each substep"


def _rotation(file: SceneFile, frame: Frame, c: Condition, particles: int | None) -> tuple[Made, str]:
    half, radius = c["half_height_and_radius"]
    axis = np.asarray(frame.vector(c["normal"]))
    axis /= np.linalg.norm(axis)
    where = InCylinder(center=frame.point(c["point"]), axis=tuple(axis), radius=radius, height=2 * half)
    held = Held(
        where=where, center=frame.point(c["point"]), velocity=_times(c["translation_scale"], axis),
        angular_velocity=_times(-c["rotation_scale"], axis), **_span(c),
    )  # fmt: skip
    return (held,), "ω = −rotation_scale · normal: there the two axes and the normal make a left-handed frame"


def _times(scale: float, axis: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (float(scale * a) + 0.0 for a in axis)
    return x, y, z


def _release(file: SceneFile, frame: Frame, c: Condition, particles: int | None) -> tuple[Made, str]:
    """Particles within L = |start − end| of ``end``, at a distance d from it, are held until end_time (1 − d/L): on
    both sides of it."""
    if np.count_nonzero(c["normal"]) != 1:
        raise ValueError(f"normal must lie along an axis of the box, got {c['normal']}")
    axis, first, last = int(np.argmax(np.abs(c["normal"]))), c["start_position"], c["end_position"]
    length = abs(first - last)
    if not length > 0.0:
        raise ValueError(f"start_position and end_position must differ, got {first:g} and {last:g} m twice")
    made = []
    for side in (math.copysign(1.0, first - last), -math.copysign(1.0, first - last)):
        center, half, normal = np.array(MIDDLE), np.ones(3), np.zeros(3)
        center[axis], half[axis], normal[axis] = last + side * length / 2, length / 2, -side
        nearest = side * (MIDDLE[axis] - last) + 0.5 * file["scale"]  # how far the object reaches into this half
        if nearest <= 0.0:
            continue
        low, high = frame.corners(tuple(center), tuple(half))
        plane = center.copy()
        plane[axis] = last + side * length
        made.append(
            Release(
                where=InBox(low=low, high=high), point=frame.point(tuple(plane)), normal=frame.vector(tuple(normal)),
                speed=length / c["end_time"],
            )
        )  # fmt: skip
    late = f"; held from the beginning, there from {c['start_time']:g} s on" if c["start_time"] > 0 else ""
    return tuple(made), f"a plane sets free what it passes; there {c['num_layers']} is read as 50 layers{late}"


def _scene(file: SceneFile, frame: Frame, c: Condition, particles: int | None) -> tuple[Made, str]:
    return (), "not used: the surroundings of the object are no particles here; state a wall that moves"


def _sdf(file: SceneFile, frame: Frame, c: Condition, particles: int | None) -> tuple[Made, str]:
    unit, bound = np.eye(3)[c["dim"]], c["bound"]
    if not bound < 0.5 * file["grid_lim"]:
        raise ValueError(f"bound must be less than half of grid_lim = {file['grid_lim']:g} m, got {bound:g} m")
    walls = []
    for place, side in ((bound, 1.0), (file["grid_lim"] - bound, -1.0)):
        point = np.where(unit > 0, place, MIDDLE)
        walls.append(HalfSpace(point=frame.point(tuple(point)), normal=frame.vector(tuple(side * unit)), **_span(c)))
    return tuple(walls), "two walls that push; there particles are put back and thrown off by sdf/Δt"


MEANINGS: Mapping[str, Callable[[SceneFile, Frame, Condition, int | None], tuple[Made, str]]] = {
    "bounding_box": _bounding_box,
    "cuboid": _cuboid,
    "surface_collider": _surface,
    "particle_impulse": _impulse,
    "enforce_particle_translation": _translation,
    "enforce_particle_velocity_rotation": _rotation,
    "release_particles_sequentially": _release,
    "object_impulse": _object_impulse,
    "object_tear": _tear,
    "enforce_scene_translation": _scene,
    "sdf_collider": _sdf,
}
"""Kind of a boundary condition → what it is here, and what differs."""
