"""Algorithm 1: which prompts are tried, which one is taken, and what the later stages see of it."""

import json
import sys
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

sys.path.insert(0, str(Path(__file__).parent))
from loopback import Counting, Swatches, refinement

from diffuphy.artifact import describe
from diffuphy.composing import conf_dir
from diffuphy.settings import check
from diffuphy.text2gs.refine import Picture, Refined, Refinement, Rules, Unavailable
from diffuphy.text2gs.refine.cache import Cached
from diffuphy.types import Prompt
from diffuphy.workspace import Workspace

WORDS = "a rubber burger falling"
FIRST = Rules(WORDS)(work=Workspace()).look.text


@dataclass(frozen=True)
class Scripted:
    """Says one prompt after the other; what is no prompt is raised, or nothing is left to say."""

    script: tuple[str | Exception | None, ...]
    asked: list[tuple] = field(default_factory=list, metadata={"runtime": True})

    @property
    def identity(self):
        return "scripted"

    def refine(self, original, current, picture, score, *, device):
        said = self.script[len(self.asked)]
        self.asked.append((original, current, picture, score))
        if isinstance(said, Exception):
            raise said
        return None if said is None else Refinement("a", "b", "c", "d", said)

    def close(self):
        self.asked.append("closed")


def run(*script, table=None, work=None, **settings):
    """The prompt, and what the refiner was asked."""
    refiner = Scripted(script)
    loop = {"generator": Swatches(), "scorer": Counting({FIRST: 0.20} | (table or {})), "max_iter": 4} | settings
    prompt = Refined(WORDS, refiner=refiner, **loop)(work=work or Workspace())
    assert refiner.asked.pop() == "closed"
    return prompt, refiner.asked


def tried(prompt):
    return [t.prompt for t in prompt.turns]


# ---------------------------------------------------------------------- which prompts, which one
def test_the_best_score_wins():
    """y* = argmax_n s_n over all prompts tried, not the last one."""
    prompt, _ = run("one", "two", "three", table={"one": 0.25, "two": 0.29, "three": 0.22})
    assert tried(prompt) == [FIRST, "one", "two", "three"]
    assert prompt.look.text == "two"


def test_the_first_of_equals_is_kept():
    """Line 8 of the algorithm: score > best_score, strictly."""
    prompt, _ = run("one", "two", "three")
    assert prompt.look.text == FIRST


def test_a_good_first_picture_asks_nobody():
    prompt, asked = run(table={FIRST: 0.32}, threshold=0.32)
    assert asked == [] and prompt.look.text == FIRST and len(prompt.turns) == 1


def test_it_stops_at_the_threshold():
    prompt, asked = run("one", "two", table={"one": 0.4}, threshold=0.4)
    assert prompt.look.text == "one" and len(asked) == 1


def test_nobody_is_asked_after_the_last_picture():
    """max_iter pictures, max_iter − 1 questions."""
    prompt, asked = run("one", "two", max_iter=3)
    assert len(prompt.turns) == 3 and len(asked) == 2


def test_a_prompt_is_not_tried_twice():
    prompt, asked = run("one", FIRST)
    assert tried(prompt) == [FIRST, "one"] and len(asked) == 2


def test_a_refiner_may_have_nothing_to_add():
    prompt, _ = run("one", None, table={"one": 0.3})
    assert tried(prompt) == [FIRST, "one"] and prompt.turns[-1].failure == ""


@pytest.mark.parametrize(("against", "best"), [("current", "drifts"), ("original", "faithful"), ("min", "sound")])
def test_the_score_counts_against_the_words_chosen(against, best):
    """Algorithm 1 takes what shows its own prompt best, though the sentence asked for something else."""
    table = {
        FIRST: 0.10,
        "drifts": 0.39, f"drifts → {FIRST}": 0.11,
        "faithful": 0.12, f"faithful → {FIRST}": 0.30,
        "sound": 0.25, f"sound → {FIRST}": 0.26,
    }  # fmt: skip
    prompt, _ = run("drifts", "faithful", "sound", table=table, score_against=against, threshold=None)
    assert prompt.look.text == best
    assert prompt.turns[1].scores == {"current": 0.39, "original": 0.11}


