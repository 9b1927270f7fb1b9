"""The stage that scores a film: what it computes, what it leaves out and why, what it says."""

import dataclasses
import types
from pathlib import Path

import pytest
import torch

from diffuphy.artifact import Done, describe
from diffuphy.evaluate import Evaluate, world
from diffuphy.material import presets
from diffuphy.material.stated import Piece, StatedMaterial
from diffuphy.metrics.score import Score, Scores
from diffuphy.mpm.trajectory import Simulate
from diffuphy.plan.scores import score_lines
from diffuphy.render.film.clip import Film
from diffuphy.scorecard import line, markdown, scorecard, section
from diffuphy.shots import Shot, Turntable
from diffuphy.types import Look, Motion, SimulationDiverged
from diffuphy.workspace import Workspace
from tests.learning.test_fit_material import ball, stage

GAUSSIANS, PARTICLES = ball(9)
LOOK, FALL = Look("ball", "a ball"), Motion("falling", "a jelly ball falling", {"": "jelly"}, 0.4)
FIELD = presets.field(presets.lookup("jelly"), len(PARTICLES))
SCENE, FILM = Simulate(seconds=0.2, fps=30.0), Film(width=48, height=48)
TRAJECTORY = SCENE(FALL, PARTICLES, FIELD, work=Workspace())
CLIP = FILM(GAUSSIANS, PARTICLES, TRAJECTORY, work=Workspace())
COMPONENTS = {"gaussians": types.SimpleNamespace(guidance=None), "trajectory": SCENE, "clip": FILM,
              "material": stage()}  # fmt: skip


class Eyes:
    """An encoder and feature network of colours: the mean colour of a picture, and a fixed one for every text."""

    frames = 4

    def missing(self):
        return None

    def pictures(self, rgb):
        return torch.nn.functional.normalize(rgb.mean((1, 2)), dim=-1)

    def texts(self, texts, device):
        return torch.nn.functional.normalize(torch.ones(len(texts), 3), dim=-1)

    def __call__(self, clips):
        return clips.mean((2, 3)).flatten(1)


class Absent(Eyes):
    def missing(self):
        return "no weights of x/y on this machine; run `hf download x/y`"


def evaluated(trajectory=TRAJECTORY, clip=CLIP, field=FIELD, work=None, components=COMPONENTS, **settings) -> Scores:
    component = Evaluate(side=32, views=4, cameras=2, **settings).planned(components)
    return component(LOOK, FALL, GAUSSIANS, PARTICLES, field, trajectory, clip, work=work or Workspace())


# ---------------------------------------------------------------------- the plan
def test_what_is_not_there_is_left_out_with_its_reason():
    """Absent weights, an encoder that nobody named, references that nobody asked for."""
    plan = Evaluate(encoder=Absent(), video=Eyes()).planned(COMPONENTS)
    assert plan.encoder is None and plan.video is not None
    assert "hf download x/y" in plan.absent["CLIPSIM"] and plan.absent["LAION"] == "evaluate.aesthetic=null"
    assert all("references=[]" in plan.absent[m] for m in ("Diff_SSIM", "Diff_CLIP", "FVD", "KVD"))
    assert "diffusion model" in plan.absent["PSNR to the prior"]
    lines = {part: row for row in score_lines({"evaluate": plan}) for part in row.what.split(", ")}
    assert lines["CLIPSIM"].decision == "left out" and "hf download" in lines["CLIPSIM"].why
    assert lines["Diff_SSIM"].would["evaluate"].references == (0,), "what one reference costs is told"
    off = score_lines({**COMPONENTS, "evaluate": Evaluate(score="off")})[0]
    assert off.why == "evaluate.score=off" and off.would["evaluate"].scene is SCENE


def test_references_change_the_key_and_what_is_unused_does_not():
    """Without references the material stage takes no part, and neither do its settings."""
    plain, other = (Evaluate().planned(COMPONENTS | {"material": stage(steps=s)}) for s in (3, 4))
    assert describe(plain) == describe(other)
    asked = [Evaluate(references=(0,)).planned(COMPONENTS | {"material": stage(steps=s)}) for s in (3, 4)]
    assert describe(asked[0]) != describe(asked[1]) != describe(plain)


