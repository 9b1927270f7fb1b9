"""The files of a run, read again by programs of others."""

import dataclasses
import json
import math
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from diffuphy.export import main
from diffuphy.formats import FORMATS, Options, Run, check, write
from diffuphy.formats.page import thinned
from diffuphy.formats.run import absorbed, said
from diffuphy.formats.splats import find
from diffuphy.formats.surface import density, level, surface
from diffuphy.geometry import covariances
from diffuphy.render import sh
from diffuphy.render.film.around import together
from diffuphy.render.scenes import ply
from diffuphy.types import Camera, Clip, Gaussians, MaterialField, Particles, Trajectory

R = 0.2
"""Radius of the ball [m]."""
FRAMES = 4


def lattice(inside, spacing: float, reach: float) -> torch.Tensor:
    """Points of a cubic lattice where ``inside`` holds."""
    line = torch.arange(-reach, reach, spacing) + spacing / 2
    x = torch.cartesian_prod(line, line, line)
    return x[inside(x)]


def made(folder: Path, degree: int = 0) -> Path:
    """A run's folder: a red ball of matter that falls and is stretched by 1.2."""
    spacing = R / 8
    inner = lattice(lambda x: x.norm(dim=1) < R, spacing, R)
    g = torch.Generator().manual_seed(0)
    d = torch.nn.functional.normalize(torch.randn(300, 3, generator=g), dim=1)
    color = sh.from_rgb(torch.tensor([0.9, 0.1, 0.1])).expand(300, 1, 3)
    rest = 0.1 * torch.randn(300, (degree + 1) ** 2 - 1, 3, generator=g)
    gaussians = Gaussians(
        d, torch.randn(300, 4, generator=g), math.log(0.1) + 0.3 * torch.randn(300, 3, generator=g),
        torch.full((300,), 3.0), torch.cat([color, rest], 1),
    )  # fmt: skip
    n = len(inner)
    volume = torch.full((n,), 4 / 3 * math.pi * R**3 / n)
    particles = Particles(inner, volume, torch.full((n,), -1), R, (0.0, 0.0, 0.0), spacing)
    grow = torch.diag_embed(torch.tensor([1.2, 1.0, 1 / 1.2])).expand(n, 3, 3)
    F = torch.stack([torch.eye(3).expand(n, 3, 3), *[grow] * (FRAMES - 1)])
    x = (F @ inner[None, :, :, None])[..., 0] + torch.tensor([0.0, 0.0, 0.5])
    field = MaterialField(
        ("hencky",),
        ("identity",),
        torch.ones(n, 1),
        torch.ones(n, 1),
        {"E": torch.full((n,), 1e5)},
        torch.full((n,), 1e3),
    )
    results = {
        "gaussians": gaussians, "particles": particles, "material": field,
        "trajectory": Trajectory(x, torch.zeros_like(x), F, 30.0),
        "clip": Clip(torch.rand(FRAMES, 16, 24, 3, generator=g), 30.0, slow=2.0),
    }  # fmt: skip
    for number, (name, result) in enumerate(results.items(), 2):
        place = folder / "store" / name
        place.mkdir(parents=True)
        result.save(place)
        (folder / f"{number}_{name}").symlink_to(place, target_is_directory=True)
    return folder


@pytest.fixture
def run(tmp_path: Path) -> Run:
    return dataclasses.replace(Run.at(made(tmp_path / "run")), title="a red ball falling")


def test_a_deformed_gaussian_is_written_as_one_that_is_not() -> None:
    """R' S'² R'ᵀ = F R S² Rᵀ Fᵀ, and colours seen from d are those at rest seen from polar(F)ᵀ d."""
    g = torch.Generator().manual_seed(0)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=g, dtype=torch.float64)

    rest = Gaussians(normal(50, 3), normal(50, 4), 0.3 * normal(50, 3), normal(50), 0.2 * normal(50, 16, 3))
    F = torch.linalg.matrix_exp(0.4 * normal(50, 3, 3))
    now = absorbed(rest, rest.means, F)
    expected = covariances(rest.quats, rest.log_scales.exp(), F)
    torch.testing.assert_close(covariances(now.quats, now.log_scales.exp()), expected, rtol=1e-10, atol=1e-12)
    camera = Camera(torch.eye(4).double()[None], torch.eye(3).double()[None], 4, 4)
    seen = sh.colors(rest.sh, rest.means, camera, F), sh.colors(now.sh, rest.means, camera)
    torch.testing.assert_close(*seen, rtol=0, atol=1e-10)


