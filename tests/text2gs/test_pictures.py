"""Pictures of one's own become Gaussians."""

import dataclasses
import json
from pathlib import Path

import pytest
import torch

from diffuphy.artifact import describe
from diffuphy.cli import main
from diffuphy.render import orbit
from diffuphy.text2gs.hull import hull
from diffuphy.text2gs.pictures import Pictures, images
from diffuphy.types import Gaussians, Look
from diffuphy.workspace import Workspace
from tests.photographed import rendered, write_pictures

LOOK = Look("thing", "a thing")


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("pictures")
    write_pictures(path)
    return path


def ball_silhouettes(radius: float, side: int) -> tuple[torch.Tensor, object]:
    """Coverage of a ball at (0.3, 0, 0.1) from 26 sides, by rays through the middles of pixels."""
    azimuths = [float(a) for e in (-60, -30, 0, 30, 60) for a in range(0, 360, 72)]
    elevations = [float(e) for e in (-60, -30, 0, 30, 60) for _ in range(5)]
    cameras = orbit(azimuths, elevations, 3.4, fov=50.0, width=side, height=side)
    centre = torch.tensor([0.3, 0.0, 0.1])
    u = torch.arange(side) + 0.5
    K = cameras.Ks[0]
    d = torch.stack(
        torch.broadcast_tensors((u - K[0, 2]) / K[0, 0], ((u - K[1, 2]) / K[1, 1])[:, None], torch.ones(1)), -1
    )
    masks = []
    for view in cameras.viewmats:
        c = view[:3, :3] @ centre + view[:3, 3]
        along = (d @ c) / d.norm(dim=-1)
        masks.append(((c @ c) - along**2 < radius**2).float())
    return torch.stack(masks), cameras


def test_the_hull_contains_the_object_and_little_more():
    """It holds every point of the ball that is deeper than a pixel and half a cell's diagonal, and exceeds the ball by
    what 25 cones leave: the polytope of 25 tangents has up to 30 % more."""
    masks, cameras = ball_silhouettes(0.7, 96)
    found = hull(masks, cameras)
    pixel = 3.4 * 2 * 0.4663 / 96
    distance = (found.cells - torch.tensor([0.3, 0.0, 0.1])).norm(dim=1)
    deep = 0.7 - pixel - 0.87 * found.side
    inside = 4 / 3 * torch.pi * deep**3 / found.side**3
    # lattice points in a ball: its volume, to about half of its surface times a cell
    assert float((distance < deep).sum()) > 0.98 * inside
    volume = len(found.cells) * found.side**3
    assert 0.95 < volume / (4 / 3 * torch.pi * 0.7**3) < 1.3
    low, high = found.box
    # a corner of three tangent planes lies at most 1/cos 36° out, half the angle between neighbouring cameras
    assert 2 * deep < float((high - low).amin()) and float((high - low).amax()) < 2 * 0.7 / 0.809 + 2 * found.side


def test_silhouettes_without_a_common_point_are_refused():
    masks, cameras = ball_silhouettes(0.7, 32)
    masks[3] = 0.0
    with pytest.raises(ValueError, match="no point is covered"):
        hull(masks, cameras)


def test_references_are_the_pictures_over_the_background(folder):
    """r = c + (1 − a) b for the cameras that ask, in their order."""
    pictures = Pictures(str(folder), size=32)
    rgb, a, _ = rendered("burger", 24, 32)
    colour = torch.tensor([0.2, 0.4, 0.8])
    camera = pictures()[[3, 0]]
    found, logits = pictures(LOOK, camera, colour)
    fitted = [i for i in range(24) if i % 8]
    for k, j in enumerate((3, 0)):
        i = fitted[j]
        expected = rgb[i] + (1 - a[i, ..., None]) * colour
        assert float((found[k, 0] - expected).abs().amax()) < 1.01 / 255 + 1e-6  # rounded to 8 bits, twice
    assert logits is None and found.shape == (2, 1, 32, 32, 3) and (pictures.bank, pictures.held) == (21, 3)


def test_the_object_is_centred_and_two_long(folder):
    """Its hull, by construction; and the object in it: 24 silhouettes of 32 px leave at most two pixels around."""
    found = Pictures(str(folder), size=32).hull
    low, high = found.box
    torch.testing.assert_close(low, -high)
    assert float((high - low).amax()) == pytest.approx(2.0)


def test_a_background_does_for_transparency(tmp_path, folder):
    """The same object over blue, which is none of its colours: hulls alike to a cell, pictures to the edge pixels."""
    write_pictures(tmp_path, background=(0.0, 0.0, 1.0))
    clear, blue = Pictures(str(folder), size=32), Pictures(str(tmp_path), size=32, background=(0.0, 0.0, 1.0))
    for a, b in zip(clear.hull.box, blue.hull.box, strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=4 * clear.hull.side)
    with pytest.raises(ValueError, match=r"gaussians\.background"):
        Pictures(str(tmp_path))()


def test_a_fit_of_pictures_predicts_those_held_out(folder):
    """PSNR of pictures never seen rises by at least 3 dB over that of the grey hull, a halving of the squared error,
    in 200 steps; at 96 px it reaches what docs/own_gaussians.md says."""
    fit = images(str(folder), size=32, count=800, steps=200)
    before = fit.init(LOOK, fit.guidance, torch.Generator().manual_seed(0))
    assert fit.judge is not None
    scores = [fit.judge.judge(g, fit.backend)["psnr_held_out"] for g in (before, fit(LOOK, work=Workspace()))]
    assert scores[1] > scores[0] + 3.0, scores


def test_the_key_follows_every_picture(tmp_path):
    """A changed picture is another result; a moved folder is not."""
    write_pictures(tmp_path / "a", count=8, side=16)
    first = describe(images(str(tmp_path / "a"), size=16))
    (tmp_path / "a").rename(tmp_path / "b")
    assert describe(images(str(tmp_path / "b"), size=16)) == first
    (tmp_path / "b" / "r_5.png").write_bytes((tmp_path / "b" / "r_4.png").read_bytes())
    assert describe(images(str(tmp_path / "b"), size=16)) != first


@pytest.mark.parametrize("wrong", [{"size": 4}, {"hold": 1}, {"background": (2.0, 0.0, 0.0)}, {"up": "left"}])
def test_settings_that_cannot_be_are_refused(wrong, folder):
    with pytest.raises(ValueError, match="must be"):
        dataclasses.replace(Pictures(str(folder)), **wrong)


@pytest.mark.usefixtures("quiet")
def test_pictures_are_fitted_from_the_command_line(tmp_path, folder):
    store = tmp_path / "store"
    settings = ["experiment=tiny", "gaussians.steps=3", "gaussians.size=16", "gaussians.count=100", "until=gaussians"]
    words = ["prompt=a 30 cm rubber bear falling", "gaussians=images", f"gaussians.path={folder}"]
    code = main([*words, *settings, f"store={store}", "device=cpu"])
    assert code == 0
    (meta,) = store.glob("gaussians/*/meta.json")
    assert len(Gaussians.load(meta.parent)) > 0
    (run,) = (store / "runs").iterdir()
    lines = {line["what"]: line["why"] for line in json.loads((run / "plan.json").read_text())}
    assert lines["pictures"] == "3 of them are held out and compared with at the end"