def test_given_material_has_no_network_to_compare_with():
    piece = Piece("fixed_corotated", "identity", 200.0, {"E": 1e4, "nu": 0.3})
    plan = Evaluate(references=(0, 1)).planned(COMPONENTS | {"material": StatedMaterial((piece,))})
    assert plan.references == () and plan.material is None and "material is given" in plan.absent["Diff_SSIM"]


def test_open_fields_are_refused():
    with pytest.raises(ValueError, match="left open"):
        Evaluate()(LOOK, FALL, GAUSSIANS, PARTICLES, FIELD, TRAJECTORY, CLIP, work=Workspace())


@pytest.mark.parametrize("wrong", [{"views": 3}, {"side": 33}, {"cameras": 0}, {"references": (1, 1)}])
def test_settings_that_make_no_score_are_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        Evaluate(**wrong)


@pytest.mark.parametrize("option", ["standard", "paper"])
def test_configurations_say_what_is_missing(option, monkeypatch, tmp_path):
    """Both are made without a library of networks; where no weights are, the plan leaves their metrics out."""
    from hydra.utils import instantiate
    from omegaconf import OmegaConf

    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    file = Path(__file__).parents[1] / "conf" / "evaluate" / f"{option}.yaml"
    plan = instantiate(OmegaConf.load(file), _convert_="all").planned(COMPONENTS)
    assert (plan.encoder, plan.aesthetic, plan.video) == (None, None, None)
    assert "hf download" in plan.absent["CLIPSIM"]
    if option == "paper":
        assert plan.references == (0, 1, 2) and "Diff_SSIM" not in plan.absent
        assert "run `curl " in plan.absent["FVD"] and "evaluate.video.checkpoint=" in plan.absent["FVD"]


# ---------------------------------------------------------------------- without weights
@pytest.fixture(scope="module")
def plain() -> Scores:
    return evaluated()


def test_every_film_passes_the_checks_of_matter(plain):
    """Six frames of free fall from 0.32 m: momentum to rounding (float32 sums over 390 particles, 10⁻⁵), no energy
    out of nothing, nothing in the floor, nothing inverted."""
    assert plain["momentum error"].value < 1e-5 and plain["energy created"].value < 1e-5
    assert plain["penetration"].value == 0 and plain["inverted"].value == 0
    assert plain["volume change"].value < 0.01, "it flies, unstrained"


def test_pictures_are_counted(plain):
    """The ball is seen, falls, and is as colourful in the film as on the turntable: the same two colours, mixed at
    the rim."""
    assert 1 < plain["silhouette"].value < 60 and plain["travel"].value > 0.05
    assert 0 < plain["overlap"].value < 1
    assert plain["saturation of the film"].value == pytest.approx(plain["saturation"].value, abs=0.1)
    assert set(plain.curves) == {"energy", "volume", "speed [m/s]", "silhouette", "saturation"}
    assert all(len(v) == len(CLIP.rgb) for v in plain.curves.values())


def test_a_film_that_breaks_the_law_is_found_out():
    """Twice the fall in the same time, |Δv − gΔt| = gΔt: an error of 1; and energy from nowhere."""
    scores = evaluated(dataclasses.replace(TRAJECTORY, v=2 * TRAJECTORY.v))
    assert scores["momentum error"].value == pytest.approx(1.0, abs=1e-4)
    assert scores["energy created"].value > 0.1
    deep = TRAJECTORY.x.clone()
    deep[-1, :, 2] -= 1.0
    assert evaluated(dataclasses.replace(TRAJECTORY, x=deep))["penetration"].value > 100