@pytest.mark.parametrize("up", ["y_down", "y_up", "z_up"])
def test_ply_frames_hold_the_gaussians_of_each_moment(run: Run, tmp_path: Path, up: str) -> None:
    """Read again they are in metres where the film has them, whatever axes the file has."""
    (folder,) = write(run, ["ply"], Options(tmp_path / "out", up, every=3))["ply"]  # type: ignore[arg-type]
    assert sorted(f.name for f in folder.iterdir()) == ["frame_0000.ply", "frame_0003.ply"]
    again = ply.read(folder / "frame_0003.ply", up=up)  # type: ignore[arg-type]
    means, F = run.moved(3)
    torch.testing.assert_close(again.means, means, rtol=0, atol=1e-6)
    rest = run.skin.gaussians
    expected = covariances(rest.quats, rest.log_scales.exp(), F)
    torch.testing.assert_close(covariances(again.quats, again.log_scales.exp()), expected, rtol=1e-4, atol=1e-9)


class Stand:
    """Gaussians around the object [object units], and the ground they stand on."""

    def __init__(self, count: int):
        g = torch.Generator().manual_seed(1)
        self.gaussians = Gaussians(
            3 * torch.randn(count, 3, generator=g), torch.randn(count, 4, generator=g),
            torch.full((count, 3), -2.0), torch.full((count,), 2.0), torch.randn(count, 1, 3, generator=g),
        )  # fmt: skip

    def rest(self) -> Gaussians | None:
        return self.gaussians

    def floor(self) -> float | None:
        return -1.0


def test_what_stands_around_is_in_every_file_of_gaussians_where_the_film_has_it(run: Run, tmp_path: Path) -> None:
    """x = scale (means − ground), in each .ply beside the object, in the arrays once; ``around=False`` leaves it
    out."""
    count = len(run.gaussians)
    for around, more in ((None, 0), (Stand(40), 40)):
        scene = dataclasses.replace(run, around=around)
        (folder,) = write(scene, ["ply"], Options(tmp_path / "out", every=3))["ply"]
        frames = [ply.read(folder / f"frame_{t:04d}.ply") for t in (0, 3)]
        assert [len(g) for g in frames] == [count + more] * 2
        if more:
            want = R * (Stand(40).gaussians.means + torch.tensor([0.0, 0.0, 1.0]))
            for g in frames:
                torch.testing.assert_close(g.means[count:], want, rtol=0, atol=1e-5)
        (file,) = write(scene, ["npz"], Options(tmp_path / "out"))["npz"]
        with np.load(file) as arrays:
            about = json.loads(str(arrays["about"]))["arrays"]
            assert ("around_means" in arrays) == ("around_means" in about) == bool(more)
            if more:
                np.testing.assert_allclose(arrays["around_means"], want, rtol=0, atol=1e-6)
    (folder,) = write(scene, ["ply"], Options(tmp_path / "alone", every=3, around=False))["ply"]
    assert len(ply.read(folder / "frame_0003.ply")) == count


def test_a_finished_run_knows_what_stood_around_its_object(tmp_path: Path) -> None:
    """From its own settings: the Gaussians of the file outside the region that moves; a made object has nothing."""
    folder = made(tmp_path / "run")
    assert Run.at(folder).still is None
    scene = tmp_path / "scene.ply"
    thing, beside = Stand(60).gaussians, Stand(25).gaussians
    ply.write(scene, together(thing, dataclasses.replace(beside, means=beside.means + 100.0)), up="z_up")
    (folder / ".hydra").mkdir()
    (folder / ".hydra" / "config.yaml").write_text(
        "prompt: a thing falling\nstages:\n  clip:\n    around:\n      _target_: diffuphy.text2gs.load.LoadGaussians\n"
        f"      path: {scene}\n      up: z_up\n      region: [-20, 20, -20, 20, -20, 20]\n"
    )
    run = Run.at(folder)
    assert run.title == "a thing falling" and run.still is not None and len(run.still) == 25


