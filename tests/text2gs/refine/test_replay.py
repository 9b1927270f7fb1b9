"""A recorded refinement is walked through again, from the command line too, without network, weights and key."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
from loopback import Counting, Swatches, refinement

from diffuphy.artifact import describe
from diffuphy.text2gs.refine import Refined, Replay, Rules, Unavailable
from diffuphy.types import Turn
from diffuphy.workspace import Workspace

ROOT = Path(__file__).parents[3]
WORDS = "a rubber burger falling"
FIRST = Rules(WORDS)(work=Workspace()).look.text


class Counted:
    """A good refiner that fails in the end."""

    identity = "counted"

    def __init__(self, good: int):
        self.good, self.asked = good, 0

    def refine(self, original, current, picture, score, *, device):
        self.asked += 1
        if self.asked > self.good:
            raise Unavailable("no network")
        return refinement(self.asked)

    def close(self):
        pass


def recorded(folder: Path, good: int = 9, **settings):
    loop = {"generator": Swatches(), "scorer": Counting({refinement(2).prompt: 0.3})} | settings
    prompt = Refined(WORDS, refiner=Counted(good), **loop)(work=Workspace())
    folder.mkdir(exist_ok=True)
    prompt.save(folder)
    return prompt


@pytest.mark.parametrize(
    ("good", "settings"),
    [
        (9, {}),
        (9, {"max_iter": 1}),
        (9, {"threshold": 0.3}),
        (9, {"score_against": "original"}),
        (1, {}),
        (0, {}),
        (9, {"generator": None, "scorer": None}),
        (0, {"generator": None, "scorer": None}),
    ],
    ids=["whole", "one turn", "to a threshold", "original", "fails late", "fails at once", "blind", "blind, fails"],
)
def test_a_replay_is_what_was_recorded(tmp_path, good, settings):
    """Prompt, every turn, and its failures."""
    before = recorded(tmp_path, good, **settings)
    again = {k: v for k, v in settings.items() if k == "score_against"}
    assert Replay(WORDS, path=str(tmp_path), **again)(work=Workspace()) == before
    assert Replay(WORDS, path=str(tmp_path / "result.json"), **again)(work=Workspace()) == before


def test_a_replay_of_a_replay_is_the_same(tmp_path):
    before = recorded(tmp_path)
    Replay(WORDS, path=str(tmp_path))(work=Workspace()).save(tmp_path)
    assert Replay(WORDS, path=str(tmp_path))(work=Workspace()) == before


def test_a_replay_may_weigh_scores_anew(tmp_path):
    """Both scores of each turn are recorded, whichever one counted."""
    table = {"x": 0.1, refinement(1).prompt: 0.31, f"{refinement(2).prompt} → {FIRST}": 0.33}
    before = recorded(tmp_path, scorer=Counting(table), max_iter=3)
    after = Replay(WORDS, path=str(tmp_path), score_against="original")(work=Workspace())
    assert (before.look.text, after.look.text) == (refinement(1).prompt, refinement(2).prompt)


def test_another_sentence_is_a_warning(tmp_path, caplog):
    recorded(tmp_path)
    prompt = Replay("a clay duck", path=str(tmp_path))(work=Workspace())
    assert prompt.look == Rules("a clay duck")(work=Workspace()).look
    assert "knows nothing of" in caplog.text and FIRST in caplog.text


def test_what_is_recorded_decides_not_where_it_lies(tmp_path):
    """The key of the result changes with the contents of the file alone."""
    for name in ("a", "b"):
        recorded(tmp_path / name)
    a, b = (describe(Replay(WORDS, path=str(tmp_path / name))) for name in "ab")
    recorded(tmp_path / "b", good=1)
    assert a == b != describe(Replay(WORDS, path=str(tmp_path / "b")))


@pytest.mark.parametrize(
    "content",
    [
        "no json",
        "[]",
        "{}",
        '{"turns": 3}',
        '{"turns": [3]}',
        '{"turns": [{"prompt": 3}]}',
        '{"turns": [{"prompt": "x", "more": 1}]}',
        '{"turns": [{"prompt": "x", "scores": {"current": 1}}]}',
        '{"turns": [{"prompt": "x", "scores": {"current": NaN, "original": 0}}]}',
        '{"turns": [{"prompt": "x", "reply": {"prompt": "y"}}]}',
        '{"turns": [{"prompt": "x", "reply": "y"}]}',
    ],
)
def test_what_is_no_recording_is_refused(tmp_path, content):
    file = tmp_path / "turns.json"
    file.write_text(content)
    with pytest.raises(ValueError, match="no recorded refinement"):
        Replay(WORDS, path=str(file))


def test_an_empty_recording_is_refused(tmp_path):
    Rules(WORDS)(work=Workspace()).save(tmp_path)
    with pytest.raises(ValueError, match="its list of turns is empty"):
        Replay(WORDS, path=str(tmp_path))
    with pytest.raises(ValueError, match=r"refine\.path="):
        Replay(WORDS)


def test_a_turn_may_be_written_by_hand(tmp_path):
    file = tmp_path / "turns.json"
    turns = [{"prompt": FIRST, "reply": refinement().asdict()}, {"prompt": refinement().prompt}]
    file.write_text(json.dumps({"turns": turns}))
    prompt = Replay(WORDS, path=str(file))(work=Workspace())
    assert prompt.look.text == refinement().prompt
    assert prompt.turns == (Turn(FIRST, reply=refinement().asdict()), Turn(refinement().prompt))


def test_the_command_line_replays(tmp_path):
    """`train.py refine=replay refine.path=...` to the prompt, then again from the store; no model library is loaded."""
    recorded(tmp_path / "recording")
    arguments = [
        f"prompt={WORDS}", "refine=replay", f"refine.path={tmp_path / 'recording'}", "experiment=tiny",
        f"store={tmp_path / 'store'}", "until=prompt", "device=cpu",
    ]  # fmt: skip
    code = (
        f"import runpy, sys\nsys.argv = ['train.py', *{arguments!r}]\n"
        "try:\n    runpy.run_path('train.py', run_name='__main__')\n"
        "finally:\n    print(*{'openai', 'transformers', 'diffusers', 'open_clip'} & set(sys.modules))"
    )
    env = os.environ | {"OPENAI_API_KEY": ""}
    for expected in ("prompt: done", "prompt: cached"):
        done = subprocess.run(
            [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, env=env, check=False
        )
        assert done.returncode == 0, done.stderr
        assert expected in done.stderr and "prompt refinement" in done.stderr and not done.stdout.strip()
    (result,) = (tmp_path / "store/prompt").glob("*/result.json")
    kept = json.loads(result.read_text(encoding="utf-8"))
    assert kept["look"]["text"] == refinement(2).prompt
    assert kept["turns"][0]["reply"] == refinement(1).asdict()


def test_a_missing_recording_is_one_line(capfd, tmp_path):
    from diffuphy.cli import main

    store = f"store={tmp_path / 'store'}"
    assert main([f"prompt={WORDS}", "refine=replay", f"refine.path={tmp_path / 'none'}", store]) == 2
    assert str(tmp_path / "none") in capfd.readouterr().err.splitlines()[-1]
    assert main([f"prompt={WORDS}", "refine=replay", store]) == 2
    assert "path is empty; name a recorded refinement, such as refine.path=" in capfd.readouterr().err.splitlines()[-1]