def test_likeness_to_the_prior_is_that_of_the_favoured_sibling():
    """A prior that knows the Gaussians themselves, moved by 0.1 in grey: 20 dB; the other sibling is black."""

    def prior(look, camera, background):
        rgb = Turntable.of(GAUSSIANS, 4, 32).rgb
        return torch.stack([0 * rgb, rgb - 0.1], 1), torch.tensor([0.0, 5.0])

    components = COMPONENTS | {"gaussians": types.SimpleNamespace(guidance=types.SimpleNamespace(references=prior))}
    score = evaluated(components=components)["PSNR to the prior"]
    assert score.value == pytest.approx(20.0, abs=1e-3) and score.count == 4


def test_a_pushed_body_is_not_judged_as_a_free_one():
    """A moving plate does work: energy and momentum say why they are missing."""
    squashed = dataclasses.replace(FALL, verb="squashed")
    known = world(SCENE.scene(squashed, PARTICLES))
    assert not known.closed and len(known.walls) == 1
    assert world(SCENE.scene(FALL, PARTICLES)).closed
    component = Evaluate(side=32, views=4).planned(COMPONENTS)
    scores = component(LOOK, squashed, GAUSSIANS, PARTICLES, FIELD, TRAJECTORY, CLIP, work=Workspace())
    assert "moving wall" in scores.absent["energy created"] and "moving wall" in scores.absent["momentum error"]


# ---------------------------------------------------------------------- with networks and references
@pytest.fixture(scope="module")
def whole() -> Scores:
    return evaluated(encoder=Eyes(), video=Eyes(), references=(0, 1))


def test_paper_scores_have_error_bars_over_the_seeds(whole):
    for name in ("CLIPSIM′", "Diff_SSIM", "Diff_SSIM (object)", "Diff_CLIP", "FVD", "KVD"):
        assert whole[name].count == 2 and whole[name].error >= 0
    assert whole["Diff_CLIP"].value == pytest.approx(whole["CLIPSIM"].value / whole["CLIPSIM′"].value, rel=1e-3)
    clips = 2 * (len(CLIP.rgb) - 4 + 1)
    assert f"N = {clips}, fewer than its 12 features" in whole["FVD"].note or clips > 12
    assert "LAION" in whole.absent and "FVD" not in whole.absent


def test_free_fall_is_the_same_for_every_material(whole):
    """Nothing touches it: the untrained network's film differs by rounding alone, which SSIM of flat backgrounds
    magnifies by 1/C₂ at most: 10⁻⁷/9·10⁻⁴."""
    assert whole["Diff_SSIM"].value == pytest.approx(0, abs=2e-4)
    assert whole["FVD"].value == pytest.approx(0, abs=1e-6)


def test_another_film_is_told_from_the_reference(monkeypatch):
    """A reference that is half a ball to the side of this film: unlike as pictures and as clips, and most of all where
    the balls are."""
    aside = dataclasses.replace(TRAJECTORY, x=TRAJECTORY.x + torch.tensor([0.2, 0.0, 0.0]))
    monkeypatch.setattr(Evaluate, "_untrained", lambda self, seed, cast, work: aside)
    scores = evaluated(video=Eyes(), references=(0,))
    assert 0.02 < scores["Diff_SSIM"].value < scores["Diff_SSIM (object)"].value < 1.5
    assert scores["FVD"].value > 1e-4


def test_references_that_diverge_are_no_numbers(monkeypatch, caplog):
    def diverges(self, seed, cast, work):
        raise SimulationDiverged("particle 7 is nowhere")

    monkeypatch.setattr(Evaluate, "_untrained", diverges)
    scores = evaluated(references=(0,))
    assert scores.absent["Diff_SSIM"] == "every reference film diverged" and "particle 7" in caplog.text


def test_untrained_networks_differ_by_their_seed():
    """A network that has learnt nothing says something else for each seed; a trained one begins at its start."""
    from diffuphy.material.net import Untrained

    def field(net, seed):
        settings = {f.name: getattr(net, f.name) for f in dataclasses.fields(net)}
        component = dataclasses.replace(COMPONENTS["material"], steps=0, stiffness_steps=0)
        component = dataclasses.replace(component, net=Untrained(**settings | {"seed": seed}))
        return component(LOOK, FALL, GAUSSIANS, PARTICLES, work=Workspace())

    first, again, other = (field(COMPONENTS["material"].net, seed).theta["E"] for seed in (0, 0, 1))
    assert torch.equal(first, again) and not torch.equal(first, other)
    assert float(first.log10().std()) > 0.01, "and one that depends on the particle"


