"""Scenes as other programs leave them."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest
import torch

from diffuphy.geometry import rotations
from diffuphy.render import orbit
from diffuphy.render.scenes import capture, ply
from diffuphy.render.scenes.placement import Placement
from diffuphy.types import Gaussians
from tests.captured import write_cameras


def some(count: int = 4) -> Gaussians:
    g = torch.Generator().manual_seed(0)
    shapes = ((count, 3), (count, 4), (count, 3), (count,), (count, 1, 3))
    return Gaussians(*(0.5 * torch.randn(*s, generator=g) for s in shapes))


def test_the_newest_iteration_of_a_folder_is_taken(tmp_path: Path) -> None:
    """By number, not by name: 30000 comes after 7000."""
    for n in ("7000", "30000", "best"):
        (tmp_path / f"point_cloud/iteration_{n}").mkdir(parents=True)
        ply.write(tmp_path / f"point_cloud/iteration_{n}/point_cloud.ply", some())
    assert capture.source(tmp_path).parent.name == "iteration_30000"
    assert capture.count(tmp_path) == 4
    with pytest.raises(ValueError, match=r"has no point_cloud/iteration_N/point_cloud\.ply"):
        capture.source(tmp_path / "point_cloud")


def test_cameras_of_a_folder_are_those_that_were_written(tmp_path: Path) -> None:
    """view = (C2W)⁻¹ in float64, stored as float32: rounding of entries of at most 4, 2⁻²² each."""
    camera = orbit([10.0, 200.0], [20.0, -5.0], 4.0, width=40, height=30)
    write_cameras(tmp_path / "cameras.json", camera)
    found = capture.cameras(tmp_path)
    assert [(c.width, c.height) for c in found] == [(40, 30)] * 2
    torch.testing.assert_close(torch.cat([c.viewmats for c in found]), camera.viewmats, rtol=0, atol=1e-6)
    torch.testing.assert_close(torch.cat([c.Ks for c in found]), camera.Ks)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda e: e[0].pop("fx"), "camera 0 is incomplete: KeyError 'fx'"),
        (lambda e: e[0].update(rotation=[[1, 0], [0, 1]]), "camera 0 needs a 3 x 3 rotation"),
        (lambda e: e[0].update(rotation=[[-1, 0, 0], [0, 1, 0], [0, 0, 1]]), "no proper rotation"),
        (lambda e: e[0].update(position=[0, 0, float("nan")]), "a centre or a focal length that is no number"),
        (lambda e: e[0].update(width=10**9), "sides of 1 to 65535 px"),
        (lambda e: e[0].update(fx=[1]), "camera 0 is incomplete: TypeError"),
        (lambda e: e.__setitem__(0, None), "camera 0 is incomplete: TypeError"),
    ],
)
def test_a_wrong_camera_is_one_line(change, says, tmp_path: Path) -> None:
    write_cameras(tmp_path / "cameras.json", orbit([10.0], [20.0], 4.0, width=40, height=30))
    entries = json.loads((tmp_path / "cameras.json").read_text())
    change(entries)
    (tmp_path / "cameras.json").write_text(json.dumps(entries))
    with pytest.raises(ValueError, match=says) as caught:
        capture.cameras(tmp_path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["", "{", "[" * 100_000, "{}"])
def test_a_camera_file_that_is_none_is_one_line(text, tmp_path: Path) -> None:
    (tmp_path / "cameras.json").write_text(text)
    with pytest.raises(ValueError, match=r"is no JSON|must hold a list") as caught:
        capture.cameras(tmp_path / "cameras.json")
    assert "\n" not in str(caught.value)


def test_a_splat_file_holds_what_was_packed(tmp_path: Path) -> None:
    """32 bytes each: f32 centre and scale, 8-bit colour and opacity (a level is 1/255), quaternion (a level 1/128)."""
    g = some(50)
    q = torch.nn.functional.normalize(g.quats, dim=1)
    rgb, opacity = (0.5 + 0.28209479177387814 * g.sh[:, 0]).clamp(0, 1), torch.sigmoid(g.logit_opacities)
    rows = b""
    for i in range(50):
        rows += struct.pack("<6f", *g.means[i].tolist(), *g.log_scales[i].exp().tolist())
        rows += bytes(int(v * 255) for v in (*rgb[i].tolist(), float(opacity[i])))
        rows += bytes(min(255, int(v * 128 + 128)) for v in q[i].tolist())
    (tmp_path / "g.splat").write_bytes(rows)
    back = capture.read(tmp_path / "g.splat", up="z_up")
    assert torch.equal(back.means, g.means)
    torch.testing.assert_close(back.log_scales, g.log_scales, rtol=0, atol=1e-6)  # exp and log of float32
    torch.testing.assert_close(torch.sigmoid(back.logit_opacities), opacity, rtol=0, atol=1 / 255)
    torch.testing.assert_close((0.5 + 0.28209479177387814 * back.sh[:, 0]).clamp(0, 1), rgb, rtol=0, atol=1 / 255)
    # each component is up to 1/128 low; normalised again, an angle of at most ‖(1, 1, 1, 1)‖/128
    torch.testing.assert_close(rotations(back.quats), rotations(q), rtol=0, atol=2 * 2 / 128)
    (tmp_path / "g.splat").write_bytes(rows[:-1])
    with pytest.raises(ValueError, match="1599 bytes are no multiple of 32"):
        capture.read(tmp_path / "g.splat")


@pytest.mark.parametrize("name", ["scene.sog", "scene.ksplat", "scene.npz", "scene"])
def test_other_formats_are_refused_with_a_remedy(name, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(b"x" * 64)
    with pytest.raises(ValueError, match=f"splat-transform {name} out.ply"):
        capture.read(tmp_path / name)
    with pytest.raises(ValueError, match="there is no file"):
        capture.read(tmp_path / "other.ply")


def test_a_placement_turns_the_axes_that_it_says() -> None:
    """Right-handed turns, the first one first: about x takes y to z, then about z takes x to y."""
    R = Placement.turns([("x", 90.0), ("z", 90.0)]).R
    np.testing.assert_allclose(R @ torch.eye(3, dtype=torch.float64), [[0, 0, 1], [1, 0, 0], [0, 1, 0]], atol=1e-15)
