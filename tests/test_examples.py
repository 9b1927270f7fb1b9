"""Every example runs, coarse and quick, and what it says is true."""

import importlib.util
from pathlib import Path

import pytest

from diffuphy.render.scenes import ply

EXAMPLES = Path(__file__).parents[1] / "examples"


def example(name: str):
    """An example as a module, as if it had been run from its folder."""
    spec = importlib.util.spec_from_file_location(f"example_{name}", EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def tiny(tmp_path, monkeypatch):
    """Settings of a quick film, in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    quick = ("experiment=tiny", "fit.steps=2", "fit.cameras.bank=2", "fit.cameras.size=24", "scene.seconds=0.4")
    small = ("sample.cells=10", "film.width=64", "film.height=64", "report.error=off", "evaluate.score=off")
    return (*quick, *small)


GIVEN = ("material=stated",)
"""No fit of a material: where an example is about something else."""
UNLEARNT = ("material.steps=0", "material.stiffness_steps=0")
"""A fit without its loops."""


def test_every_example_is_tested_and_listed():
    names = {p.stem for p in EXAMPLES.glob("*.py")}
    tested, listed = Path(__file__).read_text(), (EXAMPLES / "README.md").read_text()
    assert all(f'example("{n}")' in tested and f"{n}.py" in listed for n in names) and len(names) >= 10


def test_recover_stiffness():
    """Newton on the square root of the loss converges quadratically: five digits after six steps."""
    truth, path = example("recover_stiffness").main(150, 6)
    assert abs(path[-1] - truth) < 1e-3 and abs(path[0] - truth) > 0.1


def test_new_law():
    """It stiffens, so it is flattened less."""
    flattest = example("new_law").main(216)
    assert flattest["hencky"] < flattest["stiffening"] < 1


def test_sand_column(tmp_path):
    """Sand neither stays a column nor lies steeper than its friction angle, 35 degrees."""
    _, (reach, slope) = example("sand_column").main(100, 20, str(tmp_path))
    assert 0.12 < reach < 0.1 + 1.24 * 0.15 and 5 < slope < 35
    assert (tmp_path / "sand_column.mp4").stat().st_size > 1000


def test_moving_walls(tmp_path):
    """Behind the pin the dough is as thick as the gap, or up to a cell more: a wall is felt from a node before it."""
    thick = example("moving_walls").main(500, 36, str(tmp_path))
    dx = 2 * (0.30 * 0.20 * 0.10 / 500) ** (1 / 3)
    assert 0.05 <= thick < 0.05 + dx < 0.1 and (tmp_path / "moving_walls.png").exists()


def test_sentence(tiny):
    """It falls with g until it lands: z(t) = z(0) − g t²/2, which the third frame, at 0.1 s, is to three digits."""
    made = example("sentence").main(*tiny, *UNLEARNT)
    z = made.result("trajectory").x[:, :, 2].double().mean(1)
    assert abs(float(z[0] - z[3]) - 0.5 * 9.81 * 0.1**2) < 5e-5
    assert made.files["film"].stat().st_size > 1000 and made.folder.is_relative_to("outputs/examples")


def test_two_materials(tiny):
    """Rubber keeps its shape and honey does not, in one body: every particle has one of the two, and both are there."""
    made = example("two_materials").main(*tiny)
    field = made.result("material")
    share = dict(zip(field.plastic, field.w_p.mean(0).tolist(), strict=True))
    assert set(share) == {"identity", "viscoplastic"} and min(share.values()) > 0.2
    assert bool((field.w_p.max(1).values == 1).all())
    assert made.files["film"].with_name("film_material.mp4").exists()


def test_own_scene(tiny):
    """The duck of the file moves; what stands around it is not among its particles but is in the picture."""
    made = example("own_scene").main(*tiny, *GIVEN, "until=trajectory")
    scene = ply.read(Path("outputs/examples/duck.ply"))
    motion = made.result("trajectory")
    assert len(made.result("gaussians")) == 6000 < len(scene)
    assert motion.x[-1, :, 2].mean() < motion.x[0, :, 2].mean()


def test_mesh(tiny):
    """A tube of radius r about a curve of length L has the volume π r² L (Pappus). Particles fill it and reach at most
    their spacing beyond it: those of the surface lie on it with all of their volume."""
    pytest.importorskip("trimesh")
    made = example("mesh").main(*tiny, *GIVEN, "until=particles", "sample.cells=24")
    import trimesh

    knot = trimesh.load("outputs/examples/knot.glb", force="mesh")
    particles = made.result("particles")
    scale = 0.5 / knot.extents.max()  # its longest side is half a metre, the tube's radius half a length of the file
    filled = float(particles.vol.sum()) / (knot.volume * scale**3)
    assert knot.is_watertight and 0.95 < filled < (1 + particles.spacing / (0.5 * scale)) ** 2


def test_physgaussian_scene(tiny):
    """Held at its foot, pushed at its top: the foot stays, the top goes the way of the push."""
    motion = example("physgaussian_scene").main(*tiny, "sample.cells=12", "until=trajectory").result("trajectory")
    z = motion.x[0, :, 2]
    moved = (motion.x - motion.x[0])[..., 0]
    assert moved[:, z < z.quantile(0.1)].abs().max() < 1e-3 < 0.02 < moved[:, z > z.quantile(0.9)].mean(1).max()


def test_cameras_and_views(tiny):
    """Half as fast as physics, and a film for every view."""
    made = example("cameras_and_views").main(*tiny, *GIVEN, "film.also=[stress,J]")
    clip = made.result("clip")
    assert len(clip.rgb) == 13 and clip.slow == 2 and set(made.result("views").rgb) == {"stress", "J"}


def test_export_formats(tiny):
    """Every format is written, splats and surface once for each fifth frame."""
    pytest.importorskip("trimesh")
    files = example("export_formats").main(*tiny, *GIVEN, formats=("gif", "ply", "glb", "npz"))
    assert files["gif"][0].read_bytes()[:6] == b"GIF89a" and files["npz"][0].stat().st_size > 1000
    written = {n: sum(1 for p in paths for _ in ([p] if p.is_file() else p.iterdir())) for n, paths in files.items()}
    assert written["ply"] == written["glb"] == 3  # frames 0, 5 and 10 of 12


def test_sweep(tiny):
    """Rubber comes back higher than clay."""
    back = example("sweep").main(*tiny, *UNLEARNT, "scene.seconds=0.8", seeds=(0,))
    assert back["rubber", 0] > back["clay", 0]


def test_viewer(tiny):
    """Clay from twice the height ends flatter than jelly."""
    found, clay = example("viewer").main(*tiny, *GIVEN, "until=trajectory")
    assert clay < found
    assert list(Path("outputs/examples/runs").glob("*/viewer/film_001.mp4"))
