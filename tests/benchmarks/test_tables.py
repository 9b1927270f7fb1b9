"""The tables: shared stages are shared, errors are distances, means are means."""

import math

import numpy as np
import pytest
import torch
from PIL import Image

from benchmarks import study
from benchmarks.study.ratings import Key
from benchmarks.tables import gather, list_films, page, text
from benchmarks.tables.gather import Mean, ahead
from benchmarks.tables.look import SIDE, VIEWS, likeness
from benchmarks.tables.protocol import ABLATIONS, METHODS, OBJECTS, PROMPTS, Task
from benchmarks.tables.reference import children, error
from benchmarks.tables.work import run, settings
from diffuphy.artifact import Store, describe
from diffuphy.composing import make
from diffuphy.pipeline import stages
from diffuphy.plan import make_plan
from diffuphy.render import render_gaussians
from diffuphy.render.sh import from_rgb
from diffuphy.shots import Turntable
from diffuphy.text2gs.refine.rules import Rules
from diffuphy.types import Gaussians, Look, Trajectory
from diffuphy.workspace import Workspace
from tests.benchmarks.test_study import answers, ratings

EVERY = dict(METHODS) | {k: v for k, v in (OBJECTS | ABLATIONS).items() if k != "full"}
BESIDES = ("reference", "told")
PROMPT = "a rubber burger falling"


def composed(variant, size="small"):
    return settings(Task(PROMPT, 0, EVERY).overrides(variant, size, "cpu"))


@pytest.mark.parametrize("variant", EVERY)
def test_every_method_and_ablation_can_be_made_and_planned(variant):
    """Its settings make components, and the plan of a run says who finds the material."""
    components = make(composed(variant)["stages"])
    words = components["prompt"](work=Workspace())
    plan = make_plan({k: v for k, v in components.items() if k not in BESIDES}, words)
    said = {line.what: line.decision for line in plan.lines}
    name = variant if variant in METHODS else "DiffuPhyGS"
    assert ("method" in said) == (name != "DiffuPhyGS")
    assert plan.components["material"].elastic and plan.components["material"].plastic


@pytest.mark.parametrize("method", [m for m in METHODS if m != "DiffuPhyGS"])
def test_methods_share_the_stages_before_the_material(method, tmp_path):
    """One key for the prompt, and one recipe for Gaussians and particles; another one for the material."""
    store = Store(tmp_path)
    ours, theirs = (stages(make(composed(m)["stages"])) for m in ("DiffuPhyGS", method))
    assert store.path(ours[0], {}) == store.path(theirs[0], {})
    done = {"prompt": store.run(ours, "prompt")[0].path}
    assert store.path(ours[1], done) == store.path(theirs[1], done)
    assert describe(ours[2].run) == describe(theirs[2].run) and ours[2].inputs == theirs[2].inputs
    assert type(ours[3].run) is not type(theirs[3].run) and ours[4].run == theirs[4].run


def test_without_a_mixture_the_plan_names_one_law():
    """Not the candidates of the prompt, which nothing simulates."""
    components = make(composed("w/o mixture")["stages"])
    plan = make_plan({k: v for k, v in components.items() if k not in BESIDES}, components["prompt"](work=Workspace()))
    assert (plan.components["material"].elastic, plan.components["material"].plastic) == (
        ("fixed_corotated",),
        ("identity",),
    )


@pytest.mark.parametrize("size", ["small", "default"])
def test_a_ball_has_as_many_gaussians_as_the_start_it_replaces(size):
    """What is left out is the shape of the start, and not its number."""
    full, ball = (make(composed(v, size)["stages"])["gaussians"] for v in ("DiffuPhyGS", "w/o shape prior"))
    assert type(ball.init).__name__ == "Ball" and ball.init.count == full.init.count
    assert type(full.init).__name__ == "SurfaceCloud" and ball.densify == full.densify


def test_what_is_changed_in_material_reaches_every_rival():
    changed = settings([*Task(PROMPT, 0, EVERY).overrides("PhysDreamer", "small", "cpu"), "material.probe.frames=5"])
    rival = make(changed["stages"])["material"]
    assert rival.probe.frames == 5 and rival.steps == changed["material"]["steps"]


def test_rivals_are_compared_with_our_untrained_network():
    """One reference for all methods: Diff_SSIM and Diff_CLIP of two methods are then about the same films."""
    overrides = Task(PROMPT, 0, EVERY).overrides("DreamPhysics", "small", "cpu")
    components = make(settings([*overrides, "evaluate.references=[0]"])["stages"])
    words = components["prompt"](work=Workspace())
    plan = make_plan({k: v for k, v in components.items() if k not in BESIDES}, words)
    reference = plan.components["evaluate"].material
    assert hasattr(reference, "net") and reference.plastic and plan.components["evaluate"].references == (0,)


def test_every_prompt_is_understood():
    assert [Rules(p)(work=Workspace()).motion.verb for p in PROMPTS]


