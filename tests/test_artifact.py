"""The store: content-addressed, resumable, atomic, locked, never silently wrong."""

import dataclasses
import json
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import pytest
import torch

from diffuphy.artifact import Stage, Store, describe, digest
from diffuphy.types import Look, Motion, Prompt, Result
from diffuphy.workspace import CheckpointCorrupted, Workspace

calls: list[str] = []


@dataclass(frozen=True)
class Text(Result):
    text: str
    vector: torch.Tensor


@dataclass(frozen=True)
class Say:
    text: str = "a jelly cube"
    threads: int = field(default=1, metadata={"runtime": True})

    def __call__(self, *, work):
        calls.append("say")
        return Text(self.text, torch.arange(3.0))


@dataclass(frozen=True)
class Lower:
    def __call__(self, said, *, work):
        calls.append("lower")
        return Text(said.text.lower(), said.vector)


@dataclass(frozen=True)
class Count:
    """Counts to ``steps``, keeping a checkpoint; may be interrupted at a step."""

    steps: int = 5
    interrupt_at: ClassVar[int] = -1

    def __call__(self, said, *, work):
        calls.append("count")
        state = work.load() or {"step": 0, "total": torch.zeros(())}
        for step in range(int(state["step"]), self.steps):
            state = {"step": step + 1, "total": state["total"] + step}
            work.save(state)
            if self.interrupt_at == step:
                raise KeyboardInterrupt
        return Text(f"{len(said.text.split())} words", state["total"])


def line(text="a jelly cube", steps=5):
    return [
        Stage("say", Text, Say(text)),
        Stage("lower", Text, Lower(), ("say",)),
        Stage("count", Text, Count(steps), ("lower",)),
    ]


@pytest.fixture(autouse=True)
def fresh():
    calls.clear()


def run(tmp_path, stages, until="count", **kw):
    return Store(tmp_path, progress=False).run(stages, until, **kw)


def test_second_run_is_all_cached(tmp_path):
    first = run(tmp_path, line())
    assert calls == ["say", "lower", "count"] and not any(d.cached for d in first)
    second = run(tmp_path, line())
    assert calls == ["say", "lower", "count"] and all(d.cached for d in second)
    assert [d.path for d in first] == [d.path for d in second]


def test_early_cutoff(tmp_path):
    """Another prompt that lowers to the same words stops there: count is not run again."""
    run(tmp_path, line())
    calls.clear()
    run(tmp_path, line(text="A jelly cube"))
    assert calls == ["say", "lower"]


def test_changed_setting_runs_only_from_there(tmp_path):
    run(tmp_path, line())
    calls.clear()
    run(tmp_path, line(steps=6))
    assert calls == ["count"]


def test_force_runs_again_and_keeps_the_path(tmp_path):
    first = run(tmp_path, line())
    calls.clear()
    second = run(tmp_path, line(), force=["lower"])
    assert calls == ["lower"]
    assert first[1].path == second[1].path


def interrupted_run(tmp_path, monkeypatch):
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(Count, "interrupt_at", 2)
        run(tmp_path, line())


def test_a_kill_while_the_old_result_is_removed_leaves_a_whole_one(tmp_path, monkeypatch):
    """Removing a folder takes several steps; none of them may be on the result that others read."""
    first = run(tmp_path, line())
    reference = digest(first[1].path)

    def half(folder):
        (folder / "result.json").unlink()
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr("diffuphy.artifact.shutil.rmtree", half)
        run(tmp_path, line(), force=["lower"])
    assert digest(run(tmp_path, line())[1].path) == reference
    run(tmp_path, line(), force=["lower"])
    assert not list(tmp_path.rglob("*.old"))


def test_interrupted_stage_continues_to_the_same_bytes(tmp_path, monkeypatch):
    reference = digest(run(tmp_path / "a", line())[-1].path)
    interrupted_run(tmp_path / "b", monkeypatch)
    calls.clear()
    assert digest(run(tmp_path / "b", line())[-1].path) == reference
    assert calls == ["count"]


@dataclass(frozen=True)
class Histogram:
    """An indexed sum of enough terms for torch to share it among threads."""

    def __call__(self, *, work):
        generator = torch.Generator().manual_seed(0)
        index = torch.randint(0, 50, (400_000,), generator=generator)
        terms = torch.randn(len(index), generator=generator)
        return Text("sum", torch.zeros(50).index_put_((index,), terms, accumulate=True))


def test_sums_do_not_depend_on_the_order_of_threads(tmp_path):
    """Twenty runs with two threads give the same bytes; torch's default gives several."""
    threads = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        stage = Stage("sum", Text, Histogram())
        found = {digest(run(tmp_path, [stage], until="sum", force=["sum"])[0].path) for _ in range(20)}
    finally:
        torch.set_num_threads(threads)
    assert len(found) == 1
    assert not torch.are_deterministic_algorithms_enabled()


def test_no_checkpoint_is_left_behind(tmp_path):
    path = run(tmp_path, line())[-1].path
    assert not list(path.rglob("checkpoint*"))
    assert not list(tmp_path.rglob("*.partial"))


