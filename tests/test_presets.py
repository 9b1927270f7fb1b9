"""The presets for real weights: they say what they promise, and run, tiny, through the lines that a user types."""

import json
import sys
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate
from omegaconf import OmegaConf

sys.path.insert(0, str(Path(__file__).parent))
import tiny_models

from diffuphy import cli, composing
from diffuphy.settings import check
from diffuphy.types import Gaussians


def composed(*overrides):
    with initialize_config_dir(str(composing.conf_dir()), version_base="1.3"):
        cfg = compose("train", overrides=["prompt=a corgi falling", "hydra.run.dir=.", *overrides])
    check(OmegaConf.to_container(cfg, resolve=True))
    return cfg


def components(*overrides):
    return instantiate(composed(*overrides).stages, _convert_="all")


def test_faithful_is_what_the_paper_says():
    """§4: Stable Diffusion, guidance of 100, Point-E on MVDream's views, λ_MV3D = 0.1 and λ_vel = 0.2; figure 8: events
    of DAS from step 6000 to 10 000, every 1000. gsgen, whose schedule that is: 15 000 steps, four views of 512 px, t up
    to 0.98 and after 2000 steps to 0.5, w = σ², the shape prior until then."""
    made = components("experiment=faithful")
    fit, prior = made["gaussians"], made["gaussians"].shape.guidance
    assert (type(fit.guidance).__name__, type(prior).__name__) == ("StableDiffusion", "PointE")
    assert (type(prior.painter).__name__, type(made["material"].guidance).__name__) == ("MVDream", "ModelScope")
    assert made["prompt"].refiner.model == "gpt-4o" and not made["prompt"].library
    assert (fit.steps, fit.views, fit.cameras.size, fit.guidance.size) == (15000, 4, 512, 512)
    assert (fit.guidance.cfg, prior.cfg, prior.sample_cfg, fit.weight) == (100, 100, 3, "sigma2")
    assert [fit.t_max(k, fit.steps) for k in (0, 1999, 2000, 14999)] == [0.98, 0.98, 0.5, 0.5]
    assert fit.shape.weight == 0.1 and fit.shape.acts(1999, 15000) and not fit.shape.acts(2000, 15000)
    events = [k for k in range(1, fit.steps + 1) if fit.densify.due(k, fit.steps)]
    assert events == [6000, 7000, 8000, 9000, 10000] and fit.densify.rule == "das"
    assert (made["material"].velocity.form, made["material"].velocity.weight) == ("literal", 0.2)
    assert fit.init.prior.checkpoint == prior.checkpoint  # one setting for start and loss


def test_faithful_starts_from_4096_points():
    assert components("experiment=faithful")["gaussians"].init.count == 4096


def test_multiview_needs_one_model_and_draws_rings_of_four():
    fit = components("experiment=multiview")["gaussians"]
    assert type(fit.guidance).__name__ == "MVDream" and fit.shape is None
    assert fit.views % fit.cameras.ring == 0 and fit.cameras.ring == 4 and fit.cameras.size == fit.guidance.size == 256
    assert fit.densify.min_opacity > 0  # prunes
    assert fit.t_max(0, fit.steps) > fit.t_max(fit.steps, fit.steps)  # anneals


def test_text_alone_may_condition_the_shape_prior():
    fit = components("fit=point_e_text", "guidance=stable_diffusion")["gaussians"]
    assert fit.shape.guidance.painter is None and fit.init.prior.painter is None


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    """Tiny checkpoints of every model that the presets name."""
    pytest.importorskip("diffusers")
    pytest.importorskip("transformers")
    root = tmp_path_factory.mktemp("models")
    tiny_models.stable_diffusion(root / "sd")
    tiny_models.mvdream(root / "mvdream")
    tiny_models.clip(root / "clip")
    tiny_models.point_e(root / "text.pt")
    tiny_models.point_e(root / "image.pt", kind="grid", features=32)
    tiny_models.point_e(root / "upsample.pt", kind="grid", features=32, upsampler=True)
    return root


def point_e(models, checkpoint):
    guidance = "fit.shape.guidance"
    return [
        f"{guidance}.checkpoint={models / checkpoint}", f"{guidance}.upsampler={models / 'upsample.pt'}",
        f"{guidance}.clip={models / 'clip'}", f"+{guidance}.points=24", f"+{guidance}.added=40", f"+{guidance}.steps=2",
        "fit.shape.stop=2",
    ]  # fmt: skip


def painter(models):
    name = "fit.shape.guidance.painter"
    return [f"{name}.model={models / 'mvdream'}", f"{name}.dtype=float32", f"+{name}.size=32"]