def test_children_lie_about_their_parent():
    """Their mean is the parent (1e-7 of the coordinates in float32), no two coincide, and none is a cell away."""
    x = torch.rand(50, 3, generator=torch.Generator().manual_seed(0))
    found = children(x, 0.1, seed=3).unflatten(0, (-1, 8))
    torch.testing.assert_close(found.mean(1), x, atol=2e-7, rtol=0)
    reach = (found - x[:, None]).abs()
    assert 0.1 / 4 * 0.59 < float(reach.min()) and float(reach.max()) < 0.1 / 4 * 1.41
    assert not torch.equal(children(x, 0.1, seed=3), children(x, 0.1, seed=4))


def film(x):
    return Trajectory(x, torch.zeros_like(x), torch.zeros(*x.shape, 3), 30.0)


def test_error_is_the_distance_over_the_size():
    """Moved by d everywhere: error and centre of mass d/size, shape 0. Turned inside: the other way round."""
    x = torch.randn(4, 20, 3, generator=torch.Generator().manual_seed(0))
    weight = torch.full((20,), 1 / 20)
    moved = x.clone()
    moved[1:] += torch.tensor([0.03, 0.0, 0.04])
    found = error(film(moved), film(x), weight, 0.5)
    assert found == pytest.approx({"error": 0.1, "com": 0.1, "shape": 0.0}, abs=1e-6)
    bent = x.clone()
    bent[1:, :10, 2] += 0.05
    bent[1:, 10:, 2] -= 0.05
    assert error(film(bent), film(x), weight, 0.5) == pytest.approx({"error": 0.1, "com": 0, "shape": 0.1}, abs=1e-6)


def blob(side=0.5):
    """Eight grey Gaussians at the corners of a cube."""
    a = torch.tensor([-side, side])
    means = torch.cartesian_prod(a, a, a)
    turn = torch.tensor([1.0, 0, 0, 0]).repeat(8, 1)
    return Gaussians(means, turn, torch.full((8, 3), -1.5), torch.full((8,), 4.0), from_rgb(torch.full((8, 3), 0.3)))


def test_likeness_to_itself_is_perfect_and_another_size_is_not():
    """SSIM(a, a) = 1 to the rounding of pictures in float32; the PSNR of equal pictures has no bound."""

    def prior(look, camera, background):
        own = render_gaussians(blob(), camera).over(background).clamp(0, 1)
        return torch.stack([torch.zeros_like(own), own], 1), torch.tensor([0.0, 1.0])  # the second is meant

    same = likeness(blob(), prior, Look("blob", "a blob"))
    assert same["ssim"] == pytest.approx(1, abs=1e-5) and same["psnr"] > 100
    other = likeness(blob(0.6), prior, Look("blob", "a blob"))
    assert other["ssim"] < 0.95 and other["psnr"] < 30


def test_an_object_and_the_one_that_was_meant_are_seen_from_the_same_places():
    cameras = []

    def prior(look, camera, background):
        cameras.append(camera)
        return torch.ones(VIEWS, 1, SIDE, SIDE, 3) * background, torch.zeros(1)

    for _ in range(2):
        likeness(blob(), prior, Look("blob", "a blob"))
    assert len(cameras) == 2  # over black and over white, once for all who are compared with it
    for camera in cameras:
        assert torch.equal(camera.viewmats, Turntable.of(blob(), VIEWS, SIDE).camera.viewmats)


ROWS = [
    {"prompt": p, "variant": v, "seed": s, "error": round(e + 0.01 * s, 2)}
    for p in ("a", "b") for v, e in (("DiffuPhyGS", 0.1), ("other", 0.1 if p == "a" else 0.5)) for s in range(3)
]  # fmt: skip


def test_ahead_needs_more_than_the_spread():
    near, far = Mean(0.11, 0.01, 3), Mean(0.2, 0.01, 3)
    ours = Mean(0.1, 0.01, 3)
    assert [ahead(ours, near), ahead(ours, far), ahead(far, ours)] == [0, 1, -1]
    assert ahead(ours, Mean(math.nan, math.nan, 0, failed=3)) == 1


def test_rows_survive_their_file(tmp_path):
    rows = [*ROWS, {"prompt": "a, b", "variant": "other", "seed": 0, "why": "diverged"}]
    gather.write(rows, tmp_path / "rows.csv")
    assert gather.read(tmp_path / "rows.csv") == rows


def test_new_rows_replace_those_of_the_same_run_and_keep_the_others():
    again = {"prompt": "a", "variant": "other", "seed": 1, "error": 9.0}
    found = gather.merged(ROWS, [again])
    assert len(found) == len(ROWS) and again in found
    assert all(r in found for r in ROWS if (r["prompt"], r["variant"], r["seed"]) != ("a", "other", 1))


def test_page_has_means_spreads_and_the_best_in_bold(tmp_path):
    said = text("quantitative", ROWS, "a command")
    assert "| b | **11 ± 1** | 51 ± 1 |" in said
    assert "| other | 1 | 1 | 0 | – |" in said
    assert "Missing: CLIPSIM" in said
    page.figure(ROWS, tmp_path / "f.png")
    assert (tmp_path / "f.png").stat().st_size > 1000