def test_the_refiner_is_told_the_original_the_current_and_how_good_it_is():
    _, asked = run("one", "two", None, table={"one": 0.27})
    assert [(o, c, p.prompt, p.seed, s) for o, c, p, s in asked[:2]] == [
        (FIRST, FIRST, FIRST, 0, 0.20),
        (FIRST, "one", "one", 0, 0.27),
    ]


def test_without_scores_one_answer_is_taken():
    prompt, asked = run("one", generator=None, scorer=None)
    assert prompt.look.text == "one" and asked == [(FIRST, FIRST, None, None)]
    assert [t.scores for t in prompt.turns] == [{}, {}]


def test_without_scores_the_refiner_may_still_see_a_picture():
    _, asked = run("one", scorer=None)
    assert [picture.prompt for _, _, picture, _ in asked] == [FIRST]


# ---------------------------------------------------------------------- what can fail
@dataclass(frozen=True)
class Failing(Swatches):
    """Draws only the first prompts."""

    good: tuple[str, ...] = ()

    def generate(self, prompt, *, seed, device):
        if prompt not in self.good:
            raise Unavailable("no memory")
        return super().generate(prompt, seed=seed, device=device)


@pytest.mark.parametrize(
    ("good", "best", "failures"),
    [
        ((), FIRST, ["no memory"]),
        ((FIRST,), FIRST, ["", "no memory"]),
        ((FIRST, "one"), "one", ["", "", "no memory"]),
    ],
)
def test_a_prompt_without_a_picture_is_not_taken(caplog, good, best, failures):
    prompt, _ = run("one", "two", "three", table={"one": 0.3}, generator=Failing(good))
    assert prompt.look.text == best and [t.failure for t in prompt.turns] == failures
    assert "no memory" in caplog.text and "force=prompt" in caplog.text


def test_the_plan_says_at_every_run_that_refinement_ended_early():
    """Also when the stage is cached: the warning itself was given once."""
    from diffuphy.plan.wording import prompt_lines

    prompt, _ = run("one", Unavailable("no network"), table={"one": 0.3})
    (line,) = prompt_lines(prompt)
    assert line.decision == "ended early" and "no network" in line.why and "taken: one" in line.why
    (line,) = prompt_lines(run(None)[0])
    assert line.decision == "kept"
    assert prompt_lines(Rules(WORDS)(work=Workspace())) == []


def test_bugs_are_not_hidden():
    with pytest.raises(ZeroDivisionError):
        run(ZeroDivisionError("a bug"))


# ---------------------------------------------------------------------- what comes out
def test_materials_motion_and_object_stay_those_of_the_sentence():
    """The model changes how the subject is described to an image encoder, and nothing else."""
    prompt, _ = run("one", None, table={"one": 0.3})
    rules = Rules(WORDS)(work=Workspace())
    assert prompt.motion == rules.motion
    assert (prompt.look.subject, prompt.look.surface, prompt.look.negative) == (
        rules.look.subject,
        rules.look.surface,
        rules.look.negative,
    )


def test_a_sentence_that_the_rules_refuse_is_refused_before_anybody_is_asked():
    refiner = Scripted(("one",))
    with pytest.raises(ValueError, match="did you mean 'rubber'"):
        Refined("a ruber burger", refiner=refiner)(work=Workspace())
    assert refiner.asked == []


def test_the_chain_of_thought_is_kept(tmp_path):
    """Saved and loaded, turn by turn; a result from before there were turns loads as well."""
    prompt, _ = run("one", None, table={"one": 0.3})
    prompt.save(tmp_path)
    assert Prompt.load(tmp_path) == prompt
    kept = json.loads((tmp_path / "result.json").read_text())
    assert kept["turns"][0]["reply"] == Refinement("a", "b", "c", "d", "one").asdict()
    del kept["turns"]
    (tmp_path / "result.json").write_text(json.dumps(kept))
    assert Prompt.load(tmp_path).turns == ()


