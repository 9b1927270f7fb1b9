"""A scene of one's own, in the layout of the original code, becomes a film."""

import importlib.util
import json
import math
from pathlib import Path

import pytest
import torch

from diffuphy.cli import main
from diffuphy.mpm.sampling.sample import Sample
from diffuphy.render.film.around import with_scenery
from diffuphy.render.sh import from_rgb
from diffuphy.render.skin import Skin, to_metres
from diffuphy.text2gs.load import LoadGaussians
from diffuphy.types import Clip, Gaussians, Look, Motion, Particles
from diffuphy.workspace import Workspace
from tests.captured import write_scene

pytestmark = pytest.mark.usefixtures("quiet")


def bear_on_a_table() -> Gaussians:
    """An ellipsoid's surface, 0.6 x 0.4 x 0.4, red, on a green slab below z = 0.8; view-dependent colours."""
    r = torch.Generator().manual_seed(0)
    d = torch.nn.functional.normalize(torch.randn(900, 3, generator=r), dim=1)
    bear = d * torch.tensor([0.3, 0.2, 0.2]) + torch.tensor([1.0, -2.0, 1.0])
    table = torch.rand(300, 3, generator=r) * torch.tensor([2.0, 2.0, 0.02]) + torch.tensor([0.0, -3.0, 0.76])
    count = len(bear) + len(table)
    sh = torch.zeros(count, 4, 3)
    sh[:900, :1], sh[900:, :1] = from_rgb(torch.tensor([0.8, 0.1, 0.1])), from_rgb(torch.tensor([0.1, 0.8, 0.1]))
    sh[:, 1:] = 0.05 * torch.randn(count, 3, 3, generator=r)
    scales = torch.full((count, 3), math.log(0.02))
    scales[900:] = math.log(0.06)
    quats = torch.randn(count, 4, generator=r)
    return Gaussians(torch.cat([bear, table]), quats, scales, torch.full((count,), 4.0), sh)


REGION = "[0.6,1.4,-2.4,-1.6,0.795,1.3]"


def film(store: Path, path: Path, *settings: str) -> int:
    return main(["prompt=a 30 cm rubber bear falling", "gaussians=ply", f"gaussians.path={path}", "experiment=tiny",
                 f"gaussians.region={REGION}", f"store={store}", "device=cpu", *settings])  # fmt: skip


def folder(store: Path, stage: str) -> Path:
    (meta,) = store.glob(f"{stage}/*/meta.json")
    return meta.parent


@pytest.mark.slow
def test_a_trained_scene_becomes_a_film(tmp_path: Path) -> None:
    """Read, cut out, filled, simulated, filmed with what stands around it; 0.3 m long by the prompt."""
    store = tmp_path / "store"
    scene = write_scene(tmp_path / "scene", bear_on_a_table())
    assert film(store, scene) == 0
    particles = Particles.load(folder(store, "particles"))
    longest = float((particles.x.amax(0) - particles.x.amin(0)).amax())
    # the outermost centres are 0.3 m apart; matter ends one to two standard deviations outside, and a cell more
    assert 0 < longest - 0.3 < 2 * (2 * 0.02 * 0.3 / 0.6 + particles.spacing)
    clip = Clip.load(folder(store, "clip")).rgb
    green = (clip[..., 1] > clip[..., 0] + 0.2) & (clip[..., 1] > clip[..., 2] + 0.2)
    red = (clip[..., 0] > clip[..., 1] + 0.2) & (clip[..., 0] > clip[..., 2] + 0.2)
    assert green[0].any() and red[0].any()
    rows = torch.arange(clip.shape[1], dtype=torch.float32)
    row = [float((frame.sum(1) * rows).sum() / frame.sum()) for frame in red]
    # 0.8 of 0.3 m below, it lands after √(2 · 0.24 / 9.81) s = 6.6 frames, and bounces
    assert max(row) > row[0] + 3 and 6 <= row.index(max(row)) <= 9, row
    (run,) = (store / "runs").iterdir()
    plan = {line["what"]: line["decision"] for line in json.loads((run / "plan.json").read_text())}
    assert plan["score distillation"] == "left out" and plan["surroundings"] == "kept"
    assert (run / "film.mp4").stat().st_size > 1000


