"""The camera of a scene file."""

import math
from pathlib import Path

import numpy as np
import pytest
import torch

from diffuphy.physgaussian import camera, read
from diffuphy.physgaussian.scene_file import parse
from diffuphy.physgaussian.views import filmed, rig
from diffuphy.physgaussian.world import world
from diffuphy.render.film.captured import Captured
from diffuphy.render.film.rigs import Resting
from diffuphy.types import Particles, Trajectory

PUBLISHED = Path(__file__).parent / "published"
ORBIT = {"default_camera_index": -1, "init_azimuthm": 30.0, "init_elevation": 20.0, "init_radius": 2.0}


def still(frames: int) -> tuple[Trajectory, Particles]:
    x = torch.zeros(1, 3, dtype=torch.float64)
    F = torch.eye(3, dtype=torch.float64).expand(frames, 1, 3, 3)
    motion = Trajectory(x.expand(frames, 1, 3), x.expand(frames, 1, 3), F, 30.0)
    return motion, Particles(x, torch.ones(1), torch.zeros(1), 1.0, (0.0, 0.0, 0.0), 1.0)


def theirs(data: dict, frame: int) -> np.ndarray:
    """Where that program's camera is relative to what it looks at, in the axes of the Gaussians' file, a length of the
    file being a metre: c + [h₁ h₂ v] r (cos a cos e, sin a cos e, sin e), h₁ ∝ (1, 1, 1) − …v, h₂ = h₁ × v."""
    R = np.eye(3)
    for degrees, axis in zip(data.get("rotation_degree", ()), data.get("rotation_axis", ()), strict=True):
        c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
        R = [
            np.array([[1, 0, 0], [0, c, -s], [0, s, c]]),
            np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]),
            np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]),
        ][axis] @ R
    v = R.T @ np.array(data.get("mpm_space_vertical_upward_axis", (0, 0, 1)), float)
    h = np.array([1.0, 1.0, 1.0]) if abs(v.sum()) >= 0.01 else np.array([0.72, 0.37, -0.67])
    h = h - (h @ v) * v
    h /= np.linalg.norm(h)
    moves = frame if data.get("move_camera") else 0
    a, e = (
        math.radians(data[start] + moves * data.get(step, 0))
        for start, step in (("init_azimuthm", "delta_a"), ("init_elevation", "delta_e"))
    )
    r = data["init_radius"] + moves * data.get("delta_r", 0)
    place = np.column_stack([h, np.cross(h, v), v]) @ np.array(
        [math.cos(a) * math.cos(e), math.sin(a) * math.cos(e), math.sin(e)]
    )
    return R @ (r * place)


@pytest.mark.parametrize(
    "more",
    [
        {},
        {"move_camera": True, "delta_a": 2.5, "delta_e": -0.5, "delta_r": 0.05},
        {"rotation_degree": [90.0, 30.0], "rotation_axis": [0, 2]},
        {"mpm_space_vertical_upward_axis": [0, 1, 0], "mpm_space_viewpoint_center": [1.1, 0.9, 1.2]},
        {"mpm_space_vertical_upward_axis": [0, 0, -1]},
    ],
)
def test_the_camera_is_where_it_is_there(more):
    """Turned from their box to ours by Q, in every frame."""
    data = ORBIT | more
    file, (motion, particles) = parse(data), still(5)
    made = rig(file, 1.0, 32.0)(motion, particles, width=64, height=64, floor=False)
    eyes = -(made.viewmats[:, :3, :3].mT @ made.viewmats[:, :3, 3:])[..., 0]
    frame = world(file).frame
    center = np.array(frame.point(file["mpm_space_viewpoint_center"]))
    for t in range(len(eyes)):
        # azimuths are turned into directions in float32
        np.testing.assert_allclose(eyes[t].numpy() - center, frame.turn @ theirs(data, t), rtol=0, atol=2e-6)


@pytest.mark.parametrize("name", ["ficus", "wolf", "bear", "bread", "pillow", "plane", "vasedeck"])
def test_published_cameras_film(name):
    file = read(PUBLISHED / f"{name}.json")
    motion, particles = still(int(file["frame_num"]) + 1)
    made = camera(str(PUBLISHED / f"{name}.json"))(motion, particles, width=64, height=64, floor=False)
    assert len(made) in (1, len(motion.x)) and made.viewmats.isfinite().all()


def test_a_radius_is_in_lengths_of_the_gaussians_file(tmp_path):
    """An object 4 long there and 2 m here: radius 2 is 1 m."""

    class Scene:
        path = str(tmp_path)

        def longest(self) -> float:
            return 4.0

    (tmp_path / "cameras.json").write_text("[]")
    made = filmed(parse(ORBIT | {"scale": 2.0}), Scene())
    assert made.radius == pytest.approx(1.0)
    captured = filmed(parse({"default_camera_index": 3}), Scene())
    assert isinstance(captured, Captured) and captured.views == (3,)
    assert isinstance(filmed(parse({})), Resting)


def test_a_camera_without_a_place_is_an_error():
    with pytest.raises(ValueError, match="init_radius must be given"):
        filmed(parse({**ORBIT, "init_radius": None}))
