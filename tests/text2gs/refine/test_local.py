"""Language model, image model and score on this machine: the real classes, loaded as a user's weights are."""

import sys
from pathlib import Path

import pytest
import torch

pytest.importorskip("transformers")
sys.path.insert(0, str(Path(__file__).parent))
import tiny_networks
from loopback import answer, refinement

from diffuphy.text2gs.refine import Clip, Diffusion, Picture, Refined, Rules, Transformers, Unavailable
from diffuphy.workspace import Workspace

WORDS = "a rubber burger falling"


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    root = tmp_path_factory.mktemp("models")
    tiny_networks.qwen(root / "speaks", answer())
    tiny_networks.qwen(root / "babbles")
    tiny_networks.stable_diffusion(root / "draws")
    tiny_networks.clip(root / "scores")
    return root


def swatch(color, side=16):
    from PIL import Image

    return Picture("a swatch", 0, Image.new("RGB", (side, side), color))


# ---------------------------------------------------------------------- the language model
def test_a_model_of_the_default_class_answers(models):
    """Picture and words go in through the processor and the model's own template, JSON comes out."""
    refiner = Transformers(str(models / "speaks"))
    assert refiner.refine("a burger", "a burger", swatch("red", 24), 0.25, device="cpu") == refinement()
    assert refiner.refine("a burger", "a burger", None, None, device="cpu") == refinement()


def test_the_model_sees_the_picture(models, monkeypatch):
    """24 × 24 px are 36 patches of 4 px, which the tower merges in fours; without a picture there are none."""
    from transformers import Qwen3VLForConditionalGeneration

    seen = []
    generate = Qwen3VLForConditionalGeneration.generate

    def spy(self, **inputs):
        seen.append(len(inputs.get("pixel_values", ())))
        return generate(self, **inputs)

    monkeypatch.setattr(Qwen3VLForConditionalGeneration, "generate", spy)
    refiner = Transformers(str(models / "speaks"))
    refiner.refine("a burger", "a burger", swatch("red", 24), 0.25, device="cpu")
    refiner.refine("a burger", "a burger", None, None, device="cpu")
    assert seen == [36, 0]


def test_a_model_that_babbles_is_given_up(models):
    """Random weights never end, let alone in JSON."""
    refiner = Transformers(str(models / "babbles"), max_new_tokens=3, corrections=1)
    with pytest.raises(Unavailable, match="2 answers that cannot be used; the last: it was cut off"):
        refiner.refine("a burger", "a burger", swatch("red"), 0.25, device="cpu")


@pytest.mark.parametrize(
    ("part", "use"),
    [
        (Transformers, lambda p: p.refine("a", "a", None, None, device="cpu")),
        (Diffusion, lambda p: p.generate("a", seed=0, device="cpu")),
        (Clip, lambda p: p.score(swatch("red"), "a", device="cpu")),
    ],
)
def test_absent_weights_are_one_line(tmp_path, part, use):
    """It says what to run, and which setting names a folder."""
    for model, advice in ((str(tmp_path / "nothing"), "there is no folder .*;"), ("a/b", "hf download a/b.* or")):
        with pytest.raises(Unavailable, match=f"{advice} set refine.{part.part}.model=") as e:
            use(part(model, local_files_only=True))
        assert "\n" not in str(e.value)


def test_pickled_weights_are_refused(models, tmp_path):
    """Weights are data, never code."""
    import shutil

    shutil.copytree(models / "scores", tmp_path / "pickled")
    (weights,) = (tmp_path / "pickled").glob("*.safetensors")
    torch.save({}, tmp_path / "pickled" / "pytorch_model.bin")
    weights.unlink()
    with pytest.raises(Unavailable, match="safetensors"):
        Clip(str(tmp_path / "pickled")).score(swatch("red"), "a", device="cpu")


# ---------------------------------------------------------------------- pictures and scores
def test_a_picture_depends_on_prompt_and_seed_alone(models):
    import numpy as np

    generator = Diffusion(str(models / "draws"), steps=2, size=16)

    def draw(prompt, seed):
        return np.array(generator.generate(prompt, seed=seed, device="cpu").image)

    first = draw("a burger", 0)
    assert first.shape == (16, 16, 3)
    assert (first == draw("a burger", 0)).all()
    assert (first != draw("a duck", 0)).any() and (first != draw("a burger", 1)).any()


def test_the_score_is_a_cosine(models):
    """s = ⟨f, g⟩ / (‖f‖ ‖g‖), from the features of the two towers."""
    from transformers import CLIPModel, CLIPProcessor

    scorer = Clip(str(models / "scores"))
    model = CLIPModel.from_pretrained(models / "scores").eval()
    processor = CLIPProcessor.from_pretrained(models / "scores")
    picture = swatch((200, 30, 60))
    with torch.no_grad():
        pixels = processor(images=[picture.image], return_tensors="pt").pixel_values
        words = processor(text=["a burger"], return_tensors="pt")
        f = model.visual_projection(model.vision_model(pixels).pooler_output)[0].double()
        g = model.text_projection(model.text_model(**words).pooler_output)[0].double()
    expected = float(f @ g / f.norm() / g.norm())
    # float32 through two layers: some ten roundings
    assert scorer.score(picture, "a burger", device="cpu") == pytest.approx(expected, abs=1e-6)
    assert scorer.score(picture, "a duck", device="cpu") != pytest.approx(expected, abs=1e-6)


def test_a_text_longer_than_clip_reads_is_scored_by_its_beginning(models):
    scorer = Clip(str(models / "scores"))
    long = "x " * 75
    assert scorer.score(swatch("red"), long + "y", device="cpu") == scorer.score(swatch("red"), long, device="cpu")


def test_everything_on_this_machine_together(models, tmp_path):
    """Algorithm 1 with three networks; nothing is held afterwards, and each picture is there for people."""
    parts = {
        "refiner": Transformers(str(models / "speaks")),
        "generator": Diffusion(str(models / "draws"), steps=1, size=16),
        "scorer": Clip(str(models / "scores")),
    }
    refined = Refined(WORDS, **parts, threshold=None, max_iter=2)(work=Workspace(tmp_path))
    assert [t.prompt for t in refined.turns] == [Rules(WORDS)(work=Workspace()).look.text, refinement().prompt]
    assert refined.turns[0].reply == refinement().asdict()
    assert refined.look.text == max(refined.turns, key=lambda t: t.scores["current"]).prompt
    assert sorted(p.name for p in (tmp_path / "previews").iterdir()) == ["prompt_0.png", "prompt_1.png"]
    assert all(not part._memory for part in parts.values())


@pytest.mark.parametrize(
    ("part", "settings", "says"),
    [
        (Transformers, {"model": ""}, "model is empty"),
        (Transformers, {"dtype": "int8"}, "dtype must be"),
        (Transformers, {"max_new_tokens": 0}, "max_new_tokens must be"),
        (Transformers, {"corrections": -1}, "corrections must"),
        (Diffusion, {"steps": 0}, "steps must be"),
        (Diffusion, {"cfg": -1.0}, "cfg must"),
        (Diffusion, {"size": 12}, "multiple of 8"),
        (Clip, {"model": ""}, "model is empty"),
    ],
)
def test_wrong_settings_are_refused(part, settings, says):
    with pytest.raises(ValueError, match=says):
        part(**settings)
