"""Where weights lie, as huggingface_hub would find them."""

import subprocess
import sys
from pathlib import Path

import pytest

from diffuphy.models.cache import endpoint, hub_cache, kept, offline, place, shown

sys.path.insert(0, str(Path(__file__).parent))
import hub

VARIABLES = ("HF_HOME", "HF_HUB_CACHE", "XDG_CACHE_HOME", "HF_HUB_OFFLINE", "TRANSFORMERS_OFFLINE", "HF_ENDPOINT")

ENVIRONMENTS = [
    {},
    {"XDG_CACHE_HOME": "/a/xdg"},
    {"HF_HOME": "~/hf"},
    {"HF_HOME": "/a/hf", "HF_HUB_CACHE": "/a/hub", "HF_HUB_OFFLINE": "yes"},
    {"HF_HUB_OFFLINE": "0", "TRANSFORMERS_OFFLINE": "1", "HF_ENDPOINT": "http://mirror/"},
    {"TRANSFORMERS_OFFLINE": "on"},
]


def test_the_environment_is_read_as_huggingface_hub_reads_it(monkeypatch):
    """Folder, permission and address for each environment, by the library itself in an interpreter of its own."""
    code = (
        "import importlib, os\n"
        f"for env in {ENVIRONMENTS!r}:\n"
        f"    for v in {VARIABLES!r}: os.environ.pop(v, None)\n"
        "    os.environ.update(env)\n"
        "    import huggingface_hub.constants as c; importlib.reload(c)\n"
        "    print(c.HF_HUB_CACHE, c.HF_HUB_OFFLINE, c.ENDPOINT)\n"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.splitlines()
    for environment, line in zip(ENVIRONMENTS, said, strict=True):
        for name in VARIABLES:
            monkeypatch.delenv(name, raising=False)
        for name, value in environment.items():
            monkeypatch.setenv(name, value)
        assert f"{hub_cache()} {offline()} {endpoint()}" == line, environment


def test_a_model_is_found_by_branch_and_by_commit(tmp_path, monkeypatch):
    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path))
    snapshot = hub.cached(tmp_path, "a/b", {"unet/config.json": b"{}"})
    assert place("a/b") == place("a/b", hub.COMMIT) == snapshot
    assert place("a/b", "other") is None and place("a/c") is None
    assert place(str(tmp_path)) == tmp_path and place(str(tmp_path / "none")) is None


def test_a_half_fetched_file_is_not_there(tmp_path, monkeypatch):
    """A link whose blob has not come is no file."""
    from diffuphy.models.files import lacking

    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path))
    snapshot = hub.cached(tmp_path, "a/b", {"config.json": b"{}", "model.safetensors": b"x"})
    assert lacking(snapshot, "transformers") == []
    (snapshot / "model.safetensors").resolve().unlink()
    assert lacking(snapshot, "transformers") == ["model.safetensors"]


def test_two_addresses_never_share_a_file():
    assert kept("https://a/x.pt") != kept("https://b/x.pt") and kept("https://a/x.pt?t=1").name.endswith("-x.pt")


@pytest.mark.parametrize("inside", ["", "x/y"])
def test_a_home_is_shown_as_a_tilde(inside, monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path))
    assert shown(tmp_path / inside) == f"~/{inside or '.'}" and shown(Path("/opt/x")) == "/opt/x"