def test_npz_says_what_is_in_it_and_moves_gaussians_with_numpy_alone(run: Run, tmp_path: Path) -> None:
    """x_g = Σ_k share (x + F arm), Σ = F A Fᵀ: the recipe of the file's own description gives the frames of the
    film."""
    (file,) = write(run, ["npz"], Options(tmp_path))["npz"]
    with np.load(file, allow_pickle=False) as data:
        about = json.loads(str(data["about"]))
        assert about["title"] == "a red ball falling" and "slow motion 2x" in about["comment"]
        assert set(data.files) - {"about"} == set(about["arrays"]) - {"Fe"}
        np.testing.assert_allclose(data["time"], np.arange(FRAMES) / 30)
        x, F, i = data["x"][2], data["F"][2], data["follows"]
        means = (data["share"][..., None] * (x[i] + np.einsum("gkij,gkj->gki", F[i], data["arm"]))).sum(1)
        np.testing.assert_allclose(means, run.moved(2)[0].numpy(), rtol=0, atol=1e-6)
        assert data["density"].tolist() == [1e3] * len(run.particles)


def test_films_and_pictures_are_written_with_their_words(run: Run, tmp_path: Path) -> None:
    """Every film format, at the speed of slow motion: 30 frames a second of physics are 15."""
    import imageio_ffmpeg

    done = write(run, ["mp4", "webm", "gif", "png"], Options(tmp_path))
    for kind in ("mp4", "webm"):
        said_ = subprocess.run(
            [imageio_ffmpeg.get_ffmpeg_exe(), "-i", str(done[kind][0])], capture_output=True, text=True, check=False
        ).stderr
        assert "a red ball falling" in said_ and "slow motion 2x" in said_ and "15 fps" in said_
    assert len(list(done["png"][0].iterdir())) == FRAMES


# ---------------------------------------------------------------------- surface
BALL = (lambda x: x.norm(dim=1) < R, 4 / 3 * math.pi * R**3)
RING, TUBE = 0.2, 0.08
TORUS = (
    lambda x: (x[:, :2].norm(dim=1) - RING) ** 2 + x[:, 2] ** 2 < TUBE**2,
    2 * math.pi**2 * RING * TUBE**2,
)


@pytest.mark.parametrize(("inside", "volume", "euler"), [(*BALL, 2), (*TORUS, 0)], ids=["ball", "torus"])
def test_a_closed_surface_is_watertight_and_has_the_volume(inside, volume: float, euler: int) -> None:
    """By trimesh: closed, turned outwards, V − E + F = 2 − 2 · genus, volume within 2 %.

    The level keeps the volume as counted in nodes; chords of cells of Δx lie inside a tube of radius a by Δx²/8a at
    most, Δx²/4a² = 0.4 % of its volume, and counting errs by a part of the nodes on the surface.
    """
    trimesh = pytest.importorskip("trimesh")
    spacing = 0.0125
    x = lattice(inside, spacing, 0.3)
    each = torch.full((len(x),), volume / len(x))  # the lattice's own error is not that of the surface
    vertices, faces = level(x, each, 0.01, spacing)
    mesh = trimesh.Trimesh(vertices.numpy(), faces.numpy(), process=False)
    assert mesh.is_watertight and mesh.is_winding_consistent and mesh.euler_number == euler
    assert mesh.volume == pytest.approx(volume, rel=0.02)


def test_density_is_conserved_and_one_inside() -> None:
    """Σ φ Δx³ = Σ V to float32's sums; deep inside a lattice φ = 1 up to the ripple 6 exp(−2π² σ²/h²) of σ = h."""
    x = lattice(BALL[0], 0.0125, 0.3)
    phi, origin = density(x, torch.full((len(x),), 0.0125**3), 0.00625, 0.0125)
    assert float(phi.double().sum()) * 0.00625**3 == pytest.approx(len(x) * 0.0125**3, rel=1e-5)
    middle = ((torch.zeros(3) - origin) / 0.00625).round().long().tolist()
    assert float(phi[tuple(middle)]) == pytest.approx(1.0, abs=1e-3)


