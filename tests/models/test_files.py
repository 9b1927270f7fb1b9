"""Which files make a part whole, by the libraries' own classes; tensors are read, code is not."""

import fnmatch
import itertools
import json
import shlex
import sys
from pathlib import Path

import pytest
import torch

pytest.importorskip("diffusers")
pytest.importorskip("transformers")
sys.path.insert(0, str(Path(__file__).parents[1]))
import tiny_models

from diffuphy.models.files import KINDS, check_tensors, kind_of, lacking, weights


@pytest.fixture(scope="module")
def model(tmp_path_factory) -> Path:
    return tiny_models.stable_diffusion(tmp_path_factory.mktemp("tiny") / "sd")


def test_kinds_are_those_of_the_classes():
    import diffusers as d
    import transformers as t

    expected = {
        d.UNet2DConditionModel: "diffusers",
        d.AutoencoderKL: "diffusers",
        d.WanTransformer3DModel: "diffusers",
        d.DDIMScheduler: "scheduler",
        d.AutoPipelineForText2Image: "pipeline",
        d.StableDiffusionPipeline: "pipeline",
        t.CLIPTextModel: "transformers",
        t.CLIPVisionModelWithProjection: "transformers",
        t.AutoModelForImageTextToText: "transformers",
        t.CLIPTokenizer: "tokenizer",
        t.T5TokenizerFast: "tokenizer",
        t.AutoTokenizer: "tokenizer",
        t.AutoProcessor: "processor",
        t.CLIPProcessor: "processor",
    }
    assert {c: kind_of(c.from_pretrained) for c in expected} == expected
    assert kind_of(json.loads) is None


@pytest.mark.parametrize(
    ("part", "kind"),
    [("unet", "diffusers"), ("vae", "diffusers"), ("text_encoder", "transformers"), ("tokenizer", "tokenizer"),
     ("scheduler", "scheduler")],
)  # fmt: skip
def test_what_the_libraries_save_is_whole_and_is_what_would_be_fetched(model, part, kind, tmp_path):
    """Every file that the library wrote and reads matches a pattern; without any one row the part is not whole."""
    folder = model / part
    assert lacking(folder, kind) == [] and lacking(None, kind) == [row[0] for row in KINDS[kind].needs]
    for row in KINDS[kind].needs:
        present = next(name for name in row if (folder / name).is_file())
        assert any(fnmatch.fnmatch(present, pattern) for pattern in KINDS[kind].fetch)
        rest = tmp_path / "rest"
        rest.mkdir(exist_ok=True)
        for file in folder.iterdir():
            (rest / file.name).unlink(missing_ok=True)
            if file.name not in row:
                (rest / file.name).write_bytes(file.read_bytes())
        assert lacking(rest, kind) == [row[0]]


def test_what_is_fetched_is_what_is_needed_and_once(model):
    """By the library's own filter: of all that a repository has, each tensor in one form, and every description."""
    from huggingface_hub.utils import filter_repo_objects

    from diffuphy.models.registry import for_backend
    from diffuphy.models.weights import command

    said = shlex.split(command(for_backend("stable_diffusion")[0].id))
    patterns = [pattern for word, pattern in itertools.pairwise(said) if word == "--include"]
    right = [
        f.relative_to(model).as_posix() for f in model.rglob("*") if f.is_file() and f.name != "chat_template.jinja"
    ]
    right += ["unet/diffusion_pytorch_model-00001-of-00002.safetensors", "model_index.json", "tokenizer/merges.txt"]
    right += ["unet/diffusion_pytorch_model.safetensors.index.json"]
    wrong = ["v1-5-pruned.ckpt", "v1-5-pruned.safetensors", "README.md", "safety_checker/model.safetensors"]
    for stem in ("unet/diffusion_pytorch_model", "text_encoder/model", "vae/diffusion_pytorch_model"):
        wrong += [f"{stem}.{end}" for end in ("fp16.safetensors", "non_ema.safetensors", "bin", "fp16.bin")]
    assert set(filter_repo_objects([*right, *wrong], allow_patterns=patterns)) == set(right)


def test_a_missing_shard_is_named(tmp_path):
    index = {"weight_map": {"a": "model-00001-of-00002.safetensors", "b": "model-00002-of-00002.safetensors"}}
    (tmp_path / "config.json").write_text("{}")
    (tmp_path / "model.safetensors.index.json").write_text(json.dumps(index))
    (tmp_path / "model-00001-of-00002.safetensors").write_bytes(b"")
    assert lacking(tmp_path, "transformers") == ["model-00002-of-00002.safetensors"]
    assert [f.name for f in weights(tmp_path, "transformers")] == sorted(index["weight_map"].values())


def test_a_pipeline_needs_the_folders_that_it_lists(tmp_path):
    listed = {"_class_name": "P", "unet": ["diffusers", "U"], "safety_checker": [None, None], "vae": ["diffusers", "V"]}
    (tmp_path / "model_index.json").write_text(json.dumps(listed))
    (tmp_path / "unet").mkdir()
    assert lacking(tmp_path, "pipeline") == ["vae"]


# ---------------------------------------------------------------------- no code
class Harmful:
    """Makes a file when it is unpickled."""

    def __init__(self, marker: Path):
        self.marker = marker

    def __reduce__(self):
        return Path.touch, (self.marker,)


@pytest.mark.parametrize("zipped", [True, False])
def test_code_is_refused_and_never_runs(tmp_path, zipped):
    marker, file = tmp_path / "it ran", tmp_path / "pytorch_model.bin"
    torch.save({"w": torch.ones(2), "x": Harmful(marker)}, file, _use_new_zipfile_serialization=zipped)
    with pytest.raises(ValueError, match="does not hold tensors alone"):
        check_tensors(file)
    assert not marker.exists()
    torch.load(file, weights_only=False)  # it would have
    assert marker.exists()


@pytest.mark.parametrize("zipped", [True, False])
def test_tensors_alone_pass(tmp_path, zipped):
    torch.save({"w": torch.ones(2)}, tmp_path / "w.bin", _use_new_zipfile_serialization=zipped)
    check_tensors(tmp_path / "w.bin")


def test_broken_and_foreign_files_are_refused(tmp_path):
    for name, said in (("w.bin", "broken"), ("w.ckpt", "may hold code"), ("w.pkl", "may hold code")):
        (tmp_path / name).write_bytes(b"nothing of the kind")
        with pytest.raises(ValueError, match=said):
            check_tensors(tmp_path / name)
