"""Pictures with their cameras."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from diffuphy.render import orbit
from diffuphy.render.scenes import capture
from diffuphy.render.scenes.photographs import files, rgba, shots
from tests.captured import write_cameras
from tests.photographed import one_picture, write_pictures

EYE = np.eye(4).tolist()


def scene(folder: Path, **changes) -> Path:
    """One picture, seen from the origin along −z."""
    one_picture(folder / "a.png")
    frame = {"file_path": "./a", "transform_matrix": EYE} | changes.pop("frame", {})
    (folder / "transforms.json").write_text(json.dumps({"camera_angle_x": math.pi / 2, "frames": [frame]} | changes))
    return folder


def project(camera, point) -> list[float]:
    """Pixel of a point, [px]."""
    at = camera.Ks[0] @ (camera.viewmats[0, :3, :3] @ torch.tensor(point) + camera.viewmats[0, :3, 3])
    return (at[:2] / at[2]).tolist()


def test_a_camera_of_opengl_looks_along_minus_z_with_y_up(tmp_path):
    """At 90° across 8 px, f = 4 px: (0, 0, −1) is the middle, y up is up in the picture, x right is right."""
    (shot,) = shots(scene(tmp_path))
    assert shot.file == tmp_path.resolve() / "a.png" and shot.held is None
    assert project(shot.camera, [0.0, 0.0, -1.0]) == pytest.approx([4.0, 4.0])
    assert project(shot.camera, [0.5, 0.25, -1.0]) == pytest.approx([6.0, 3.0])


def test_focal_lengths_follow_the_size_of_the_file(tmp_path):
    """f and c are in pixels of w x h; the picture here has half of them."""
    told = {"w": 16, "h": 16, "fl_x": 20.0, "fl_y": 12.0, "cx": 7.0, "cy": 9.0}
    (shot,) = shots(scene(tmp_path, **told))
    K = torch.tensor([[10.0, 0.0, 3.5], [0.0, 6.0, 4.5], [0.0, 0.0, 1.0]])
    torch.testing.assert_close(shot.camera.Ks[0], K)


def test_pictures_written_with_cameras_come_back_with_them(tmp_path):
    """World to camera of every picture, by float32 rounding of numbers of at most 4."""
    cameras = write_pictures(tmp_path, count=5, side=16)
    found = shots(tmp_path)
    views = torch.cat([s.camera.viewmats for s in found])
    torch.testing.assert_close(views, cameras.viewmats, rtol=0, atol=4e-6)
    torch.testing.assert_close(torch.cat([s.camera.Ks for s in found]), cameras.Ks, rtol=1e-5, atol=1e-5)
    assert [f.name for f in files(tmp_path)] == ["transforms.json", *(f"r_{i}.png" for i in range(5))]


def test_train_and_test_files_say_what_is_held_out(tmp_path):
    scene(tmp_path)
    (tmp_path / "transforms.json").rename(tmp_path / "transforms_train.json")
    (tmp_path / "transforms_test.json").write_text((tmp_path / "transforms_train.json").read_text())
    assert [s.held for s in shots(tmp_path)] == [False, True]


def test_cameras_of_the_original_code_have_their_pictures_in_a_folder(tmp_path):
    """The cameras are those of ``capture.cameras``, at the size of the pictures."""
    camera = orbit([0.0, 90.0], 20.0, 3.0, fov=40.0, width=16, height=16)
    write_cameras(tmp_path / "cameras.json", camera)
    (tmp_path / "images").mkdir()
    for i in range(2):
        one_picture(tmp_path / "images" / f"{i:04d}.png")
    found = shots(tmp_path)
    for shot, there in zip(found, capture.cameras(tmp_path), strict=True):
        torch.testing.assert_close(shot.camera.viewmats, there.viewmats)
        torch.testing.assert_close(shot.camera.Ks[0, :2], there.Ks[0, :2] / 2)


def test_a_smaller_picture_is_the_mean_of_what_it_covers(tmp_path):
    """Premultiplied: a red quarter of a block is a quarter of red; what hides behind transparency is not seen."""
    pixels = np.zeros((4, 4, 4), np.uint8)
    pixels[..., 1] = 255  # green, and transparent
    pixels[0, 0] = [255, 0, 0, 255]
    Image.fromarray(pixels).save(tmp_path / "a.png")
    (shot,) = shots(_with(tmp_path))
    small = rgba(shot, 2, 2, None)
    expected = torch.zeros(2, 2, 4)
    expected[0, 0] = torch.tensor([0.25, 0.0, 0.0, 0.25])
    torch.testing.assert_close(small, expected, rtol=0, atol=1e-7)


def _with(folder: Path) -> Path:
    frame = {"file_path": "a.png", "transform_matrix": EYE}
    (folder / "transforms.json").write_text(json.dumps({"camera_angle_x": 1.0, "frames": [frame]}))
    return folder


def test_an_opaque_picture_shows_what_is_not_its_background(tmp_path):
    pixels = np.full((4, 4, 3), [0, 0, 255], np.uint8)
    pixels[1, 2] = [200, 100, 0]
    Image.fromarray(pixels).save(tmp_path / "a.png")
    (shot,) = shots(_with(tmp_path))
    with pytest.raises(ValueError, match=r"gaussians\.background"):
        rgba(shot, 4, 4, None)
    found = rgba(shot, 4, 4, (0.0, 0.0, 1.0))
    assert found[..., 3].nonzero().tolist() == [[1, 2]] and float(found[..., 2].amax()) == 0.0


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"frame": {"file_path": "../a"}}, "which is not in"),
        ({"frame": {"file_path": "b"}}, "which is not in"),
        ({"frame": {"file_path": 3}}, "which is not in"),
        ({"k1": 0.1}, "undistort"),
        ({"frame": {"transform_matrix": [[1]]}}, "4 x 4"),
        ({"frame": {"transform_matrix": "x"}}, "is incomplete"),
        ({"frame": {"transform_matrix": (2 * np.eye(4)).tolist()}}, "no proper rotation"),
        ({"camera_angle_x": 0.0}, "is incomplete"),
        ({"camera_angle_x": "wide"}, "could not convert"),
        ({"fl_x": -1.0}, "no proper rotation"),
        ({"frames": {}}, "neither a list"),
        ({"frames": []}, "must have 1 to"),
        ({"frames": [3]}, "is incomplete"),
    ],
)
def test_what_is_no_scene_is_refused(changes, says, tmp_path):
    inside = tmp_path / "scene"
    inside.mkdir()
    one_picture(tmp_path / "a.png")
    with pytest.raises(ValueError, match=says):
        shots(scene(inside, **changes))


def test_a_file_that_is_no_picture_is_refused(tmp_path):
    scene(tmp_path)
    (tmp_path / "a.png").write_bytes(b"no picture")
    with pytest.raises(ValueError, match="no picture that can be read"):
        shots(tmp_path)
    with pytest.raises(ValueError, match=r"no transforms\.json"):
        shots(tmp_path / "nowhere")
