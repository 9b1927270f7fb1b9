"""Scene files are read whole, and what is wrong with one is said in a line."""

import copy
import json
import random
from pathlib import Path

import pytest

from diffuphy.physgaussian import material, played, read, table
from diffuphy.physgaussian.grammar import KEYS
from diffuphy.physgaussian.scene_file import LARGEST, parse

PUBLISHED = sorted((Path(__file__).parent / "published").glob("*.json"))


def condition(kind, **values):
    return {"boundary_conditions": [{"type": kind, **values}]}


SURFACE = {"point": [1, 1, 0.5], "normal": [0, 0, 1], "friction": 0, "start_time": 0, "end_time": 1}


@pytest.mark.parametrize("path", PUBLISHED, ids=lambda p: p.stem)
def test_published_file_has_no_unknown_key(path):
    file = read(path)
    assert file.unknown == () and file.given == frozenset(json.loads(path.read_text()))


def test_what_is_not_given_has_the_default_of_that_program():
    file = parse({})
    assert (file["material"], file["E"], file["nu"], file["density"]) == ("jelly", 1e5, 0.4, 200.0)
    assert (file["grid_lim"], file["n_grid"], file["substep_dt"], file["frame_dt"], file["frame_num"]) == (
        2.0, 50, 1e-4, 1e-2, 100,
    )  # fmt: skip
    assert file["grid_v_damping_scale"] == 1.1 and file["friction_angle"] == 25.0 and file["scale"] == 1.0
    (impulse,) = parse(condition("particle_impulse", force=[1, 0, 0])).conditions
    assert impulse.values == {
        "force": (1.0, 0.0, 0.0), "num_dt": 1, "start_time": 0.0, "point": (1.0,) * 3, "size": (1.0,) * 3,
    }  # fmt: skip
    (cuboid,) = parse(condition("cuboid", point=[1] * 3, size=[1] * 3, velocity=[0] * 3)).conditions
    assert (cuboid["start_time"], cuboid["end_time"], cuboid["reset"]) == (0.0, 1e3, False)


def test_region_without_density_has_that_of_the_file():
    region = {"point": [1, 1, 1], "size": [1, 1, 1], "E": 1e4, "nu": 0.3}
    assert parse({"density": 70, "additional_material_params": [region]}).regions[0]["density"] == 70.0


def test_unknown_keys_are_kept_by_their_path():
    file = parse({"material": "sand", "colour": 1, "type": 2} | condition("bounding_box", point=[1, 1, 1]))
    assert file.unknown == ("colour", "type", "boundary_conditions[0].point")


def test_acoustic_cfl_of_the_file():
    """c √(E (1 − ν)/((1 + ν)(1 − 2ν) ρ)) Δt/Δx, of the fastest region: that of ficus is 0.62, as computed by hand from
    M = 4.2857 MPa, ρ = 70 kg/m³, Δx = 4 cm."""
    file = read(PUBLISHED[[p.stem for p in PUBLISHED].index("ficus")])
    assert file.wave == pytest.approx((2e6 * 0.6 / (1.4 * 0.2) / 70) ** 0.5, rel=1e-12)
    assert file.cfl == pytest.approx(247.4358 * 1e-4 / 0.04, rel=1e-6)


