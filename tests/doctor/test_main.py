"""The doctor as one calls it, on a machine whose weights the test has put there."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from diffuphy.doctor import __main__ as doctor
from diffuphy.models import roles
from diffuphy.models.cache import kept

sys.path.insert(0, str(Path(__file__).parents[1] / "models"))
import hub

ROOT = Path(__file__).parents[2]
SD = roles()["image"][0]


@pytest.fixture
def cache(tmp_path, monkeypatch) -> Path:
    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path / "hub"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "hub"


@pytest.fixture
def few(monkeypatch) -> None:
    """Of the choices only those that the test looks at: each takes a fifth of a second."""
    monkeypatch.setattr(doctor, "choices", lambda conf: ["", "refine=openai"])


def told(capsys, *arguments: str) -> tuple[int, dict]:
    status = doctor.main(["--offline", "--json", *arguments])
    return status, json.loads(capsys.readouterr().out)


def test_a_bare_machine_is_told_what_to_fetch(cache, capsys):
    """Every preferred model once; the default needs none of them."""
    assert doctor.main(["--offline"]) == 0
    text = capsys.readouterr().out
    for models in roles().values():
        command = models[0].url or f"hf download {models[0].id} --include"
        assert text.count(command) == 1
    assert (
        "(the default)" in text and "experiment=tiny" in text and "refine=openai" in text and "$OPENAI_API_KEY" in text
    )
    assert text.count("(non-commercial)") == sum(m.noncommercial for ms in roles().values() for m in ms)


def test_json_says_the_same_for_programs(cache, capsys):
    status, said = told(capsys)
    default, refined = (next(c for c in said["choices"] if c["choice"] == name) for name in ("", "refine=openai"))
    assert status == 0 and default["ready"] and not default["models"] and not refined["ready"]
    assert SD.id in refined["models"] and {m["id"] for m in said["models"]} == {
        m.id for ms in roles().values() for m in ms
    }
    assert not next(c for c in said["choices"] if c["choice"] == "refine=replay")["ready"]  # wants a path


@pytest.mark.parametrize("wanted", ["image", SD.id])
def test_what_is_required_decides_the_exit_status(cache, few, capsys, wanted):
    assert told(capsys, "--require", wanted)[0] == 1
    half = dict(list(hub.whole(SD).items())[1:])
    hub.cached(cache, SD.id, half)
    status, said = told(capsys, "--require", wanted)
    assert status == 1 and next(m for m in said["models"] if m["id"] == SD.id)["missing"] == ["unet/config.json"]
    hub.cached(cache, SD.id, {"unet/config.json": b"{}"})
    assert told(capsys, "--require", wanted)[0] == 0
    assert told(capsys, "--require", wanted, "--require", "video")[0] == 1


def test_an_unknown_role_is_refused_with_those_there_are(capsys):
    with pytest.raises(SystemExit) as e:
        doctor.main(["--require", "imagery"])
    assert e.value.code == 2 and "imagery is no role; roles are image, views" in capsys.readouterr().err


def test_a_pipeline_that_refines_needs_more_than_its_guidance(cache, few, capsys):
    """What refine draws with is the whole pipeline: what its index lists must be there too."""
    files = hub.whole(SD) | {"model_index.json": b'{"unet": ["diffusers", "U"], "safety_checker": ["s", "S"]}'}
    hub.cached(cache, SD.id, files)
    clip = roles()["clip-refine"][0]
    hub.cached(cache, clip.id, hub.whole(clip))
    status, said = told(capsys, "--require", "image")
    assert status == 0 and not next(c for c in said["choices"] if c["choice"] == "refine=openai")["ready"]
    hub.cached(cache, SD.id, {"safety_checker/model.safetensors": b"x"})
    assert next(c for c in told(capsys)[1]["choices"] if c["choice"] == "refine=openai")["ready"]


def test_broken_bytes_are_found(cache, few, capsys):
    """The hub's cache names large files by their digest; a single file has one if the registry knows it."""
    snapshot = hub.cached(cache, SD.id, hub.whole(SD) | {"unet/diffusion_pytorch_model.safetensors": b"tensors"})
    assert told(capsys, "--verify", "--require", "image")[0] == 0
    (snapshot / "unet/diffusion_pytorch_model.safetensors").resolve().write_bytes(b"tensorz")
    status, said = told(capsys, "--verify", "--require", "image")
    assert status == 1
    assert next(m for m in said["models"] if m["id"] == SD.id)["broken"] == ["unet/diffusion_pytorch_model.safetensors"]


def test_a_single_file_is_found_where_the_command_puts_it(cache, few, capsys):
    (head, _) = roles()["aesthetic"]
    kept(head.url).parent.mkdir(parents=True)
    kept(head.url).write_bytes(b"x")
    assert told(capsys, "--require", "aesthetic")[0] == 0


def test_it_runs_as_a_module(tmp_path):
    environment = os.environ | {"HF_HUB_CACHE": str(tmp_path), "HF_HUB_OFFLINE": "1"}
    done = subprocess.run(
        [sys.executable, "-m", "diffuphy.doctor"], cwd=ROOT, env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout.startswith("machine\n") and "not asked: HF_HUB_OFFLINE is set" in done.stdout
