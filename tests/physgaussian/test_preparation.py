"""A trained scene, prepared as its scene file says."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import torch

from diffuphy.physgaussian import gaussians
from diffuphy.physgaussian.frame import Frame
from diffuphy.physgaussian.preparation import UPRIGHT
from diffuphy.render.scenes import ply
from diffuphy.render.scenes.placement import Placement
from diffuphy.types import Gaussians, Look

LOOK = Look("thing", "a thing")


def scene(folder: Path, **data) -> tuple[Gaussians, str, str]:
    """Fifty Gaussians about (1, 2, 3) in the axes of their file, and a scene file."""
    r, n = torch.Generator().manual_seed(0), 50
    means = 2 * torch.rand(n, 3, generator=r) - 1 + torch.tensor([1.0, 2.0, 3.0])
    g = Gaussians(
        means, torch.randn(n, 4, generator=r), torch.full((n, 3), -3.0), torch.full((n,), 2.0), torch.zeros(n, 1, 3)
    )
    ply.write(folder / "a.ply", g, up="z_up")
    (folder / "scene.json").write_text(json.dumps(data))
    return g, str(folder / "a.ply"), str(folder / "scene.json")


@pytest.mark.parametrize("up", [(0, 0, 1), (0, 0, -1), (0, 1, 0), (0, -1, 0), (1, 0, 0), (-2, 0, 0)])
def test_the_vertical_of_the_file_is_turned_to_z_as_the_conditions_are(up):
    """The turn of the Gaussians is Q of ``Frame``, by which walls are placed."""
    along = next(k for k in range(3) if up[k])
    turn = UPRIGHT.get((along, int(math.copysign(1, up[along]))))
    R = Placement.turns([turn] if turn else []).R.numpy()
    np.testing.assert_allclose(R, Frame(tuple(map(float, up))).turn, atol=1e-15)


def test_rotations_come_one_after_the_other(tmp_path):
    """x ↦ Q R_z(6.5°) R_y(45°) x, with the right-handed matrices of the original; then centred, longest side 2."""
    data = {"rotation_degree": [45.0, 6.5], "rotation_axis": [1, 2], "mpm_space_vertical_upward_axis": [0, -1, 0]}
    g, path, file = scene(tmp_path, **data)
    a, b = math.radians(45.0), math.radians(6.5)
    R_y = torch.tensor([[math.cos(a), 0, math.sin(a)], [0, 1, 0], [-math.sin(a), 0, math.cos(a)]])
    R_z = torch.tensor([[math.cos(b), -math.sin(b), 0], [math.sin(b), math.cos(b), 0], [0, 0, 1]])
    Q = torch.tensor(Frame((0.0, -1.0, 0.0)).turn, dtype=torch.float32)
    x = g.means @ (Q @ R_z @ R_y).T
    low, high = x.amin(0), x.amax(0)
    expected = (x - (low + high) / 2) * 2 / (high - low).amax()
    torch.testing.assert_close(gaussians(path, file)(LOOK).means, expected, rtol=0, atol=2e-6)


def test_sim_area_is_a_box_after_the_rotations_and_before_the_vertical(tmp_path):
    """Those inside are the object, the others stand around it."""
    area = [0.5, 1.5, -9.0, 2.2, 2.5, 9.0]
    g, path, file = scene(tmp_path, sim_area=area, mpm_space_vertical_upward_axis=[0, 1, 0])
    low, high = torch.tensor(area[::2]), torch.tensor(area[1::2])
    inside = ((g.means >= low) & (g.means <= high)).all(1)
    load = gaussians(path, file)
    assert 0 < len(load(LOOK)) == int(inside.sum()) and load.rest() is not None
    assert len(load.rest() or ()) == 50 - int(inside.sum())


def test_settings_replace_what_the_file_says(tmp_path):
    _, path, file = scene(tmp_path, rotation_degree=[30.0], rotation_axis=[0], opacity_threshold=0.5)
    told = gaussians(path, file)
    assert (told.turns, told.min_opacity, told.up) == ((("x", 30.0),), 0.5, "z_up")
    other = gaussians(path, file, turns=(), min_opacity=0.1, region=None)
    assert (other.turns, other.min_opacity, other.region) == ((), 0.1, None)


def test_without_a_scene_file_it_says_what_to_set(tmp_path):
    _, path, _ = scene(tmp_path)
    with pytest.raises(ValueError, match=r"scene\.file=scene\.json"):
        gaussians(path)