@pytest.mark.parametrize(
    ("data", "says"),
    [
        ([], "it must be an object with keys, got []"),
        ({"E": "stiff"}, "E must be a number in [1e-12, 1e+15], got 'stiff'"),
        ({"E": True}, "E must be a number in [1e-12, 1e+15], got True"),
        ({"E": 0}, "E must be a number in [1e-12, 1e+15], got 0"),
        ({"E": 10**400}, "E must be a number in [1e-12, 1e+15], got 1"),
        ({"nu": 0.5}, "nu must be a number in [0, 0.4999], got 0.5"),
        ({"material": "fluid"}, "material must be one of jelly, metal, sand, foam, snow, plasticine, got 'fluid'"),
        ({"material": ["sand"]}, "material must be one of"),
        ({"g": 9.8}, "g must be a list of 3 values, got 9.8"),
        ({"n_grid": 50.5}, "n_grid must be a whole number in [8, 10000], got 50.5"),
        ({"frame_num": 0}, "frame_num must be a whole number"),
        ({"substep_dt": 5e-324}, "substep_dt must be a number in [1e-12, 1e+15], got 5e-324"),
        ({"frame_dt": 1e-5}, "frame_dt must be at least substep_dt, got 1e-05 and 0.0001 s"),
        ({"rotation_degree": [1]}, "rotation_degree and rotation_axis must be as long as each other, got 1 and 0"),
        ({"rotation_degree": [1], "rotation_axis": [3]}, "rotation_axis must be a whole number in [0, 2], got 3"),
        ({"sim_area": [1, 0, 0, 1, 0, 1]}, "sim_area must be [xmin, xmax"),
        ({"scale": 2.5}, "scale = 2.5 m puts the object, which is centred at (1, 1, 1) m, outside the box"),
        ({"grid_lim": 1.0}, "outside the box of grid_lim = 1 m"),
        ({"mpm_space_vertical_upward_axis": [0, 0, 0]}, "mpm_space_vertical_upward_axis must not be zero"),
        ({"particle_filling": 3}, "particle_filling must be an object"),
        ({"particle_filling": {"n_grid": 0}}, "particle_filling.n_grid must be a whole number"),
        ({"particle_filling": {"search_exclude_direction": "up"}}, "whole number in [-1, 6] or a list of at most 6"),
        ({"additional_material_params": [{}]}, "additional_material_params[0].point is missing"),
        ({"boundary_conditions": {}}, "boundary_conditions must be a list of at most 1000 values"),
        ({"boundary_conditions": [3]}, "boundary_conditions[0].type must be one of bounding_box, "),
        (condition("wind"), "boundary_conditions[0].type must be one of"),
        (condition("cuboid", point=[1, 1], size=[1] * 3, velocity=[0] * 3), "[0].point must be a list of 3 values"),
        (condition("cuboid", size=[1] * 3, velocity=[0] * 3), "boundary_conditions[0].point is missing"),
        (
            condition("cuboid", point=[1] * 3, size=[0] * 3, velocity=[0] * 3),
            "[0].size must be a number in [1e-12, 1e+15]",
        ),
        (condition("surface_collider", surface="wet", **SURFACE), "surface must be one of sticky, slip, separate"),
        (condition("surface_collider", surface="slip", **SURFACE | {"end_time": 0}), "start_time must come before"),
    ],
)
def test_what_is_wrong_is_said_with_its_place(data, says):
    with pytest.raises(ValueError) as error:
        parse(data)
    assert says in str(error.value)


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (condition("surface_collider", surface="cut", **SURFACE), "boundary_conditions[0]: surface 'cut' acts between"),
        (
            condition("release_particles_sequentially", normal=[1, 1, 0], start_position=1, end_position=0,
                      num_layers=5, start_time=0, end_time=1),
            "normal must lie along an axis",
        ),
        (condition("sdf_collider", bound=1.5, dim=2, start_time=0, end_time=1), "bound must be less than half"),
        ({"mpm_space_vertical_upward_axis": [0, 1, 1]}, "must lie along an axis"),
    ],
)  # fmt: skip
def test_what_has_no_meaning_here_is_refused(data, says):
    with pytest.raises(ValueError) as error:
        played(parse(data))
    assert says in str(error.value)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "is not JSON: Expecting value in line 1, column 1"),
        (b'{"E": 1e5,}', "is not JSON"),
        (b"\xff\xfe", "is not text in UTF-8"),
        (b'{"E": NaN}', "NaN is no number of JSON"),
        (b'{"E": 1e999}', "E must be a number in [1e-12, 1e+15], got inf"),
        (b'{"E": 1, "E": 2}', "the key 'E' stands twice in one object"),
        (b"[" * 200_000, "nested too deeply"),
        (b" " * (LARGEST + 1), "is larger than"),
        (b'{"E": ' + b"9" * 5000 + b"}", ""),
    ],
)
def test_what_is_no_scene_file_is_said_in_a_line(tmp_path, content, says):
    path = tmp_path / "scene.json"
    path.write_bytes(content)
    with pytest.raises(ValueError) as error:
        read(path)
    assert says in str(error.value) and "\n" not in str(error.value) and len(str(error.value)) < 300


@pytest.mark.parametrize("path", ["", "no/such/file.json", "\0"])
def test_file_that_cannot_be_read_is_named(path):
    with pytest.raises(ValueError, match="cannot be read"):
        read(path)


def test_byte_order_mark_is_read_over(tmp_path):
    path = tmp_path / "scene.json"
    path.write_bytes(b'\xef\xbb\xbf{"E": 2e5}')
    assert read(path)["E"] == 2e5


JUNK = (
    None, True, -1, 0, 1e308, -1e308, 5e-324, 10**30, "", "\n" * 50, "sticky", [], [[]], {}, [1, 2, 3], [0, 0, 0],
    {"type": "cuboid"}, [{"type": "cuboid"}], [None] * 2000, "x" * 10_000,
)  # fmt: skip


def mutated(data, rng):
    """The same with one value replaced, removed, or added under a name from somewhere."""
    data = copy.deepcopy(data)
    node = data
    while True:
        keys = list(node) if isinstance(node, dict) else list(range(len(node)))
        if not keys:
            return data
        key = rng.choice(keys)
        if isinstance(node[key], dict | list) and node[key] and rng.random() < 0.7:
            node = node[key]
            continue
        if isinstance(node, dict) and rng.random() < 0.2:
            del node[key]
        elif isinstance(node, dict) and rng.random() < 0.2:
            node[rng.choice([*KEYS, "a\nb", ""])] = rng.choice(JUNK)
        else:
            node[key] = rng.choice(JUNK)
        return data


@pytest.mark.parametrize("seed", range(100))
def test_every_file_is_read_or_refused_in_one_line(tmp_path, seed):
    """Damaged files, values of the wrong kind and size: never anything but a result or a ``ValueError`` of one line."""
    rng = random.Random(seed)
    data = json.loads(rng.choice(PUBLISHED).read_text())
    for _ in range(rng.randint(1, 3)):
        data = mutated(data, rng)
    content = bytearray(json.dumps(data).encode())
    if seed % 4 == 0:
        for _ in range(rng.randint(1, 5)):
            content[rng.randrange(len(content))] = rng.randrange(256)
    if seed % 8 == 1:
        del content[rng.randrange(len(content)) :]
    path = tmp_path / "scene.json"
    path.write_bytes(bytes(content))
    try:
        file = read(path)
        played(file), material(str(path))
        assert all(len(line) < 200 for line in table(file).splitlines())
    except ValueError as error:
        assert "\n" not in str(error) and len(str(error)) < 600
    assert [p.name for p in tmp_path.iterdir()] == ["scene.json"]
