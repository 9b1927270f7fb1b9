"""Weights that are here are loaded, those that are not are named with what to run; nothing is fetched unsaid."""

import hashlib
import logging
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch

pytest.importorskip("diffusers")
pytest.importorskip("transformers")
sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parent))
import hub
import tiny_models

from diffuphy.models import MissingWeights, known, load_component, missing, missing_file, read, require
from diffuphy.models import weights as module
from diffuphy.models.cache import kept
from diffuphy.models.registry import for_backend, roles

SD = for_backend("stable_diffusion")[0].id
PARTS = {"unet": "diffusers"}


@pytest.fixture(scope="module")
def tiny(tmp_path_factory) -> Path:
    return tiny_models.stable_diffusion(tmp_path_factory.mktemp("tiny") / "sd")


@pytest.fixture
def cache(tmp_path, monkeypatch) -> Path:
    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path / "hub"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "hub"


def never(*args, **kwargs):
    raise AssertionError("the library was asked")


# ---------------------------------------------------------------------- on the machine or not
def test_a_model_in_the_cache_loads_by_its_name_and_a_half_fetched_one_fails_at_once(tiny, tmp_path):
    """In an interpreter whose huggingface_hub looks into the same cache; the failure names the file, loads nothing."""
    files = hub.contents(tiny)
    hub.cached(tmp_path, SD, files)
    half = for_backend("stable_diffusion")[1].id
    hub.cached(tmp_path, half, {k: v for k, v in files.items() if k != "vae/diffusion_pytorch_model.safetensors"})
    code = (
        "import sys, torch; torch.set_num_threads(1)\n"
        "from diffuphy.losses.guidance.stable_diffusion import StableDiffusion\n"
        "from diffuphy.models import MissingWeights\n"
        "from diffuphy.models.weights import require\n"
        f"try: require({half!r}, {{'vae': 'diffusers'}}, 'guidance.model')\n"
        "except MissingWeights as e: print(e)\n"
        "print('diffusers' in sys.modules)\n"
        f"print(StableDiffusion(model={SD!r}, size=64).encode(torch.rand(1, 64, 64, 3)).shape[1])\n"
    )
    environment = os.environ | {"HF_HUB_CACHE": str(tmp_path), "HF_HUB_OFFLINE": "1"}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    said, loaded, channels = done.stdout.splitlines()
    assert "(vae/diffusion_pytorch_model.safetensors)" in said and f"hf download {half} --include 'vae/*.json'" in said
    assert f"{SD} is on this machine: guidance.model={SD} takes it" in said
    assert (loaded, channels) == ("False", "4")


def test_offline_fails_before_the_library_is_asked(cache, monkeypatch):
    """By the environment or by the setting; the files and the command are named."""
    load = type(
        "UNet", (), {"config_name": "config.json", "__module__": "diffusers.x", "load": classmethod(never)}
    ).load
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    with pytest.raises(MissingWeights) as e:
        load_component(load, SD, "unet", "stable_diffusion")
    monkeypatch.delenv("HF_HUB_OFFLINE")
    with pytest.raises(MissingWeights) as f:
        load_component(load, SD, "unet", "stable_diffusion", local_files_only=True)
    assert str(e.value) == str(f.value) and "\n" not in str(e.value)
    command = f"hf download {SD} --include 'unet/*.json'"
    told = ("unet/config.json, unet/diffusion_pytorch_model.safetensors", "3.4 GB", "CreativeML OpenRAIL-M", command)
    for part in (*told, "guidance.model=/path", "guidance=analytic"):
        assert part in str(e.value)


def test_the_message_names_the_group_of_the_backend(cache):
    with pytest.raises(MissingWeights, match=r"video_guidance=modelscope: .*NON-COMMERCIAL.*video_guidance.model="):
        model = for_backend("modelscope")[0].id
        load_component(load_of("transformers.x"), model, "text_encoder", "modelscope", local_files_only=True)


def load_of(library: str):
    return type("C", (), {"config_name": "config.json", "__module__": library, "load": classmethod(never)}).load


@pytest.mark.parametrize(("role", "level"), [("image", logging.INFO), ("video", logging.WARNING)])
def test_a_download_is_said_beforehand(cache, monkeypatch, caplog, role, level):
    """Licence, size and place in one line; a licence that forbids commercial use is a warning."""
    monkeypatch.delenv("HF_HUB_OFFLINE", raising=False)
    model = roles()[role][0]
    with caplog.at_level(logging.INFO, logger=module.__name__):
        require(model.id, PARTS, model.setting)
    (record,) = caplog.records
    line = record.getMessage()
    assert record.levelno == level and ("NON-COMMERCIAL USE ONLY" in line) == model.noncommercial
    assert model.id in line and model.licence in line and str(cache) in line
    assert f"{4 * model.parts['unet'].parameters / 1e9:.1f} GB" in line


