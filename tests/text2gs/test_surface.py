"""A mesh of one's own as Gaussians."""

import math
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from diffuphy.artifact import describe
from diffuphy.geometry import rotations
from diffuphy.mpm.sampling.sample import Sample
from diffuphy.render import orbit, render_gaussians
from diffuphy.text2gs.surface import LoadMesh, from_z
from diffuphy.types import Look, Motion
from diffuphy.workspace import Workspace

LOOK = Look("ball", "a ball")


def box_file(path: Path, *, faces: list[list[int]] | None = None) -> str:
    """A box of 2 x 1 x 1 as .obj text, y up, its colours those of its corners."""
    corners = [(x, y, z) for x in (-1, 1) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = faces or [t for a, b, c, d in quads for t in ([a, b, c], [a, c, d])]
    lines = [f"v {x} {y} {z} {(x + 1) / 2} {y + 0.5} {z + 0.5}" for x, y, z in corners]
    lines += ["f " + " ".join(str(i + 1) for i in t) for t in triangles]
    path.write_text("\n".join(lines))
    return str(path)


def test_quaternions_take_z_to_the_normal() -> None:
    """R(q) e_z = n, at the poles too."""
    n = torch.nn.functional.normalize(torch.randn(50, 3, generator=torch.Generator().manual_seed(0)).double(), dim=1)
    n = torch.cat([n, torch.tensor([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]], dtype=torch.float64)])
    torch.testing.assert_close(rotations(from_z(n))[:, :, 2], n, rtol=0, atol=1e-12)


def test_a_box_stands_upright_with_even_points_in_its_colours(tmp_path) -> None:
    """(x, y, z) of a y-up file is (x, −z, y) here; shares of the points are those of the areas to one in each strip of
    a triangle; colours are linear in the corners'."""
    pytest.importorskip("trimesh")
    load = LoadMesh(box_file(tmp_path / "box.obj"), count=4000)
    g = load(LOOK)
    assert len(g) == 4000 == load.count
    ends = (g.means[:, 0].abs() > 0.999).float().mean()
    # 2 ends of 1 out of 2 + 4 · 2, each point in its own share of the area: 12 triangles, one point each may differ
    assert abs(float(ends) - 0.2) < 12 / 4000
    assert float(g.means[:, 1:].abs().amax()) < 0.5 * (1 + 2e-3)
    rgb = 0.5 + 0.28209479177387814 * g.sh[:, 0]
    x, y, z = g.means.unbind(1)
    wanted = torch.stack([(x + 1) / 2, z + 0.5, 0.5 - y], dim=1)
    # colours of the corners are 8-bit numbers; the box of the centres is up to 1e-3 smaller than the mesh
    torch.testing.assert_close(rgb, wanted, rtol=0, atol=1 / 255 + 2e-3)


def test_a_closed_mesh_is_opaque_and_becomes_solid(tmp_path) -> None:
    """Light is stopped at 1 − exp(−2π 0.8² 0.95) = 98 % in the mean; inside, the particles fill the volume."""
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.icosphere(subdivisions=4).export(tmp_path / "ball.glb")
    g = LoadMesh(str(tmp_path / "ball.glb"), count=8000)(LOOK)
    alpha = render_gaussians(g, orbit([0.0, 90.0], [10.0, -60.0], 4.0, width=64, height=64)).alpha
    assert float(alpha[:, 24:40, 24:40].mean()) > 0.98
    particles = Sample(cells=24, max_particles=60_000)(g, Motion("falling", "", size=1.0), work=Workspace())
    sigma = math.exp(float(g.log_scales[0, 0])) / 2 / 5  # across the surface [m]
    reach = 2 * sigma + particles.spacing  # how far matter may lie outside the centres
    volume = float(particles.vol.sum())
    assert math.pi / 6 < volume < math.pi / 6 * (1 + 2 * reach) ** 3


def test_textures_are_looked_up_at_the_points(tmp_path) -> None:
    """A square whose picture is red on the left and blue on the right."""
    trimesh = pytest.importorskip("trimesh")
    from PIL import Image

    pixels = np.zeros((8, 8, 3), np.uint8)
    pixels[:, :4, 0], pixels[:, 4:, 2] = 255, 255
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    visual = trimesh.visual.TextureVisuals(uv=corners[:, :2], image=Image.fromarray(pixels))
    trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], visual=visual, process=False).export(tmp_path / "square.glb")
    g = LoadMesh(str(tmp_path / "square.glb"), count=400)(LOOK)
    rgb, left = 0.5 + 0.28209479177387814 * g.sh[:, 0], g.means[:, 0] < -0.2
    assert (rgb[left, 0] > 0.99).all() and (rgb[left, 2] < 0.01).all()
    right = g.means[:, 0] > 0.2
    assert (rgb[right, 2] > 0.99).all() and (rgb[right, 0] < 0.01).all()


def test_points_depend_on_the_seed_alone(tmp_path) -> None:
    pytest.importorskip("trimesh")
    path = box_file(tmp_path / "box.obj")
    a, b, c = (LoadMesh(path, count=50, seed=s)(LOOK) for s in (0, 0, 1))
    assert torch.equal(a.means, b.means) and not torch.equal(a.means, c.means)


def test_the_bytes_of_the_file_are_in_the_key(tmp_path) -> None:
    key = describe(LoadMesh(box_file(tmp_path / "a.obj")))
    assert describe(LoadMesh(box_file(tmp_path / "b.obj"))) == key
    assert describe(LoadMesh(box_file(tmp_path / "a.obj", faces=[[0, 1, 2]]))) != key


@pytest.mark.parametrize("text", ["", "v 0 0 0\nv 1 0 0\nf 1 2 1", "f 1 2 9", "v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3"])
def test_a_broken_mesh_is_one_line(text, tmp_path) -> None:
    pytest.importorskip("trimesh")
    (tmp_path / "m.obj").write_text(text)
    with pytest.raises(ValueError, match=r"is no mesh that can be read|has no surface") as caught:
        LoadMesh(str(tmp_path / "m.obj"))(LOOK)
    assert "\n" not in str(caught.value)


def test_without_trimesh_its_extra_is_named(tmp_path, monkeypatch) -> None:
    from diffuphy.explain import explain

    monkeypatch.setitem(sys.modules, "trimesh", None)
    with pytest.raises(ModuleNotFoundError) as caught:
        LoadMesh(box_file(tmp_path / "box.obj"))(LOOK)
    assert explain(caught.value, [], tmp_path) == "trimesh is not installed; run: pip install 'diffuphy[mesh]'"


@pytest.mark.parametrize(
    ("settings", "says"),
    [({"count": 0}, "count must be at least 1"), ({"opacity": 1.0}, "opacity in"), ({"sh_degree": 1}, "sh_degree 0"),
     ({"path": "x.glb"}, "there is no file x.glb"), ({"up": "up"}, "up must be one of")],
)  # fmt: skip
def test_a_wrong_setting_is_refused(settings, says, tmp_path) -> None:
    with pytest.raises(ValueError, match=says):
        LoadMesh(**{"path": box_file(tmp_path / "box.obj")} | settings)
    (tmp_path / "box.fbx").write_bytes(b"x")
    with pytest.raises(ValueError, match=r"must be one of \.glb"):
        LoadMesh(str(tmp_path / "box.fbx"))
