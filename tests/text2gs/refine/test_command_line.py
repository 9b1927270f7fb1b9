"""The lines a user types, from the command line to the stored prompt, with tiny weights of the real classes."""

import json
import sys
from pathlib import Path

import pytest

pytest.importorskip("diffusers")
sys.path.insert(0, str(Path(__file__).parent))
import tiny_networks
from loopback import KEY, answer, refinement, serving

from diffuphy.cli import main

WORDS = "a rubber burger falling"


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    root = tmp_path_factory.mktemp("weights")
    return {
        "refiner": tiny_networks.qwen(root / "qwen", answer()),
        "generator": tiny_networks.stable_diffusion(root / "sd"),
        "scorer": tiny_networks.clip(root / "clip"),
    }


def arguments(store, weights, refine, *more):
    return [
        f"prompt={WORDS}", f"refine={refine}", f"store={store}", "until=prompt", "device=cpu", "refine.threshold=null",
        "refine.max_iter=2", f"refine.generator.model={weights['generator']}", "+refine.generator.size=16",
        "+refine.generator.steps=1", f"refine.scorer.model={weights['scorer']}", *more,
    ]  # fmt: skip


def result(store):
    (file,) = (store / "prompt").glob("*/result.json")
    return json.loads(file.read_text(encoding="utf-8"))


def test_a_local_model(tmp_path, weights, capfd):
    more = f"refine.refiner.model={weights['refiner']}"
    assert main(arguments(tmp_path, weights, "transformers", more)) == 0, capfd.readouterr().err
    turns = result(tmp_path)["turns"]
    assert turns[0]["reply"] == refinement().asdict() and turns[1]["prompt"] == refinement().prompt
    assert all(set(t["scores"]) == {"current", "original"} for t in turns)


def test_a_hosted_model(tmp_path, weights, monkeypatch, capfd):
    """The key is in the header of the request and in no file of store, run and log; a second run and a forced one ask
    nobody."""
    pytest.importorskip("openai", reason="pip install 'diffuphy[llm]'")
    monkeypatch.setenv("OPENAI_API_KEY", KEY)
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    with serving() as server:
        line = arguments(tmp_path, weights, "openai", f"refine.refiner.base_url={server.url}")
        for more in ([], [], ["force=prompt"]):
            assert main([*line, *more]) == 0, capfd.readouterr().err
    assert len(server.requests) == 1 and server.keys == [f"Bearer {KEY}"]
    assert result(tmp_path)["turns"][0]["reply"] == refinement().asdict()
    files = [p for p in tmp_path.rglob("*") if p.is_file()]
    assert {"log.txt", "config.yaml", "overrides.yaml", "plan.json", "result.json", "meta.json"} <= {
        p.name for p in files
    }
    written = "\n".join([*(p.read_bytes().decode("latin-1") for p in files), *capfd.readouterr()])
    assert server.url in written and KEY not in written and KEY[8:] not in written
