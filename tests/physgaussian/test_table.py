"""The table says of every value what it means here."""

import json
from pathlib import Path

import pytest

from diffuphy.physgaussian import read, table
from diffuphy.physgaussian.grammar import CONDITIONS, KEYS
from diffuphy.physgaussian.matter import SUBSTANCES
from diffuphy.physgaussian.scene_file import parse
from diffuphy.physgaussian.table import VIEWED, WIDTH, rows
from diffuphy.physgaussian.world import MEANINGS

PUBLISHED = sorted((Path(__file__).parent / "published").glob("*.json"))


def said(data, key):
    """What the table says of a key."""
    return next(f"{r.there} | {r.here}" for r in rows(parse(data)) if r.key.partition(" ")[0] == key)


@pytest.mark.parametrize("path", PUBLISHED, ids=lambda p: p.stem)
def test_every_given_key_has_a_row(path):
    keys = " ".join(r.key for r in rows(read(path)))
    lists = ("additional_material_params", "boundary_conditions")
    assert [k for k in json.loads(path.read_text()) if k not in lists and k not in keys] == []
    for i in range(len(read(path).conditions)):
        assert f"boundary_conditions[{i}] " in keys


def test_every_key_that_is_known_has_a_row_when_given():
    """Of all that a file may hold, none is dropped without a word."""
    data = {name: key.default for name, key in KEYS.items() if name not in ("particle_filling", "sim_area")}
    data = json.loads(json.dumps({k: v for k, v in data.items() if v is not None}))
    data |= {"particle_filling": {}, "sim_area": [0, 1, 0, 1, 0, 1], "init_radius": 1, "delta_a": 1, "colour": 3}
    keys = " ".join(r.key for r in rows(parse(data)))
    lists = {"additional_material_params", "boundary_conditions"}  # empty ones say nothing
    assert [k for k in data if k not in lists and k not in keys] == []


def test_lines_fit():
    for path in PUBLISHED:
        assert max(map(len, table(read(path)).splitlines())) <= WIDTH


def test_camera_keys_are_known():
    assert set(VIEWED) < set(KEYS) and set(MEANINGS) == set(CONDITIONS) and "jelly" in SUBSTANCES


@pytest.mark.parametrize(
    ("data", "key", "says"),
    [
        ({}, "substep_dt", "32.73 m/s cross 0.0818 cells"),  # √(1e5 · 0.6/(1.4 · 0.2)/200), over 4 cm in 0.1 ms
        ({"substep_dt": 2e-3}, "substep_dt", "more than the 0.75 up to which explicit steps are stable"),
        ({"substep_dt": 3e-4}, "frame_dt", "there 33 substeps make 0.0099 s"),
        ({"grid_v_damping_scale": 0.9999}, "grid_v_damping_scale", "τ = −substep_dt/ln scale = 0.9999 s"),
        ({"grid_v_damping_scale": 1.1}, "grid_v_damping_scale", "nothing: only less than 1 damps"),
        ({"material": "snow"}, "material", "has stress"),
        ({"material": "metal"}, "yield_stress", "with none it flows at once"),
        ({"friction_angle": 30}, "friction_angle", "not used: jelly does not read it"),
        ({"rpic_damping": 0.5}, "rpic_damping", "not used"),
        ({"n_grid": 100}, "n_grid", "not used"),
        ({"z_offset": 2}, "z_offset", "not used"),
        ({"colour": "red"}, "colour", "unknown"),
        ({}, "g", "there a file without it stops"),
    ],
)
def test_what_differs_is_said(data, key, says):
    assert says in said(data, key)


def test_friction_that_acts_is_said():
    wall = {"type": "surface_collider", "point": [1, 1, 0.5], "normal": [0, 0, 1], "surface": "separate",
            "friction": 0.4, "start_time": 0, "end_time": 1}  # fmt: skip
    text = " ".join(table(parse({"boundary_conditions": [wall]})).split())
    assert "lets go, rubs" in text and "μ = 0.4" in text