def test_pictures_and_scores_are_there_for_people(tmp_path):
    run("one", None, table={"one": 0.3}, work=Workspace(tmp_path))
    assert sorted(p.name for p in (tmp_path / "previews").iterdir()) == ["prompt_0.png", "prompt_1.png"]
    lines = [json.loads(line) for line in (tmp_path / "metrics.jsonl").read_text().splitlines()]
    assert [(line["prompt"], line["score"]) for line in lines] == [(FIRST, 0.2), ("one", 0.3)]


# ---------------------------------------------------------------------- answers that are kept
def ask(cached, original="a", current="b", color="red", score=0.25):
    from PIL import Image

    picture = None if color is None else Picture(current, 0, Image.new("RGB", (4, 4), color))
    return cached.refine(original, current, picture, score, device="cpu")


def test_everything_is_asked_once(tmp_path):
    refiner = Scripted(("one", "two"))
    assert ask(Cached(refiner, tmp_path)) == ask(Cached(refiner, tmp_path))
    assert len(refiner.asked) == 1


@pytest.mark.parametrize(
    "change",
    [{"original": "x"}, {"current": "x"}, {"color": "blue"}, {"color": None}, {"score": 0.26}, {"score": None}],
)
def test_another_question_is_another_answer(tmp_path, change):
    cached = Cached(Scripted(("one", "two")), tmp_path)
    assert ask(cached) != ask(cached, **change)


def test_a_damaged_answer_is_asked_for_again(tmp_path):
    cached = Cached(Scripted(("one", "two")), tmp_path)
    ask(cached)
    (file,) = tmp_path.iterdir()
    file.write_text(file.read_text()[:20])
    assert ask(cached).prompt == "two" and ask(cached).prompt == "two"


def test_a_failure_is_not_kept(tmp_path):
    cached = Cached(Scripted((Unavailable("no"), "one")), tmp_path)
    with pytest.raises(Unavailable):
        ask(cached)
    assert ask(cached).prompt == "one"


# ---------------------------------------------------------------------- settings
@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"refiner": None}, "refiner is missing"),
        ({"generator": None}, "a scorer needs pictures"),
        ({"score_against": "best"}, "score_against must be"),
        ({"max_iter": 0}, "max_iter must be at least 1"),
        ({"style": "a photo"}, "style must have"),
    ],
)
def test_wrong_settings_are_refused(settings, says):
    parts = {"refiner": Scripted(()), "generator": Swatches(), "scorer": Counting()}
    with pytest.raises(ValueError, match=says):
        Refined(WORDS, **(parts | settings))


@pytest.mark.parametrize("option", ["openai", "transformers", "replay"])
def test_the_shipped_configuration_is_a_component(option, monkeypatch, tmp_path):
    """Values of the right kinds, keys that are fields, and defaults of the YAML that are those of the class."""
    from hydra.utils import instantiate

    monkeypatch.setattr("diffuphy.text2gs.refine.hosted.find_spec", lambda name: True)
    recording = tmp_path / "turns.json"
    recording.write_text(json.dumps({"turns": [{"prompt": "x"}]}))
    extra = [f"refine.path={recording}"] if option == "replay" else []
    with initialize_config_dir(str(conf_dir()), version_base="1.3"):
        cfg = compose("train", overrides=[f"prompt={WORDS}", f"refine={option}", *extra])
    check(OmegaConf.to_container(cfg, resolve=True))
    made = instantiate(OmegaConf.to_container(cfg, resolve=True)["stages"]["prompt"], _convert_="all")
    parts = {"refiner": made.refiner, "generator": made.generator, "scorer": made.scorer}
    plain = type(made)(WORDS, **(parts if option != "replay" else {"path": made.path}))
    assert describe(made) == describe(plain)
    if option != "replay":
        assert made.replies == f"{cfg.store}/replies"
        for part in parts.values():
            assert describe(part) == describe(type(part)())


def test_keys_are_no_settings():
    """What a component is stored under, and what it shows of itself, has no place for a key."""
    with initialize_config_dir(str(conf_dir()), version_base="1.3"):
        cfg = compose("train", overrides=["prompt=a", "refine=openai"])
    assert "key" not in OmegaConf.to_yaml(cfg.refine).lower()
    assert refinement().prompt not in OmegaConf.to_yaml(cfg.refine)