def test_a_finished_reference_is_not_made_again(tmp_path, whole, monkeypatch):
    """Killed in the second seed, the stage goes on there, to the same numbers."""
    true, calls = Evaluate._untrained, []

    def dies(self, seed, *rest):
        calls.append(seed)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return true(self, seed, *rest)

    monkeypatch.setattr(Evaluate, "_untrained", dies)
    settings = {"encoder": Eyes(), "video": Eyes(), "references": (0, 1)}
    with pytest.raises(KeyboardInterrupt):
        evaluated(work=Workspace(tmp_path), **settings)
    again = evaluated(work=Workspace(tmp_path), **settings)
    assert calls == [0, 1, 1]
    assert [(s.name, s.value) for s in again.scores] == [(s.name, s.value) for s in whole.scores]


def test_reference_films_share_the_camera():
    """A film that leaves the picture of the first one stays in its frame: the camera is that of the first."""
    shot = Shot.like(FILM, TRAJECTORY)
    moved = dataclasses.replace(TRAJECTORY, x=TRAJECTORY.x + torch.tensor([5.0, 0.0, 0.0]))
    of_shot, of_film = ([c.cameras(t, PARTICLES).viewmats for t in (TRAJECTORY, moved)] for c in (shot, FILM))
    assert torch.equal(*of_shot) and not torch.equal(*of_film)
    assert float(shot.cover(GAUSSIANS, PARTICLES, moved).max()) == 0
    small = dataclasses.replace(shot, width=96).reduced(32)
    assert (small.width, small.height) == (64, 32)
    assert torch.equal(shot.pictures(GAUSSIANS, PARTICLES, TRAJECTORY), CLIP.rgb)


def test_turntable_begins_in_front():
    """The front faces +x: the first camera stands there, the third of four behind."""
    table = Turntable.of(GAUSSIANS, 4, 16)
    assert table.azimuth.tolist() == [0, 90, 180, 270] and table.rgb.shape == (4, 16, 16, 3)
    R, t = table.camera.viewmats[:, :3, :3], table.camera.viewmats[:, :3, 3]
    position = -(R.mT @ t[..., None])[..., 0]
    assert float(position[0, 0]) > 3 and float(position[2, 0]) < -3


# ---------------------------------------------------------------------- what is said
def saved(folder, value) -> Done:
    folder.mkdir(parents=True)
    score = Score("CLIPSIM", value, better="higher", note="of the frames")
    absent = dict.fromkeys(("FVD", "KVD"), "no weights")
    Scores((score,), absent, {"CLIPSIM": torch.tensor([0.1, 0.3])}, 10.0).save(folder)
    return Done("evaluate", folder, False, 1.0, 1.0)


def test_line_and_section_say_the_numbers_and_the_reasons(tmp_path):
    scores = scorecard([saved(tmp_path / "a", 0.25)])
    assert line(scores) == "CLIPSIM 0.25; left out: FVD (see the plan)"
    told = section(scores)
    assert told.numbers == [("CLIPSIM", "0.25", "of the frames; higher is better")]
    assert told.words == ["Left out: FVD, KVD. no weights."]
    assert told.curves[0][1] == [(0.0, pytest.approx(0.1)), (0.1, pytest.approx(0.3))]
    assert scorecard([]) is None


def test_runs_that_differ_by_their_seed_make_one_table(tmp_path):
    """0.2 and 0.4: 0.3 ± 0.1."""
    for run, value in (("a", 0.2), ("b", 0.4)):
        saved(tmp_path / run / "8_evaluate", value)
    assert "| CLIPSIM | 0.3 ± 0.1 | higher |" in markdown([tmp_path / "a", tmp_path / "b"])
    with pytest.raises(ValueError, match="holds no scores"):
        markdown([tmp_path])
