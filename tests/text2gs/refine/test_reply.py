"""Answers of language models: what is found in them, what is wrong with them, how long they are for CLIP."""

import json
import sys
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

sys.path.insert(0, str(Path(__file__).parent))
from loopback import answer, refinement

from diffuphy.text2gs.refine import Picture, length
from diffuphy.text2gs.refine.reply import LONGEST, SCHEMA, STEPS, SYSTEM, Unusable, opening, parse


def flawed(**changes) -> str:
    fields = refinement().asdict() | changes
    return json.dumps({k: v for k, v in fields.items() if v is not None})


@pytest.mark.parametrize(
    "text",
    [
        answer(),
        f"```json\n{answer()}\n```",
        f'<think>{{maybe}} {{"a": 1}}</think> Here: {answer()} Done {{',
        flawed(extra="more"),
        answer().replace("brief", "br\\nief").replace("br\\nief", "\\u0062rief"),
        answer().replace('"brief"', '"\\tbrief\\u0000 "'),
        answer(1) + answer(2),
    ],
    ids=["alone", "fenced", "among prose", "an extra key", "escapes", "control characters", "the first of two"],
)
def test_the_answer_is_found(text):
    assert parse(text) == refinement()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "holds no JSON object"),
        ("[1]", "holds no JSON object"),
        (answer()[:-1], "holds no JSON object"),
        (flawed(prompt=None), "'prompt' is missing"),
        (flawed(prompt=3), "'prompt' must be a string, got int"),
        (flawed(prompt=" "), "'prompt' has no words"),
        (flawed(prompt="12, ..."), "'prompt' has no words"),
        (flawed(image_assessment="x" * (LONGEST + 1)), "'image_assessment' has 2001 characters"),
        (flawed(clip_prompt="\udc00"), "half a character"),
        (json.dumps({"answer": refinement().asdict()}), "'original_analysis' is missing"),
        ('{"a":' * 100_000, "holds no JSON object"),
    ],
)
def test_an_answer_that_cannot_be_used_says_why(text, says):
    with pytest.raises(Unusable, match=says):
        parse(text)


JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.text(max_size=9),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from([*STEPS, "x"]), inner, max_size=6),
    max_leaves=9,
)


@settings(max_examples=200)
@given(st.text(max_size=40), JSON, st.text(max_size=40))
def test_no_answer_breaks_the_reader(before, value, after):
    """Anything is either an answer that a file can hold, or unusable."""
    try:
        said = parse(before + json.dumps(value) + after)
    except Unusable:
        return
    json.dumps(said.asdict(), ensure_ascii=False).encode()


def test_schema_instructions_and_answer_have_the_same_keys():
    """In the order of the chain of thought: a model that writes from left to right thinks before it decides."""
    keys = list(refinement().asdict())
    assert keys == list(SCHEMA["properties"]) == SCHEMA["required"]
    assert [SYSTEM.index(f") {k}: ") for k in keys] == sorted(SYSTEM.index(f") {k}: ") for k in keys)


def test_the_opening_says_what_is_known():
    picture = Picture("b", 0, image=object())
    *_, user = opening("a «burger»", "b", picture, 0.12345678)
    assert json.loads(user.text) == {
        "original prompt": "a «burger»",
        "current prompt": "b",
        "score of the image": 0.1235,
        "image": "attached",
    }
    assert user.image is picture.image
    *_, user = opening("a", "b", None, None)
    assert json.loads(user.text) == {"original prompt": "a", "current prompt": "b", "image": "none"}


# ---------------------------------------------------------------------- length
def test_tokens_are_those_of_clip():
    """<start> a photo of a cat <end>; ids of the published vocabulary, in which "cat" is one token."""
    assert length._tokenizer()("a photo of a cat") == [320, 1125, 539, 320, 2368]
    assert length.tokens("cat " * 75) == 77


def test_a_prompt_leaves_room_for_the_view():
    """What fills the limit is read whole by CLIP with the words of the view behind it; one word more is refused."""
    fits = "cat " * 72
    assert parse(flawed(prompt=fits)).prompt == fits.strip()
    views = {"front view", "side view", "back view", "overhead view"}
    assert max(length.tokens(f"{fits.strip()}, {v}") for v in views) == 77
    with pytest.raises(Unusable, match="has 75 CLIP tokens, at most 74"):
        parse(flawed(prompt="cat " * 73))


@settings(max_examples=50)
@given(st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=90))
def test_the_shortcut_never_lets_a_long_text_through(text):
    """A token is at least one character of ASCII: what is short in characters is short in tokens."""
    exact = len(length._tokenizer()(text)) + 2
    assert (length.tokens(text) <= length.LIMIT) == (exact <= length.LIMIT)
