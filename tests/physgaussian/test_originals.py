"""PhysGaussian's scenes from a trained scene in the layout of the original code to a trajectory, coarse: what each is
known for. The films of the same at a size to be looked at are in docs/benchmarks/physgaussian.md."""

from pathlib import Path

import pytest
import torch

from benchmarks._originals import write
from benchmarks.physgaussian import SCENES, command
from diffuphy.cli import main
from diffuphy.types import Trajectory

pytestmark = pytest.mark.usefixtures("quiet")


def shown(name: str, folder: Path) -> tuple[dict[str, float], torch.Tensor]:
    """What the motion of a scene shows, and its places (T, N, 3) [m]."""
    captured = write(folder / "captured", name, 2000)
    store = folder / "store"
    assert main([*command(SCENES[name], captured, store, tiny=True), "until=trajectory"]) == 0
    (meta,) = store.glob("trajectory/*/meta.json")
    x = Trajectory.load(meta.parent).x.double()
    return SCENES[name].shows(x), x


def test_the_ficus_sways_about_its_held_pot(tmp_path):
    """Pushed once, the crown swings through its rest at least twice, there and back, and the pot stays: held nodes have
    the velocity 0, which takes particles nowhere but by rounding of float32, 1e-7 m a step over 10³ steps."""
    shows, x = shown("ficus", tmp_path)
    assert shows["sign changes"] >= 2 and shows["pot moves [m]"] < 1e-4
    assert 0.02 < shows["farthest [m]"] < 0.3
    assert float(x[1, :, 0].mean()) < float(x[0, :, 0].mean()), "the push is along −x"


def test_the_wolf_of_sand_falls_and_lies_at_its_angle(tmp_path):
    """The heap is no steeper than its friction angle of 30° and what 11 cells of height and a base that is no circle
    make of it; loose sand cannot keep a body's height; and it is on the floor: nothing lies below, but for a cell."""
    shows, x = shown("wolf", tmp_path)
    assert shows["height after [m]"] < 0.4 * shows["height before [m]"]
    assert shows["slope [deg]"] < 30.0 + 10.0
    assert float(x[..., 2].min()) > -1 / 8


def test_the_jam_spreads(tmp_path):
    """A layer of foam stands by itself up to ρ g h/2 = σ_Y/√3, h = 5 mm, so that half a metre of it goes on spreading:
    lower at every end than ever before, past the elastic rebound of its landing."""
    shows, x = shown("jam", tmp_path)
    assert shows["height after [m]"] < 0.4 * shows["height before [m]"]
    assert shows["width after [m]"] > 1.8 * shows["width before [m]"]
    high = x[..., 2].mean(1)
    assert int(high.argmin()) == len(high) - 1, "it sinks to the end"


@pytest.mark.slow
def test_the_can_keeps_its_dent(tmp_path):
    """Of the deepest dent an elastic shell keeps nothing and a rigid-plastic one all: yielding at 1.8 % of strain
    (σ_Y/E = 3.7e4/2e6), a dent of a third of the radius is nearly all plastic."""
    shows, _ = shown("can", tmp_path)
    assert shows["deepest [m]"] > 0.05 and shows["stays [m]"] > 0.7 * shows["deepest [m]"]


@pytest.mark.slow
def test_the_pillow_falls_and_bounces(tmp_path):
    """Held for 1 s it hangs, to the millimetre of its held nodes; let go it falls by more than a tenth of a metre, ends
    on the bed, and rises again by some of the way: it is elastic."""
    shows, x = shown("pillow", tmp_path)
    upper = x[0, :, 2] > x[0, :, 2].amin() + 0.8
    assert shows["lowest [m]"] < shows["height [m]"] - 0.1
    assert 0.01 < shows["rebound [m]"] < shows["height [m]"] - shows["lowest [m]"]
    assert abs(float(x[45, upper, 2].mean() - x[0, upper, 2].mean())) < 0.05, "at 0.9 s it is held"