def test_a_mesh_has_the_colour_of_its_gaussians_and_moves_with_them(run: Run) -> None:
    """Red, 0.5 m up, as long in x as the ball that is stretched by 1.2, to a cell."""
    mesh = surface(run, 3, 40)
    torch.testing.assert_close(mesh.colors, torch.tensor([0.9, 0.1, 0.1]).expand_as(mesh.colors), rtol=0, atol=1e-5)
    cell = 2 * R / 40
    assert float(mesh.vertices[:, 0].max()) == pytest.approx(1.2 * R, abs=2 * cell)
    assert float(mesh.vertices[:, 2].mean()) == pytest.approx(0.5, abs=cell)


@pytest.mark.parametrize("kind", ["glb", "obj", "mesh.ply"])
def test_meshes_are_read_by_trimesh(run: Run, tmp_path: Path, kind: str) -> None:
    """Closed, coloured, up along y in glTF and along z elsewhere."""
    trimesh = pytest.importorskip("trimesh")
    (folder,) = write(run, [kind], Options(tmp_path, every=FRAMES, resolution=24))[kind]
    (file,) = folder.iterdir()
    mesh = trimesh.load_mesh(file)
    assert mesh.is_watertight and mesh.volume == pytest.approx(4 / 3 * math.pi * R**3, rel=0.1)  # 24 cells
    up = 1 if kind == "glb" else 2
    assert mesh.bounds.mean(0)[up] == pytest.approx(0.5, abs=0.02)
    assert np.abs(mesh.visual.vertex_colors[:, :3].mean(0) - [229.5, 25.5, 25.5]).max() < 2


def test_matter_that_came_apart_has_no_surface() -> None:
    x = torch.rand(20, 3, generator=torch.Generator().manual_seed(0))
    with pytest.raises(ValueError, match="there is no surface"):
        level(x, torch.full((20,), 1e-6), 0.05, 0.05)
    with pytest.raises(ValueError, match="has spread far"):
        level(torch.tensor([[0.0, 0, 0], [1e3, 1e3, 1e3]]), torch.ones(2), 0.01, 0.01)


# ---------------------------------------------------------------------- the page, and programs of others
def test_thinning_keeps_what_covers_most() -> None:
    """Of a large and a small Gaussian the large one stays, of an opaque and a clear one the opaque one."""
    scales = torch.tensor([[0.1, 0.1, 0.1], [0.2, 0.2, 0.01], [0.1, 0.1, 0.1], [1.0, 0.001, 0.001]])
    g = Gaussians(
        torch.zeros(4, 3), torch.zeros(4, 4), scales.log(), torch.tensor([2.0, 0.0, -6.0, 0.0]), torch.zeros(4, 1, 3)
    )
    assert thinned(g, 2).tolist() == [0, 1] and thinned(g, 9).tolist() == [0, 1, 2, 3]


def test_a_page_plays_the_motion(run: Run, tmp_path: Path) -> None:
    """One file that names no other address than those of its own licences."""
    pytest.importorskip("viser")
    (file,) = write(run, ["html"], Options(tmp_path, gaussians=100, page_frames=2))["html"]
    text = file.read_text(encoding="utf-8")
    assert "__VISER_EMBED_DATA__" in text and '<script src="http' not in text and 'href="http' not in text


def test_a_page_holds_what_stands_around_once(run: Run, tmp_path: Path) -> None:
    """Eight words a Gaussian, half precision in part and compressed: at least eight bytes each, however many frames."""
    pytest.importorskip("viser")
    sizes = [
        write(dataclasses.replace(run, around=around), ["html"], Options(tmp_path, gaussians=2000, **more))["html"][0]
        .stat()
        .st_size
        for around, more in (
            (None, {}),
            (Stand(4000), {}),
            (Stand(4000), {"page_frames": 1}),
            (None, {"page_frames": 1}),
        )
    ]
    plain, whole, whole_still, still = sizes
    assert whole - plain > 8 * 2000
    assert abs((whole - plain) - (whole_still - still)) < 0.1 * (whole - plain)