def test_damaged_checkpoint_is_an_error_that_says_what_to_delete(tmp_path, monkeypatch):
    interrupted_run(tmp_path, monkeypatch)
    (checkpoint,) = tmp_path.rglob("checkpoint-*")
    data = bytearray(checkpoint.read_bytes())
    data[-1] ^= 1
    checkpoint.write_bytes(data)
    with pytest.raises(CheckpointCorrupted, match="delete this one file"):
        run(tmp_path, line())
    checkpoint.unlink()
    assert run(tmp_path, line())[0].cached


def test_damaged_result_is_an_error(tmp_path):
    path = run(tmp_path, line())[0].path
    (path / "result.json").write_text(json.dumps({"text": "forged", "vector": {"tensor": "vector"}}))
    with pytest.raises(ValueError, match="damaged"):
        run(tmp_path, line())


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", '{"digest": "0"}'])
def test_damaged_record_of_a_result_is_an_error(tmp_path, text):
    path = run(tmp_path, line())[0].path
    (path / "meta.json").write_text(text)
    with pytest.raises(ValueError, match="is damaged; delete this one folder"):
        run(tmp_path, line())


def test_unknown_stage_names_the_known_ones(tmp_path):
    with pytest.raises(ValueError, match="say, lower, count"):
        run(tmp_path, line(), until="video")
    with pytest.raises(ValueError, match="no stage named 'film'"):
        run(tmp_path, line(), force=["film"])


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_read_only_store_is_a_one_line_error(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(OSError, match="cannot be written"):
        Store(tmp_path / "outputs")


def test_store_on_a_file_is_a_one_line_error(tmp_path):
    (tmp_path / "outputs").write_text("")
    with pytest.raises(OSError, match="cannot be written"):
        Store(tmp_path / "outputs")


def test_describe_takes_defaults_and_leaves_runtime_settings_out():
    assert describe(Say()) == describe(Say("a jelly cube", threads=7))
    assert describe(Say())["text"] == "a jelly cube"
    assert describe(Say("b")) != describe(Say())
    with pytest.raises(TypeError, match="plain data"):
        describe(object())


@dataclass(frozen=True)
class Refine:
    verb: str

    def __call__(self, *, work):
        return Prompt(Look("burger", "a burger"), Motion(self.verb, f"a burger {self.verb}", {"": "rubber"}))


@dataclass(frozen=True)
class Paint:
    def __call__(self, look, *, work):
        calls.append("paint")
        assert isinstance(look, Look)
        return Text(look.subject, torch.zeros(1))


def test_a_stage_that_reads_one_field_depends_on_that_field_alone(tmp_path):
    """Gaussians read prompt.look: another motion leaves them untouched."""

    def pipeline(verb):
        return [Stage("prompt", Prompt, Refine(verb)), Stage("paint", Text, Paint(), ("prompt.look",))]

    run(tmp_path, pipeline("falling"), until="paint")
    run(tmp_path, pipeline("bouncing"), until="paint")
    assert calls == ["paint"]


def test_look_up_finds_what_is_there_without_running(tmp_path):
    store = Store(tmp_path, progress=False)
    assert store.look_up(line()) == {}
    store.run(line(), "lower")
    calls.clear()
    assert list(store.look_up(line())) == ["say", "lower"] and calls == []


def test_prompt_round_trips(tmp_path):
    prompt = Prompt(Look("汉堡 🍔", "a 'burger', \"x\""), Motion("falling", "f", {"": "rubber", "bun": "bread"}, 0.3))
    prompt.save(tmp_path)
    assert Prompt.load(tmp_path) == prompt


def test_checkpoint_round_trips_an_optimiser(tmp_path):
    p = torch.nn.Parameter(torch.ones(3))
    optimiser = torch.optim.Adam([{"params": [p], "name": "means"}], lr=0.1)
    (p**2).sum().backward()
    optimiser.step()
    generator = torch.Generator().manual_seed(3)
    work = Workspace(tmp_path)
    work.save(
        {"optimiser": optimiser.state_dict(), "rng": generator.get_state(), "step": 7, "list": [1, 2.5, None, True]}
    )
    state = Workspace(tmp_path).load()
    assert state["step"] == 7 and state["list"] == [1, 2.5, None, True]
    optimiser.load_state_dict(state["optimiser"])
    torch.testing.assert_close(state["optimiser"]["state"][0]["exp_avg"], optimiser.state[p]["exp_avg"], rtol=0, atol=0)
    assert torch.equal(state["rng"], generator.get_state())


def test_workspace_without_a_folder_keeps_nothing():
    work = Workspace(progress=False)
    work.save({"a": 1})
    work.log(0, loss=1.0)
    assert work.load() is None and not work.due()


def test_only_safetensors_and_json_are_written(tmp_path):
    run(tmp_path, line())
    files = {p.suffix for p in Path(tmp_path).rglob("*") if p.is_file()}
    assert files <= {".json", ".safetensors", ".lock", ".jsonl", ".png"}


def test_results_are_frozen():
    with pytest.raises(dataclasses.FrozenInstanceError):
        Text("a", torch.zeros(1)).text = "b"  # type: ignore[misc]
