"""A run folder is read back as what made it."""

import dataclasses
import shutil

import pytest

from diffuphy.mpm.trajectory import Simulate
from diffuphy.types import Trajectory
from diffuphy.viewer.__main__ import main
from diffuphy.viewer.opened import Run


@pytest.fixture
def folder(whole_run, tmp_path):
    """A copy of a finished run, to be changed at will."""
    shutil.copytree(whole_run.store, tmp_path / "store", symlinks=True)
    return tmp_path / "store" / "runs" / whole_run.folder.name


def test_a_run_is_opened_with_its_results_and_its_settings(folder):
    run = Run.open(folder)
    stored = Trajectory.load(folder / "5_trajectory")
    assert run.trajectory.x.equal(stored.x) and len(run.field) == len(run.particles) == stored.x.shape[1]
    assert isinstance(run.play, Simulate) and run.play.seconds == 0.5 and run.film.width == 128
    assert run.motion.verb == "falling"
    assert len(stored.x) == run.play.scene(run.motion, run.particles).frames + 1


def test_a_run_without_links_is_opened_by_the_notes_in_their_place(folder):
    for link in folder.glob("[0-9]_*"):
        target = link.readlink()
        link.unlink()
        link.with_suffix(".path.txt").write_text(f"{target}\n")
    assert dataclasses.is_dataclass(Run.open(folder))


def test_the_accuracy_of_a_run_is_that_of_its_simulations(folder):
    """Grid and splines were chosen for it, not taken from the settings."""
    from omegaconf import OmegaConf

    from diffuphy.accuracy import choose

    file = folder / ".hydra/config.yaml"
    config = OmegaConf.load(file)
    config.accuracy = 0.2
    OmegaConf.save(config, file)
    run = Run.open(folder)
    assert run.play.scheme.order == choose(0.2, run.motion).order


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (shutil.rmtree, "is no run folder"),
        (lambda f: (f / "5_trajectory").unlink(), "has no trajectory yet"),
        (lambda f: shutil.rmtree(f / ".hydra"), "config.yaml is missing"),
    ],
    ids=["no folder", "unfinished", "no settings"],
)
def test_what_is_no_finished_run_is_refused_in_a_line(folder, spoil, said, capsys):
    spoil(folder)
    assert main([str(folder), "--device", "cpu"]) == 2
    out = capsys.readouterr()
    assert out.err.startswith("error: ") and said in out.err and out.err.count("\n") == 1