def test_a_diverged_run_is_counted_not_hidden():
    run = {"prompt": "a", "variant": "x", "seed": 0}
    rows = [run | {"error": 0.1}, run | {"seed": 1, "why": "!"}]
    assert Mean.of(rows, "error").shown(100) == "10 (1 diverged)"
    assert Mean.of(rows[1:], "error").shown(100) == "diverged"


def test_rows_that_repeat_the_first_are_named():
    """A part that does nothing somewhere is told, prompt by prompt, and not shown as a number of its own."""
    made = {("full", 0): "a", ("full", 1): "b", ("w/o x", 0): "a", ("w/o x", 1): "c", ("w/o y", 0): "d"}
    rows = [{"prompt": "p", "variant": v, "seed": s, "digest": d, "error": 0.1} for (v, s), d in made.items()]
    assert "- *w/o x*: 1 of 2 runs (p)" in page.twins(rows) and "w/o y" not in page.twins(rows)
    assert "No run" in page.twins([r for r in rows if r["variant"] != "w/o x"])


def test_page_of_parts_has_floor_and_look():
    rows = [
        {"prompt": "p", "variant": v, "seed": 0, "error": 0.1, "floor": 0.09, "meant": 0.2, "psnr": 20.0, "ssim": 0.5}
        for v in ("full", "w/o x")
    ]
    said = text("ablation", rows, "a command")
    assert "| w/o x | 10.0 | 9.00 | 20.0 | 20.0 | 0.500 |" in said and "full against" in said


def test_another_object_is_compared_with_what_was_meant():
    """Its own error may be smaller because its own floor is: what is compared is the distance to what was meant."""
    rows = [
        {"prompt": "p", "variant": v, "seed": s, "error": e, "floor": e, "meant": m, "psnr": 20.0, "ssim": 0.5}
        for s in range(2)
        for v, e, m in (("full", 0.08, 0.03), ("w/o scan", 0.09, 0.04), ("w/o DAS", 0.02, 0.07))
    ]
    _, material, objects = page.ablations(rows).split("Parts of the ")
    assert "| p | **8.0 ± 0.0** | 9.0 ± 0.0 |" in material and "w/o DAS" not in material
    assert "| p | **3.0 ± 0.0** | 7.0 ± 0.0 |" in objects and "| w/o DAS | 1 | 0 | 0 | – |" in objects


def test_a_row_of_an_object_is_best_where_it_is_highest():
    rows = [
        {"prompt": "p", "variant": v, "seed": 0, "psnr": x, "ssim": 0.5, "gaussians": 10.0, "seconds": 1.0}
        for v, x in (("full", 30.0), ("w/o DAS", 20.0))
    ]
    assert "| p | **30** | 20 |" in text("look", rows, "a command")


def test_a_legend_has_room_for_every_variant(tmp_path):
    """More variants than colours: another mark, another line of the legend."""
    rows = [{"prompt": "p", "variant": f"w/o {k}", "seed": 0, "error": 0.1 + 0.01 * k} for k in range(10)]
    page.figure(rows, tmp_path / "many.png")
    page.figure(rows[:3], tmp_path / "few.png")
    heights = [Image.open(tmp_path / f"{n}.png").height for n in ("few", "many")]
    assert heights[1] - heights[0] == 2 * (18 + 7 * 12)  # a line of 18, and 12 a variant, at two pixels a unit


def test_scores_that_are_missing_are_not_said_to_lack_films():
    """With films it is weights and references that are missing."""
    row = {"prompt": "p", "variant": "x", "seed": 0, "error": 0.1}
    assert "no films were made" in page.weights([row])
    assert "no films were made" not in page.weights([row | {"film": "film.mp4"}])


@pytest.mark.slow
def test_films_of_a_table_become_a_study(tmp_path):
    """Rows, films, list, page to rate them on, ratings, and a report about our method, with no setting but the names
    of files."""
    told = ("method=physgaussian", "rival.values=table")
    task = Task(PROMPT, 0, {"DiffuPhyGS": told, "PhysGaussian": METHODS["PhysGaussian"]})
    rows = run(task, size="small", store=tmp_path / "store", device="cpu", films=tmp_path / "films")
    assert all("error" in row for row in rows)
    list_films(rows, tmp_path / "films.csv")
    assert study.main(["build", str(tmp_path / "films.csv"), str(tmp_path / "study")]) == 0
    key, draw = Key.load(tmp_path / "study/key.json"), np.random.default_rng(0)
    for k in range(2):
        ratings(tmp_path, key, f"p{k}", answers(key, draw, {"DiffuPhyGS": 1.0, "PhysGaussian": 0.0}))
    files = [str(f) for f in tmp_path.glob("p*.json")]
    assert study.main(["score", str(tmp_path / "study/key.json"), *files, "--out", str(tmp_path / "out")]) == 0
    assert "DiffuPhyGS" in (tmp_path / "out/study.md").read_text()
