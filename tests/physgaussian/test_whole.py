"""From a sentence and a scene file to a film."""

import subprocess
import sys
from pathlib import Path

import pytest
import torch

from diffuphy.types import MaterialField, Trajectory

ROOT = Path(__file__).parents[2]
PUBLISHED = Path(__file__).parent / "published"


def run(name, store, *settings):
    """The trajectory and the material of a run of ``train.py``."""
    arguments = ["prompt=a jelly cube falling", "scene=physgaussian", f"scene.file={PUBLISHED / name}.json",
                 "experiment=tiny", "until=trajectory", f"store={store}", "device=cpu", *settings]  # fmt: skip
    done = subprocess.run(
        [sys.executable, "train.py", *arguments], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "substep_dt" in done.stderr, "the table is in the log"
    (trajectory,), (material,) = ([p for p in (store / s).iterdir() if p.is_dir()] for s in ("trajectory", "material"))
    return Trajectory.load(trajectory), MaterialField.load(material)


@pytest.mark.slow
def test_jam_falls_and_spreads_on_the_floor_of_the_file(tmp_path):
    """Its middle begins 0.4 m above the plane; it lands, keeps off the floor, and is wider and lower at the end."""
    trajectory, field = run("jam", tmp_path, "refine.default_size=0.5")
    x = trajectory.x.double()
    assert field.plastic == ("viscoplastic",) and bool((field.theta["viscosity"] == 100.0).all())
    middle = (x[0].amin(0) + x[0].amax(0)) / 2
    torch.testing.assert_close(middle, torch.tensor([0.0, 0.0, 0.4], dtype=torch.float64), rtol=0, atol=0.02)  # a cell
    # ½ g t² = 0.15 m takes 0.17 s of 0.48
    assert float(x[-1, :, 2].mean()) < 0.4 - 0.15 and float(x[..., 2].min()) > -0.01
    height, width = (x[-1, :, k].amax() - x[-1, :, k].amin() for k in (2, 0))
    assert float(height) < 0.48 and float(width) > 0.52


@pytest.mark.slow
def test_wolf_collapses_from_the_released_side(tmp_path):
    """Sand is free where the plane x = 0.5 − t/1.5 has passed; the rest stands as it stood, to the bit."""
    trajectory, _ = run("wolf", tmp_path, "refine.default_size=1.0", "sample.cells=10")
    x, last = trajectory.x, len(trajectory.x) - 1
    plane = 0.5 - last / trajectory.fps / 1.5
    held = x[0, :, 0] < plane - 1e-3
    assert torch.equal(x[-1, held], x[0, held]) and 0 < int(held.sum()) < len(held)
    outer = x[0, :, 0] > 0.4
    assert float((x[-1, outer, 2] - x[0, outer, 2]).mean()) < -0.02


@pytest.mark.slow
def test_object_of_another_size_is_refused_in_one_line(tmp_path):
    with pytest.raises(AssertionError, match=r"refine\.default_size=0\.5"):
        run("jam", tmp_path)