def run(tmp_path, models, *arguments, prior="sd"):
    """``train.py``, to the Gaussians unless told otherwise; what it wrote of them."""
    settings = [f"guidance.model={models / prior}", "guidance.size=32", "guidance.dtype=float32", "refine=rules"]
    settings += ["fit.steps=3", "fit.cameras.size=32", "++fit.cameras.bank=8", "+fit.min_opacity=0.001"]
    until = [] if any(a.startswith("until=") for a in arguments) else ["until=gaussians"]
    fixed = ["prompt=a corgi, falling", *until, "device=cpu", f"store={tmp_path / 'store'}"]
    assert cli.main([*fixed, *arguments, *settings]) == 0
    (result,) = (p for p in (tmp_path / "store/gaussians").iterdir() if p.is_dir())
    (plan,) = (tmp_path / "store/runs").glob("*/plan.json")
    lines = {line["what"]: line for line in json.loads(plan.read_text(encoding="utf-8"))}
    metrics = (result / "work/metrics.jsonl").read_text(encoding="utf-8")
    return Gaussians.load(result), lines, metrics


def test_faithful_runs_tiny(tmp_path, models):
    """Pictures of the tiny MVDream, a cloud of the tiny Point-E and its upsampler, three steps of the tiny Stable
    Diffusion, two of them with the shape prior."""
    made, lines, metrics = run(tmp_path, models, "experiment=faithful", *point_e(models, "image.pt"), *painter(models))
    assert len(made) > 24 and lines["shape prior"]["decision"] == "PointE"
    assert '"shape"' in metrics


@pytest.mark.slow
def test_faithful_makes_a_film_tiny(tmp_path, models):
    """All the way: two steps of the material judged by the tiny ModelScope, then the film."""
    tiny_models.modelscope(models / "modelscope")
    run(
        tmp_path, models, "experiment=faithful", *point_e(models, "image.pt"), *painter(models), "until=clip",
        f"video_guidance.model={models / 'modelscope'}", "video_guidance.size=32", "video_guidance.dtype=float32",
        "++sample.cells=12", "++material.steps=2", "++material.stiffness_steps=0", "++material.scan_frames=4",
        "++material.probe.particles=200", "++material.probe.frames=4", "++material.probe.image=32",
        "++scene.seconds=0.2", "film.width=64", "film.height=64", "report.error=off", "evaluate.score=off",
    )  # fmt: skip
    (film,) = (tmp_path / "store/runs").glob("*/film.mp4")
    assert film.stat().st_size > 0


def test_multiview_runs_tiny(tmp_path, models):
    made, lines, metrics = run(tmp_path, models, "experiment=multiview", "fit.init.count=60", prior="mvdream")
    assert len(made) > 30 and lines["shape prior"]["decision"] == "left out"
    assert '"shape"' not in metrics


def test_point_e_reads_the_text_alone(tmp_path, models):
    """No painter: MVDream's classes are not asked for."""
    made, lines, _ = run(
        tmp_path,
        models,
        "guidance=stable_diffusion",
        "fit=point_e_text",
        *point_e(models, "text.pt"),
        "+fit.densify=null",
    )
    assert len(made) > 24 and "weight 0.1, before step 2" in lines["shape prior"]["why"]


def test_a_checkpoint_that_is_not_there_is_one_line(tmp_path, models, capsys):
    """Its name, how to fetch it, the setting for another; no network is asked (``HF_HUB_OFFLINE``)."""
    arguments = ["prompt=a corgi falling", "device=cpu", f"store={tmp_path}", "until=gaussians", "fit=point_e_text"]
    status = cli.main([*arguments, "guidance=stable_diffusion", f"guidance.model={models / 'sd'}"])
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert status == 2 and said.startswith("error: ") and "fit.shape.guidance.checkpoint=" in said
    assert "base_40m_textvec.pt" in said and "MIT" in said


def test_a_small_run_starts_from_a_cloud_of_point_e() -> None:
    """``tiny`` says how many points a surface cloud has; a prior that draws the cloud does not ask."""
    start = components("experiment=tiny", "fit=point_e")["gaussians"].init
    assert type(start).__name__ == "PointECloud" and start.count == 4096
    assert components("experiment=tiny")["gaussians"].init.count == 800


@pytest.mark.parametrize("preset", ["tiny", "fast", "quality"])
def test_a_stated_material_bears_the_settings_of_a_fit(preset: str) -> None:
    made = components(f"experiment={preset}", "material=stated", "scene=stated")["material"]
    assert type(made).__name__ == "StatedMaterial" and made.plastic == ("identity",)
