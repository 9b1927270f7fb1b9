"""From Python and from the command line the same film, in the same place, under the same keys."""

import subprocess
import sys

import pytest

import diffuphy
from diffuphy.cli import main
from diffuphy.types import Prompt

TINY = ("experiment=tiny", "until=prompt")


def test_python_and_command_line_are_one_program(tmp_path):
    """The run that Python made is found by the command line: nothing is computed again, the folder is the same."""
    made = diffuphy.film("a rubber ball, 'falling'! = $ {}", *TINY, store=tmp_path, seed=3)
    assert isinstance(made.result("prompt"), Prompt) and made.folder.parent == tmp_path / "runs"
    stored = sorted((tmp_path / "prompt").iterdir())
    assert main(["prompt=a rubber ball, 'falling'! = $ {}", *TINY, f"store={tmp_path}", "seed=3"]) == 0
    assert sorted((tmp_path / "prompt").iterdir()) == stored
    assert [p.name for p in (tmp_path / "runs").iterdir()] == [made.folder.name]


def test_a_stage_that_was_not_reached_is_named(tmp_path):
    made = diffuphy.film("a rubber ball falling", *TINY, store=tmp_path)
    assert made.files == {} and [d.name for d in made.done] == ["prompt"]
    with pytest.raises(KeyError, match="no stage 'clip'; it has prompt"):
        made.result("clip")


def test_wrong_settings_raise_what_the_command_line_says(tmp_path):
    with pytest.raises(ValueError, match="seed must be a whole number"):
        diffuphy.film("a ball falling", store=tmp_path, seed="'x'")


def test_importing_the_package_loads_no_hydra():
    code = "import sys, diffuphy; assert 'hydra' not in sys.modules and 'torch' not in sys.modules; diffuphy.film"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_settings_of_a_run_are_kept_as_the_command_line_keeps_them(tmp_path):
    """The viewer and the exporter read them: both ways leave the same file."""
    made = diffuphy.film("a rubber ball falling", *TINY, store=tmp_path / "a", seed=3)
    assert main(["prompt=a rubber ball falling", *TINY, f"store={tmp_path / 'b'}", "seed=3"]) == 0
    texts = [(tmp_path / s / "runs" / made.folder.name / ".hydra/config.yaml").read_text() for s in ("a", "b")]
    assert texts[0] == texts[1].replace(str(tmp_path / "b"), str(tmp_path / "a"))