def test_a_changed_file_runs_again_and_a_moved_one_does_not(tmp_path: Path, caplog) -> None:
    """The stage's key holds what the file holds."""
    store, bear = tmp_path / "store", bear_on_a_table()

    def results() -> int:
        return len(list((store / "gaussians").glob("*/meta.json")))

    assert film(store, write_scene(tmp_path / "a", bear), "until=gaussians") == 0
    assert results() == 1
    (tmp_path / "a").rename(tmp_path / "b")
    assert film(store, tmp_path / "b", "until=gaussians") == 0
    assert results() == 1
    bear.sh[0, 0, 0] += 0.1
    assert film(store, write_scene(tmp_path / "c", bear), "until=gaussians") == 0
    assert results() == 2


def test_a_path_is_taken_as_it_is_typed(tmp_path: Path) -> None:
    """Commas, quotes, brackets, equals signs, dollars and letters of any script in a file name are no grammar."""
    path = write_scene(tmp_path / "it's {my} ${x} scène, a=b (熊)", bear_on_a_table())
    assert film(tmp_path / "store", path, "until=gaussians") == 0


def test_a_mesh_is_planned_by_its_group(tmp_path: Path, capsys) -> None:
    """``gaussians=mesh`` replaces the fit and leaves out the library; without trimesh it names the extra."""
    (tmp_path / "m.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    code = main(["prompt=a rubber bear falling", "gaussians=mesh", f"gaussians.path={tmp_path / 'm.obj'}",
                 "until=gaussians", "experiment=tiny", f"store={tmp_path / 'store'}", "device=cpu"])  # fmt: skip
    if importlib.util.find_spec("trimesh") is None:
        assert code == 2 and "pip install 'diffuphy[mesh]'" in capsys.readouterr().err
    else:
        assert code == 0 and len(Gaussians.load(folder(tmp_path / "store", "gaussians"))) == 8000


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        (["gaussians=ply"], "gaussians.path is missing; write gaussians.path=..."),
        (["gaussians=ply", "gaussians.path=nowhere.ply"], "there is no file nowhere.ply"),
        (["gaussians=ply", "gaussians.path=a.ply", "gaussians.regoin=[0,1]"], "did you mean gaussians.region?"),
        (["gaussians=ply", "gaussians.path=a.ply", "gaussians.turns=[[x]]"], "gaussians.turns must be a list of"),
        (["gaussians=obj"], "gaussians has no option 'obj'; the options are"),
    ],
)
def test_a_wrong_setting_is_one_line(settings, says, tmp_path, capsys, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["prompt=a bear falling", f"store={tmp_path}/store", *settings]) == 2
    said = capsys.readouterr().err
    assert says in said and said.count("\n") == 1, said


def test_what_stands_around_is_placed_about_the_standing_object(tmp_path: Path) -> None:
    """Object and rest keep their places to each other; the floor, z = 0, is where the object ends below.

    Matter ends one to two standard deviations outside the outermost centres (``Sample``), and a lattice cell more.
    """
    path = str(write_scene(tmp_path / "scene", bear_on_a_table()))
    load = LoadGaussians(path, region=tuple(json.loads(REGION)))
    bear, rest = load(Look("bear", "a bear")), load.rest()
    particles = Sample(cells=16)(bear, Motion("falling", "", size=0.3), work=Workspace())
    skin = Skin.bind(bear, particles)
    still = with_scenery(skin, load, particles).gaussians.means[len(bear) :]
    assert rest is not None and len(rest) == len(still) == 300
    up = still - to_metres(rest, particles).means
    torch.testing.assert_close(up, torch.tensor([0.0, 0.0, -float(particles.x[:, 2].amin())]).expand_as(up))
    top, sigma = float(still[:, 2].amax()), 0.02 * 0.3 / 0.6
    gap = (0.8 - 0.78) * 0.3 / 0.6  # between the centres of bear and table
    assert 0 < top + gap < 2 * sigma + particles.spacing
