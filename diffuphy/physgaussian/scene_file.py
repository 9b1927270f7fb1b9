"""Reads a PhysGaussian scene file: JSON, checked key by key, with every default filled in."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from diffuphy.physgaussian.grammar import CONDITIONS, FILLING, KEYS, REGION, REQUIRED, Key, shown

LARGEST = 2**20
"""Bytes of a file that is read; published ones have three thousand."""


@dataclass(frozen=True)
class Condition:
    """One boundary condition."""

    kind: str
    """Key of ``grammar.CONDITIONS``."""
    values: Mapping[str, Any]
    """Its settings."""
    place: str
    """Where it stands in the file, "boundary_conditions[2]"."""

    def __getitem__(self, name: str) -> Any:
        return self.values[name]


@dataclass(frozen=True)
class SceneFile:
    """A scene file, read. Lengths are in the box [0, grid_lim]³, where the object is centred at (1, 1, 1) m."""

    values: Mapping[str, Any]
    """Value of every key of ``grammar.KEYS``."""
    given: frozenset[str]
    """Keys that the file has."""
    conditions: tuple[Condition, ...]
    """Its boundary conditions."""
    regions: tuple[Mapping[str, Any], ...]
    """Its ``additional_material_params``."""
    filling: Mapping[str, Any] | None
    """Its ``particle_filling``."""
    unknown: tuple[str, ...]
    """Keys that nobody knows, by their path."""

    def __getitem__(self, name: str) -> Any:
        return self.values[name]

    @property
    def dx(self) -> float:
        """Grid spacing there [m]."""
        return self["grid_lim"] / self["n_grid"]

    @property
    def substeps(self) -> int:
        """Substeps of a frame there, which cuts off what is left over."""
        return int(self["frame_dt"] / self["substep_dt"])

    @property
    def wave(self) -> float:
        """Fastest wave at rest [m/s].  c = √((λ + 2μ)/ρ) = √(E (1 − ν)/((1 + ν)(1 − 2ν) ρ)), the largest of all
        regions."""
        matter = [(self["E"], self["nu"], self["density"]), *((r["E"], r["nu"], r["density"]) for r in self.regions)]
        return max(math.sqrt(E * (1 - nu) / ((1 + nu) * (1 - 2 * nu) * rho)) for E, nu, rho in matter)

    @property
    def cfl(self) -> float:
        """Cells that the fastest wave crosses in a substep there [-]."""
        return self.wave * self["substep_dt"] / self.dx


def read(path: str | Path) -> SceneFile:
    """Read a scene file.

    Raises:
        ValueError: no such file, no JSON, or a value that is not what its key takes; one line with file, place in it,
            what it must be and what it is.
    """
    path = Path(path)
    try:
        with path.open("rb") as stream:
            content = stream.read(LARGEST + 1)
    except (OSError, ValueError) as e:
        reason = getattr(e, "strerror", None) or str(e)
        raise ValueError(f"scene file {shown(str(path))} cannot be read: {reason}") from None
    if len(content) > LARGEST:
        raise ValueError(f"scene file {path.name} is larger than {LARGEST} bytes; published ones have three thousand")
    try:
        return parse(_loads(content))
    except ValueError as e:
        raise ValueError(f"scene file {path.name}: {e}") from None


def _loads(content: bytes) -> Any:
    def refused(name: str) -> None:
        raise ValueError(f"{name} is no number of JSON")

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) < len(pairs):
            names = [name for name, _ in pairs]
            raise ValueError(
                f"the key {shown(next(n for n in names if names.count(n) > 1))} stands twice in one object"
            )
        return found

    try:
        return json.loads(content.decode("utf-8-sig"), parse_constant=refused, object_pairs_hook=unique)
    except UnicodeDecodeError:
        raise ValueError("is not text in UTF-8") from None
    except json.JSONDecodeError as e:
        raise ValueError(f"is not JSON: {e.msg} in line {e.lineno}, column {e.colno}") from None
    except RecursionError:
        raise ValueError("is nested too deeply") from None


def parse(data: Any) -> SceneFile:
    """What :func:`read` makes of the JSON value ``data``.

    Raises:
        ValueError: see :func:`read`, without the name of the file.
    """
    unknown: list[str] = []
    values = _object(data, KEYS, "", unknown)
    regions = tuple(
        {k: values["density"] if v is None and k == "density" else v for k, v in region.items()}
        for region in (
            _object(r, REGION, f"additional_material_params[{i}].", unknown)
            for i, r in enumerate(values["additional_material_params"])
        )
    )
    filling = values["particle_filling"]
    if filling is not None:
        filling = _object(filling, FILLING, "particle_filling.", unknown)
    conditions = tuple(
        _condition(c, f"boundary_conditions[{i}]", unknown) for i, c in enumerate(values["boundary_conditions"])
    )
    file = SceneFile(values, frozenset(data) & set(KEYS), conditions, regions, filling, tuple(unknown))
    _agree(file)
    return file


def _object(data: Any, keys: Mapping[str, Key], place: str, unknown: list[str]) -> dict[str, Any]:
    """The values of an object whose keys are known; others are added to ``unknown``."""
    if not isinstance(data, dict):
        raise ValueError(f"{place.rstrip('.') or 'it'} must be an object with keys, got {shown(data)}")
    unknown += [f"{place}{shown(name)[1:-1]}" for name in data if name not in keys]
    found = {}
    for name, key in keys.items():
        if name not in data and key.default is REQUIRED:
            raise ValueError(f"{place}{name} is missing")
        try:
            found[name] = key.read(data[name]) if name in data else key.default
        except ValueError as e:
            raise ValueError(f"{place}{name} {e}") from None
    return found


def _condition(data: Any, place: str, unknown: list[str]) -> Condition:
    kind = data.get("type") if isinstance(data, dict) else None
    if not isinstance(kind, str) or kind not in CONDITIONS:
        raise ValueError(f"{place}.type must be one of {', '.join(CONDITIONS)}, got {shown(kind)}")
    values = _object({k: v for k, v in data.items() if k != "type"}, CONDITIONS[kind], f"{place}.", unknown)
    if "end_time" in values and not values["start_time"] < values["end_time"]:
        raise ValueError(
            f"{place}: start_time must come before end_time, got {values['start_time']:g} and {values['end_time']:g} s"
        )
    return Condition(kind, values, place)


def _agree(file: SceneFile) -> None:
    """Refuse values that do not go together."""
    if len(file["rotation_degree"]) != len(file["rotation_axis"]):
        raise ValueError(
            "rotation_degree and rotation_axis must be as long as each other, got "
            f"{len(file['rotation_degree'])} and {len(file['rotation_axis'])} values"
        )
    if file.substeps < 1:
        raise ValueError(f"frame_dt must be at least substep_dt, got {file['frame_dt']:g} and {file['substep_dt']:g} s")
    half = 0.5 * file["scale"]
    if not (1.0 - half >= 0.0 and 1.0 + half <= file["grid_lim"]):
        raise ValueError(
            f"scale = {file['scale']:g} m puts the object, which is centred at (1, 1, 1) m, outside the box of "
            f"grid_lim = {file['grid_lim']:g} m"
        )
