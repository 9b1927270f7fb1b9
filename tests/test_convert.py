"""A scene file becomes a preset that plays the same scene."""

import json
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from hydra.errors import InstantiationException
from omegaconf import OmegaConf

from diffuphy.composing import conf_dir, make
from diffuphy.convert import main, name_of
from diffuphy.physgaussian import material, played, read
from diffuphy.settings import check

PUBLISHED = sorted((Path(__file__).parent / "physgaussian" / "published").glob("*.json"))


def stages(*overrides):
    """The components of a run."""
    with initialize_config_dir(str(conf_dir()), version_base="1.3"):
        cfg = compose("train", overrides=["prompt=a bear", *overrides])
    settings = OmegaConf.to_container(cfg, resolve=True)
    check(settings)
    return make(settings["stages"])


def found_in(folder):
    """Hydra's ``--config-dir``."""
    return f"hydra.searchpath=[file://{folder}]"


@pytest.mark.parametrize("path", PUBLISHED, ids=lambda p: p.stem)
def test_preset_is_the_scene_of_the_file(path, tmp_path, capsys):
    """The components that the YAML makes are equal to those made from the file."""
    assert main([str(path), "--out", str(tmp_path)]) == 0
    assert f"experiment={path.stem}" in capsys.readouterr().out
    assert [p.relative_to(tmp_path).as_posix() for p in tmp_path.rglob("*.yaml")] == [f"experiment/{path.stem}.yaml"]
    preset = stages(found_in(tmp_path), f"experiment={path.stem}")
    assert preset["trajectory"] == played(read(path)) and preset["material"] == material(str(path))
    assert preset["prompt"].default_size == read(path)["scale"]


def test_scene_option_is_the_scene_of_the_file():
    """``scene=physgaussian`` brings the material of the file along, which another may replace."""
    path = PUBLISHED[0]
    made = stages("scene=physgaussian", f"scene.file={path}", "scene.particles=5000", "scene.seconds=0.5")
    assert made["trajectory"] == played(read(path), 5000, seconds=0.5) and made["material"] == material(str(path))
    other = stages("scene=physgaussian", f"scene.file={path}", "material=stated")
    assert other["material"].pieces[0].rho == 1000.0


@pytest.mark.parametrize(
    ("setting", "says"),
    [
        ("scene.file=3", ".file must be text or null, got 3"),
        ("scene.seconds=long", "scene.seconds must be a number or null, got 'long'"),
        ("scene.particles=0", "scene.particles must be at least 1, got 0"),
        ("scene.file=null", "scene.file is not set"),
    ],
)
def test_setting_that_makes_no_scene_is_refused(setting, says):
    with pytest.raises((ValueError, InstantiationException)) as error:
        stages("scene=physgaussian", *([f"scene.file={PUBLISHED[0]}"] if "file" not in setting else []), setting)
    assert says in f"{error.value} {error.value.__cause__}"


def test_without_a_folder_the_table_alone_is_printed(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main([str(PUBLISHED[0])]) == 0
    assert "substep_dt" in capsys.readouterr().out and list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("content", "options", "says"),
    [
        ("{", [], "is not JSON"),
        (json.dumps({"E": -1}), [], "E must be a number"),
        ("{}", ["--particles", "0"], "--particles must be at least 1, got 0"),
    ],
)
def test_failure_is_one_line_and_writes_nothing(content, options, says, tmp_path, capsys):
    path = tmp_path / "scene.json"
    path.write_text(content)
    assert main([str(path), "-o", str(tmp_path / "out"), *options]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and error.count("\n") == 1 and says in error
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("path", "name"), [("a/wolf4sand_config.json", "wolf4sand_config"), ("../../x y.json", "x_y"), ("é.json", "scene")]
)
def test_name_of_a_preset_is_plain(path, name):
    assert name_of(Path(path)) == name
