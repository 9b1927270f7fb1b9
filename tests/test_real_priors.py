"""The lines that a user with real weights writes, on tiny checkpoints of the real classes."""

import json
import re

import pytest

from diffuphy.cli import main
from diffuphy.types import Gaussians

pytestmark = pytest.mark.usefixtures("quiet")


def run(store, *settings):
    arguments = f"prompt=a corgi falling|refine.library=false|experiment=tiny|device=cpu|until=gaussians|store={store}"
    small = "fit.steps=2|fit.init.count=60|guidance.size=64|guidance.dtype=float32"
    return main([*arguments.split("|"), *small.split("|"), *settings])


def gaussians(store):
    (meta,) = store.glob("gaussians/*/meta.json")
    return Gaussians.load(meta.parent)


@pytest.mark.parametrize(
    ("guidance", "folder", "estimator"),
    [
        ("stable_diffusion", "sd-epsilon", "sds"),
        ("stable_diffusion", "sd-v_prediction", "ism"),
        ("mvdream", "mvdream", "sds"),
        ("mvdream", "mvdream-v_prediction", "csd"),
    ],
)
def test_one_word_replaces_the_embedded_prior(checkpoints, tmp_path, guidance, folder, estimator):
    """A corgi, which the embedded prior has never seen; the plan says what the model takes."""
    settings = [f"guidance={guidance}", f"guidance.model={checkpoints / folder}", f"estimator={estimator}"]
    assert run(tmp_path, *settings) == 0
    found = gaussians(tmp_path)
    assert all(getattr(found, name).isfinite().all() for name in ("means", "quats", "log_scales", "sh"))
    (plan,) = tmp_path.glob("runs/*/plan.json")
    lines = {line["what"]: line for line in json.loads(plan.read_text())}
    line = lines["diffusion model"]
    views = 4 if guidance == "mvdream" else 1
    assert re.match(rf"{views} pictures at a time: denoiser [\d.]+ MB, ", line["why"]) and 1 < line["megabytes"] < 10
    assert lines["score distillation"]["decision"] == estimator.upper()


def test_a_prior_that_is_not_there_is_one_line(tmp_path, capfd):
    assert run(tmp_path, "guidance=mvdream", "guidance.model=nobody/nothing") == 2
    (error,) = [line for line in capfd.readouterr().err.splitlines() if line.startswith("error: ")]
    assert "guidance=mvdream: no weights of 'nobody/nothing'" in error and "hf download nobody/nothing" in error


def test_an_estimator_that_the_prior_cannot_answer_is_one_line(tmp_path, capfd):
    assert main(["prompt=a burger", "estimator=csd", "experiment=tiny", f"store={tmp_path}", "device=cpu"]) == 2
    assert "Analytic has no words; use estimator=sds" in capfd.readouterr().err


def test_four_views_are_asked_for_by_the_choice_of_the_prior(checkpoints, tmp_path, capfd):
    """Whoever takes them back is told what to set."""
    settings = ["guidance=mvdream", f"guidance.model={checkpoints / 'mvdream'}"]
    assert run(tmp_path, *settings, "fit.views=2") == 2
    assert "set both to 4" in capfd.readouterr().err