@pytest.mark.slow
def test_a_page_is_drawn_by_a_browser_without_the_network(run: Run, tmp_path: Path) -> None:
    """Headless Chromium, software WebGL: nothing is requested, and the ball is red in the middle."""
    pytest.importorskip("viser")
    api = pytest.importorskip("playwright.sync_api")
    chromium = shutil.which("chromium")
    if chromium is None:
        pytest.skip("no Chromium")
    (file,) = write(run, ["html"], Options(tmp_path))["html"]
    flags = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]
    with api.sync_playwright() as p:
        browser = p.chromium.launch(executable_path=chromium, args=flags)
        page = browser.new_page(viewport={"width": 400, "height": 300})
        asked: list[str] = []
        page.on("request", lambda request: asked.append(request.url))
        page.goto(file.as_uri())
        page.wait_for_timeout(8000)
        page.screenshot(path=str(tmp_path / "page.png"))
        browser.close()
    from PIL import Image

    with Image.open(tmp_path / "page.png") as picture:
        rgb = np.asarray(picture.convert("RGB")).astype(int)
    assert ((rgb[..., 0] > 150) & (rgb[..., 1] < 90)).sum() > 500
    assert [url for url in asked if not url.startswith(("file:", "data:", "blob:"))] == []


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["spz", "sog", "compressed.ply"])
def test_splat_transform_reads_and_compresses_our_gaussians(run: Run, tmp_path: Path, kind: str) -> None:
    """Compressed and made plain again by splat-transform: as many, each within a hundredth of the size of ours."""
    if shutil.which("splat-transform") is None:
        pytest.skip("npm install -g @playcanvas/splat-transform")
    (folder,) = write(run, [kind], Options(tmp_path, every=FRAMES))[kind]
    plain = tmp_path / "plain.ply"
    subprocess.run([find(), "-q", folder / f"frame_0000.{kind}", plain], check=True)
    again, ours = ply.read(plain), run.frame(0)
    assert len(again) == len(ours)
    nearest = torch.cdist(again.means, ours.means).amin(1)
    assert nearest.max() < 0.01 * 2 * R


# ---------------------------------------------------------------------- errors
def test_what_is_missing_is_named_with_its_remedy(run: Run, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ValueError, match="npm install -g @playcanvas/splat-transform"):
        write(run, ["spz"], Options(tmp_path))
    for package, kind, extra in (("viser", "html", "viewer"), ("trimesh", "glb", "mesh")):
        monkeypatch.setitem(sys.modules, package, None)
        with pytest.raises(ValueError, match=rf"pip install 'diffuphy\[{extra}\]'"):
            write(run, [kind], Options(tmp_path))
    with pytest.raises(ValueError, match="outputs are mp4, webm"):
        check(["avi"])
    shorter = Run({"prompt": tmp_path})
    with pytest.raises(ValueError, match="the run has no clip"):
        write(shorter, ["mp4"], Options(tmp_path))


def test_the_command_writes_lists_and_refuses(tmp_path: Path, capsys) -> None:
    """Status 0 with path and size of each file; status 2 and one line for what is not there."""
    folder = made(tmp_path / "run")
    assert main([str(folder)]) == 0
    listed = capsys.readouterr().out
    assert all(name in listed for name in FORMATS)
    assert main([str(folder), "npz", "-o", str(tmp_path / "out")]) == 0
    assert "trajectory.npz" in capsys.readouterr().out and (tmp_path / "out" / "trajectory.npz").exists()
    for arguments, says in (
        ([str(tmp_path / "none"), "mp4"], "is no run"),
        ([str(folder), "avi"], "got 'avi'"),
        ([str(folder), "ply", "--up", "x"], "up must be one of"),
        ([str(folder), "ply", "--every", "0"], "must be at least 1"),
        ([str(folder), "glb", "--resolution", "3"], "between 8 and 512"),
    ):
        assert main(arguments) == 2
        assert says in capsys.readouterr().err


def test_metadata_say_how_fast_a_film_is_played() -> None:
    assert "30 frames a second of physical time; played at 30 frames a second, real time" in said("", 30.0, 1.0)
    assert "slow motion 4x" in said("p", 120.0, 4.0) and "played at 30 frames" in said("p", 120.0, 4.0)
    assert "time lapse 2x" in said("p", 30.0, 0.5) and said("p", 30.0, 1.0, "J").endswith("view: J")