def test_a_lesser_model_that_is_here_is_told_of_and_not_taken(cache, monkeypatch, caplog):
    monkeypatch.delenv("HF_HUB_OFFLINE", raising=False)
    first, second, _ = for_backend("stable_diffusion")
    hub.cached(cache, second.id, hub.whole(second))
    with caplog.at_level(logging.INFO, logger=module.__name__):
        require(first.id, PARTS, first.setting)
    assert caplog.messages[0].startswith(f"fetching {first.id}") and second.id in caplog.messages[1]


def test_nothing_is_said_of_what_is_here(tiny, caplog):
    with caplog.at_level(logging.INFO, logger=module.__name__):
        require(str(tiny), PARTS | {"vae": "diffusers", "tokenizer": "tokenizer"}, "guidance.model")
    assert not caplog.messages


def test_a_folder_without_a_part_says_which(tiny, tmp_path):
    """And which file in it is not read."""
    with pytest.raises(MissingWeights, match=r"holds no transformer/config.json, .*set guidance.model="):
        require(str(tiny), {"transformer": "diffusers"}, "guidance.model")
    (tmp_path / "v1-5-pruned.ckpt").write_bytes(b"")
    with pytest.raises(MissingWeights, match=r"v1-5-pruned.ckpt is not read, as it may hold code: use safetensors"):
        require(str(tmp_path), {".": "diffusers"}, "guidance.model")


# ---------------------------------------------------------------------- tensors and nothing else
def test_tensors_of_torch_load_through_the_real_class_and_code_does_not(tiny, tmp_path):
    """A folder that has only ``.bin``, as old ones do: the same numbers; with an object among them: refused."""
    from diffusers import UNet2DConditionModel

    first = UNet2DConditionModel.from_pretrained(tiny, subfolder="unet")
    first.save_pretrained(tmp_path / "unet", safe_serialization=False)
    loaded = load_component(UNet2DConditionModel.from_pretrained, str(tmp_path), "unet", "stable_diffusion")
    pairs = zip(first.parameters(), loaded.parameters(), strict=True)
    assert all(torch.equal(a, b) for a, b in pairs)
    torch.save({"w": Path("/x")}, tmp_path / "unet/diffusion_pytorch_model.bin")
    with pytest.raises(ValueError, match="does not hold tensors alone"):
        load_component(UNet2DConditionModel.from_pretrained, str(tmp_path), "unet", "stable_diffusion")


def test_bytes_that_the_registry_knows_are_checked(cache, monkeypatch):
    """With the digest of the file nothing happens; with another one it is refused, with both digests."""
    entry, name = known(SD), "unet/diffusion_pytorch_model.safetensors"
    hub.cached(cache, SD, hub.whole(entry))
    digest = hashlib.sha256(hub.whole(entry)[name]).hexdigest()
    for promised in (digest, "0" * 64):
        pinned = replace(entry, sha256={name: promised})
        monkeypatch.setattr(module, "known", lambda model, m=pinned: m)
        if promised == digest:
            require(SD, PARTS, "guidance.model")
        else:
            with pytest.raises(ValueError, match=f"has SHA-256 {digest}, expected {promised}"):
                require(SD, PARTS, "guidance.model")


def test_a_single_file_is_found_by_its_name_once_it_was_fetched(cache):
    """Where the command of its message puts it."""
    (model, _) = roles()["aesthetic"]
    why = missing_file(model.id, "evaluate.aesthetic.head")
    assert why and f"-o {kept(model.url)} {model.url}" in why and "licence MIT" in why and "\n" not in why
    kept(model.url).parent.mkdir(parents=True)
    kept(model.url).write_bytes(b"half of it")
    assert "is broken" in missing_file(model.id, "evaluate.aesthetic.head")
    torch.save({"weight": torch.ones(1, 768)}, kept(model.url))
    assert missing_file(model.id, "evaluate.aesthetic.head") is None
    assert torch.equal(read(model.id)["weight"], torch.ones(1, 768))


def test_a_file_of_objects_is_refused(tmp_path):
    torch.save({"w": Path("/x")}, tmp_path / "w.pt")
    with pytest.raises(ValueError, match=r"w.pt is refused: it does not hold tensors alone"):
        read(str(tmp_path / "w.pt"))


def test_a_broken_model_is_told_before_it_is_loaded(tiny, tmp_path):
    """By whom asks whether it can be loaded, such as the plan, as by whom loads it; a digest that differs as well."""
    shutil.copytree(tiny / "unet", tmp_path / "unet")
    weights = tmp_path / "unet/diffusion_pytorch_model.safetensors"
    assert missing(str(tmp_path), PARTS, "x.model") is None
    whole = weights.read_bytes()
    for broken, said in ((whole[:-1], f"its header promises {len(whole)}"), (b"<html>", "no header of safetensors")):
        weights.write_bytes(broken)
        assert said in missing(str(tmp_path), PARTS, "x.model")
        with pytest.raises(ValueError, match=said):
            require(str(tmp_path), PARTS, "x.model")
    weights.write_bytes(whole)
    assert "x.file: " in missing_file(str(weights), "x.file", "0" * 64) and "expected 000" in missing_file(
        str(weights), "x.file", "0" * 64
    )
