"""Every example runs, coarse and quick, and what it says is true."""

import importlib.util
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"


def example(name: str):
    """An example as a module, as if it had been run from its folder."""
    spec = importlib.util.spec_from_file_location(f"example_{name}", EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def tiny(tmp_path, monkeypatch):
    """Settings of a quick film, in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    quick = ("experiment=tiny", "fit.steps=4", "material.steps=2", "scene.seconds=0.3", f"store={tmp_path}/store")
    return (*quick, "report.error=off", "evaluate.score=off")


def test_every_example_is_tested_and_listed():
    names = {p.stem for p in EXAMPLES.glob("*.py")}
    tested, listed = Path(__file__).read_text(), (EXAMPLES / "README.md").read_text()
    assert all(f'example("{n}")' in tested and f"{n}.py" in listed for n in names) and len(names) >= 10


def test_recover_stiffness():
    """Newton on the square root of the loss converges quadratically: five digits after six steps."""
    truth, path = example("recover_stiffness").main(150, 6)
    assert abs(path[-1] - truth) < 1e-3 and abs(path[0] - truth) > 0.1


def test_new_law():
    """It stiffens, so it is flattened less."""
    flattest = example("new_law").main(216)
    assert flattest["hencky"] < flattest["stiffening"] < 1


def test_sand_column(tmp_path):
    coarse, fine = example("sand_column").main(120, 20, str(tmp_path / "sand"))
    assert 0.1 < coarse < fine < 0.25 and (tmp_path / "sand.mp4").stat().st_size > 1000


def test_moving_walls(tmp_path):
    """The plate stops at 0.08 m; the surface of the clay is felt a cell before it, its top particle half a spacing below."""
    pressed = example("moving_walls").main(512, 31, str(tmp_path / "walls"))
    assert 0.06 < pressed < 0.11 and (tmp_path / "walls.png").exists()


def test_sentence(tiny):
    made = example("sentence").main(*tiny)
    assert made.files["film"].stat().st_size > 1000
