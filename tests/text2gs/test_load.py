"""Gaussians of one's own as the object of the film."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
import torch

from diffuphy.artifact import describe
from diffuphy.geometry import covariances
from diffuphy.render import orbit, render_gaussians
from diffuphy.render.scenes import ply
from diffuphy.render.scenes.placement import Placement
from diffuphy.text2gs.load import LoadGaussians
from diffuphy.types import Gaussians, Look
from diffuphy.workspace import Workspace
from tests.captured import write_scene

LOOK = Look("bear", "a bear")


def scene(count: int = 200, degree: int = 1) -> Gaussians:
    """Points in the unit cube about (3, 2, 1), z up, sizes a tenth of it, opaque."""
    g = torch.Generator().manual_seed(0)
    means = torch.rand(count, 3, generator=g) - 0.5 + torch.tensor([3.0, 2.0, 1.0])
    quats, scales = torch.randn(count, 4, generator=g), math.log(0.1) + 0.3 * torch.randn(count, 3, generator=g)
    return Gaussians(
        means, quats, scales, torch.full((count,), 2.0), 0.3 * torch.randn(count, (degree + 1) ** 2, 3, generator=g)
    )


@pytest.fixture
def path(tmp_path: Path) -> str:
    ply.write(tmp_path / "scene.ply", scene(), up="z_up")
    return str(tmp_path / "scene.ply")


def test_the_object_is_centred_and_two_long(path) -> None:
    """max side = 2 and middle = 0, by float32 rounding of numbers of at most 2; sizes grow in proportion."""
    g, s = LoadGaussians(path, up="z_up")(LOOK), scene()
    low, high = g.means.amin(0), g.means.amax(0)
    assert abs(float((high - low).amax()) - 2) < 1e-6 and float((high + low).abs().amax()) < 1e-6
    scale = 2 / (s.means.amax(0) - s.means.amin(0)).amax()
    torch.testing.assert_close(g.log_scales, s.log_scales + scale.log(), rtol=0, atol=1e-6)
    assert torch.equal(g.quats, s.quats) and torch.equal(g.sh, s.sh)


def test_what_a_run_leaves_is_what_the_next_one_reads(path, tmp_path) -> None:
    """gaussians.ply of a run, read with the default axes, is the same object: rounding of numbers of at most 2."""
    g = LoadGaussians(path, up="z_up")(LOOK)
    ply.write(tmp_path / "gaussians.ply", g)
    back = LoadGaussians(str(tmp_path / "gaussians.ply"))(LOOK)
    for name in ("means", "quats", "log_scales", "logit_opacities", "sh"):
        torch.testing.assert_close(getattr(back, name), getattr(g, name), rtol=0, atol=2e-6, msg=name)


@pytest.mark.parametrize("up", ["z_up", "y_up", "y_down"])
def test_up_names_the_axes_of_the_file(up, tmp_path) -> None:
    """The same object in three files gives the same Gaussians: covariances and colours turn along."""
    ply.write(tmp_path / "a.ply", scene(), up="z_up")
    ply.write(tmp_path / "b.ply", scene(), up=up)
    a, b = (LoadGaussians(str(tmp_path / n), up=u)(LOOK) for n, u in (("a.ply", "z_up"), ("b.ply", up)))
    torch.testing.assert_close(b.means, a.means, rtol=0, atol=1e-5)  # float32 there and back, at distance 4
    A, B = (covariances(g.quats, g.log_scales.exp()) for g in (a, b))
    torch.testing.assert_close(B, A, rtol=0, atol=1e-5)
    torch.testing.assert_close(b.sh, a.sh, rtol=0, atol=1e-5)


def test_turns_come_after_up_and_in_order(tmp_path) -> None:
    """90° about x and then 90° about z take (x, y, z) to (−(−z), x, y) = (z, x, y)."""
    s = scene(degree=0)
    ply.write(tmp_path / "g.ply", s, up="y_up")
    g = LoadGaussians(str(tmp_path / "g.ply"), up="y_up", turns=[["x", 90], ["z", 90]])(LOOK)  # type: ignore[list-item]
    plain = LoadGaussians(str(tmp_path / "g.ply"), up="y_up")(LOOK)
    torch.testing.assert_close(g.means, plain.means[:, [2, 0, 1]], rtol=0, atol=1e-5)


def test_haze_and_broken_gaussians_are_removed_and_counted(tmp_path) -> None:
    """Opacities below the threshold, numbers that are not finite, no orientation."""
    s = scene(20)
    ply.write(tmp_path / "g.ply", s, up="z_up")
    data = bytearray((tmp_path / "g.ply").read_bytes())
    row, start = 4 * (17 + 9), data.index(b"end_header\n") + 11

    def put(i: int, column: int, *values: float) -> None:
        at = start + i * row + 4 * column
        data[at : at + 4 * len(values)] = torch.tensor(values).numpy().tobytes()

    put(1, 0, math.nan), put(2, 18, -5.0), put(3, 22, 0.0, 0.0, 0.0, 0.0), put(4, 19, 200.0), put(5, 9, -math.inf)
    (tmp_path / "g.ply").write_bytes(data)
    work = Workspace(tmp_path / "work")
    g = LoadGaussians(str(tmp_path / "g.ply"), up="z_up")(LOOK, work=work)
    kept = torch.tensor([0, *range(6, 20)])
    assert torch.equal(g.sh, s.sh[kept])
    log = "".join(p.read_text() for p in (tmp_path / "work").iterdir())
    assert '"broken": 4' in log and '"transparent": 1' in log, log


def test_a_region_is_the_object_and_the_rest_stands_still(path) -> None:
    """The two together are the whole scene, moved by one similarity: the picture of both is that of the whole."""
    region = (2.5, 3.2, 1.5, 2.3, 0.5, 1.6)
    load = LoadGaussians(path, up="z_up", region=region)
    g, rest, s = load(LOOK), load.rest(), scene()
    assert rest is not None
    inside = ((s.means >= torch.tensor(region[::2])) & (s.means <= torch.tensor(region[1::2]))).all(1)
    assert len(g) == int(inside.sum()) and len(rest) == int((~inside).sum())
    ratio = [
        (torch.cdist(a.means, a.means)[0, 1:] / torch.cdist(b, b)[0, 1:]).mean()
        for a, b in ((g, s.means[inside]), (rest, s.means[~inside]))
    ]
    torch.testing.assert_close(ratio[0], ratio[1], rtol=1e-5, atol=0)
    low, high = s.means[inside].amin(0), s.means[inside].amax(0)
    torch.testing.assert_close(rest.means, ratio[0] * (s.means[~inside] - (low + high) / 2), rtol=0, atol=1e-5)
    assert LoadGaussians(path, up="z_up").rest() is None
    with pytest.raises(ValueError, match=r"no Gaussian lies in gaussians.region .* the scene reaches from \[2.5"):
        LoadGaussians(path, up="z_up", region=(0, 1, 0, 1, 0, 1))(LOOK)


def test_a_floater_does_not_make_the_object_small(tmp_path) -> None:
    """One of 2000 Gaussians, far away: the box holds all but a thousandth at each end."""
    s = scene(2000, 0)
    s.means[7] = torch.tensor([500.0, 0.0, 0.0])
    ply.write(tmp_path / "g.ply", s, up="z_up")
    g = LoadGaussians(str(tmp_path / "g.ply"), up="z_up")(LOOK)
    low, high = (g.means.kthvalue(k, dim=0).values for k in (3, 1998))
    assert abs(float((high - low).amax()) - 2) < 1e-5


def test_what_float32_cannot_hold_at_the_objects_scale_is_an_error(tmp_path) -> None:
    """3e38 is a number in the file, and none when the object of 1e-3 is made 2 long."""
    s = scene(2000, 0)
    s.means.mul_(1e-3)[7] = 3e38
    ply.write(tmp_path / "g.ply", s, up="z_up")
    with pytest.raises(ValueError, match="1 Gaussians are so large or far away"):
        LoadGaussians(str(tmp_path / "g.ply"), up="z_up")(LOOK)


def test_cameras_see_the_object_as_they_saw_the_scene(tmp_path) -> None:
    """render(object, cameras in its frame) = render(scene, cameras of the file)."""
    s = scene()
    camera = orbit([30.0, 100.0], [10.0, 40.0], 3.0, width=32, height=24, at=(3.0, 2.0, 1.0))
    turn = torch.eye(4)
    turn[:3, :3] = torch.tensor([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # from y-down axes to z-up: (x, z, −y)
    home = dataclasses.replace(camera, viewmats=camera.viewmats @ turn)
    load = LoadGaussians(str(write_scene(tmp_path / "scene", s, home)), turns=(("z", 25.0),))
    g = load(LOOK)
    ours = torch.cat([render_gaussians(g, c).rgb for c in load.cameras()])
    # colours of about 1, rounded at 1e-6 by the fit of the coefficients; edges of the cut-off shift by rounding
    torch.testing.assert_close(ours, render_gaussians(s, camera).rgb, rtol=1e-4, atol=5e-4)


def test_the_bytes_of_the_file_are_in_the_key_and_its_name_is_not(path, tmp_path) -> None:
    """Another content, another key; the same content elsewhere, or under another name, the same key."""
    key = describe(LoadGaussians(path))
    ply.write(tmp_path / "copy.ply", scene(), up="z_up")
    assert describe(LoadGaussians(str(tmp_path / "copy.ply"))) == key
    (tmp_path / "folder/point_cloud/iteration_7").mkdir(parents=True)
    ply.write(tmp_path / "folder/point_cloud/iteration_7/point_cloud.ply", scene(), up="z_up")
    assert describe(LoadGaussians(str(tmp_path / "folder"))) == key
    changed = scene()
    changed.means[0, 0] += 1e-3
    ply.write(path, changed, up="z_up")
    assert describe(LoadGaussians(path)) != key


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"up": "x_up"}, "up must be one of z_up, y_up, y_down"),
        ({"turns": (("w", 90),)}, "turns must be a list of"),
        ({"turns": (("x", math.inf),)}, "turns must be a list of"),
        ({"region": (0, 1, 2, 1, 0, 1)}, "region must be .* with min < max"),
        ({"region": (0, 1, 0, 1)}, "region must be"),
        ({"min_opacity": 1.0}, "min_opacity must be in"),
        ({"sh_degree": 4}, "sh_degree must be 0, 1, 2 or 3"),
        ({"max_gaussians": 100}, "has 200 Gaussians, more than 100; raise max_gaussians"),
        ({"path": "nowhere.ply"}, "there is no file nowhere.ply"),
    ],
)
def test_a_wrong_setting_is_refused_before_anything_runs(settings, says, path) -> None:
    with pytest.raises(ValueError, match=says):
        LoadGaussians(**{"path": path} | settings)


def test_an_object_without_extent_is_an_error(tmp_path) -> None:
    s = scene(5)
    ply.write(tmp_path / "g.ply", dataclasses.replace(s, means=torch.ones(5, 3)))
    with pytest.raises(ValueError, match="lie in one point"):
        LoadGaussians(str(tmp_path / "g.ply"))(LOOK)


# --------------------------------------------------------------------------- what is the object
def table_scene(folder: Path, tilt: float = 0.0) -> tuple[str, Gaussians]:
    """200 Gaussians in the unit cube about (3, 2, 1) over a ground of 300 at z = 0.4, z up; turned about x [deg]."""
    r = torch.Generator().manual_seed(2)
    top = scene(200)
    flat = torch.rand(300, 3, generator=r) * torch.tensor([6.0, 6.0, 0.0]) + torch.tensor([0.0, -1.0, 0.4])
    names = [f.name for f in dataclasses.fields(Gaussians)]
    both = Gaussians(**{n: torch.cat([getattr(top, n), getattr(scene(300), n)]) for n in names})
    both = dataclasses.replace(both, means=torch.cat([top.means, flat]))
    both = Placement.turns([("x", tilt)])(both)
    ply.write(folder / "table.ply", both, up="z_up")
    return str(folder / "table.ply"), both


def test_a_mask_chooses_beside_the_region(tmp_path) -> None:
    """What is in both is the object; what is left is the rest, and nothing is lost."""
    path, g = table_scene(tmp_path)
    mask = torch.arange(500) % 2 == 0
    np.save(tmp_path / "mask.npy", mask.numpy())
    load = LoadGaussians(path, up="z_up", mask=str(tmp_path / "mask.npy"), region=(0, 6, 0, 6, 0.45, 2))
    chosen = mask & (g.means[:, 2] >= 0.45)
    found, rest = load(LOOK), load.rest()
    assert len(found) == int(chosen.sum()) and rest is not None and len(found) + len(rest) == 500
    assert torch.equal(found.sh, g.sh[chosen])


def test_labels_with_a_material_are_the_object(tmp_path) -> None:
    """Those without a word stand still; marks of haze go with it, so that the others stay in order."""
    g = scene(90)
    g.logit_opacities[::3] = -9.0  # haze
    ply.write(tmp_path / "a.ply", g, up="z_up")
    labels = torch.arange(90) % 4
    np.save(tmp_path / "l.npy", labels.numpy())
    load = LoadGaussians(
        str(tmp_path / "a.ply"), up="z_up", labels=str(tmp_path / "l.npy"), materials={1: "rubber", 3: "sand"}
    )
    keep = (torch.arange(90) % 3 > 0) & (labels % 2 == 1)
    assert torch.equal(load(LOOK).sh, g.sh[keep]) and torch.equal(load.kinds(), labels[keep])
    rest = load.rest()
    assert rest is not None and len(rest) == 60 - int(keep.sum())


@pytest.mark.parametrize(("tilt", "up"), [(0.0, "z_up"), (15.0, "z_up"), (140.0, "ground")])
def test_what_is_above_the_ground_is_the_object(tilt, up, tmp_path) -> None:
    """The ground is found and made level: the object is the same however the file was turned, but for a turn about the
    vertical, and its floor is the ground: 0.1 below the cube about (3, 2, 1), scaled as it is."""
    path, _ = table_scene(tmp_path, tilt)
    load = LoadGaussians(path, up=up, ground="found", turns=())
    g, rest, floor = load(LOOK), load.rest(), load.floor()
    assert len(g) == 200 and rest is not None and len(rest) == 300 and floor is not None
    s = scene().means
    scale = 2 / float((s.amax(0) - s.amin(0)).amax())
    # heights over the ground do not depend on the turn; the level one is good to the ground's fit, here exact points
    heights = torch.sort(g.means[:, 2] - floor).values / float(scale_of(g, s))
    torch.testing.assert_close(heights, torch.sort(s[:, 2] - 0.4).values, rtol=0, atol=5e-3)
    assert tilt or float(floor) == pytest.approx(scale * (0.4 - float(s[:, 2].amin() + s[:, 2].amax()) / 2), abs=1e-5)
    torch.testing.assert_close(rest.means[:, 2], torch.full((300,), floor), rtol=0, atol=1e-4)


def scale_of(g: Gaussians, s: torch.Tensor) -> torch.Tensor:
    """How much larger the placed object is, by its mean distance from its middle."""
    return (g.means - g.means.mean(0)).norm(dim=1).mean() / (s - s.mean(0)).norm(dim=1).mean()


def test_a_given_ground_cuts_without_turning(tmp_path) -> None:
    path, g = table_scene(tmp_path)
    load = LoadGaussians(path, up="z_up", ground=0.4)
    assert len(load(LOOK)) == 200 and torch.equal(load(LOOK).quats, g.quats[:200])


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"labels": "l.npy"}, "belong together"),
        ({"materials": {1: "rubber"}}, "belong together"),
        ({"labels": "l.npy", "materials": {9: "rubber"}}, "names the label 9"),
        ({"mask": "l.npy"}, "must be 0 and 1"),
        ({"mask": "n.npy"}, "there is no file"),
        ({"ground": "there"}, "must be 'found'"),
        ({"ground": math.inf}, "must be 'found'"),
        ({"up": "ground"}, "needs ground=found"),
        ({"up": "ground", "ground": "found", "turns": [["x", 90]]}, "needs ground=found"),
        ({"ground": 5.0}, "no Gaussian is in region and mask and above the ground"),
        ({"ground": "found"}, "no ground found"),
    ],
)
def test_parts_that_cannot_be_are_refused(settings, says, path, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    np.save("l.npy", torch.arange(200).remainder(4).numpy())
    with pytest.raises(ValueError, match=says):
        LoadGaussians(path, **{"up": "z_up"} | settings)(LOOK)
