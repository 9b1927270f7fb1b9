"""What a language model is told, and how its answer is read."""

import dataclasses
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from diffuphy.text2gs.refine.length import LIMIT, tokens
from diffuphy.text2gs.refine.protocols import Picture, Refinement

LONGEST = 2000
"""Characters that a field of an answer may have; more is a model that does not stop."""
WHOLE = 10 * LONGEST
"""Characters of an answer that are looked at: twice what five fields may have."""

STEPS = {
    "original_analysis": "Analyze the original prompt: the object, its parts, materials and colours; what it leaves "
    "open; whether it is too brief, too long or its logic too complex.",
    "current_evaluation": "Evaluate the current prompt: does it keep every fact of the original; what would an image "
    "model misread in it?",
    "image_assessment": "Assess the image that was generated from the current prompt: what does it show, what is wrong "
    "or missing? Without an image, say what would probably be wrong.",
    "clip_prompt": "Write a caption of at most 20 words that a perfect image would have.",
    "prompt": "Refine the prompt for optimal length, clarity and logical complexity.",
}
"""The chain of thought of §3.2, step by step: field of the answer → what is to be written there."""

_NUMBERED = "\n".join(f"{i}) {name}: {text}" for i, (name, text) in enumerate(STEPS.items(), 1))
SYSTEM = f"""You refine prompts for a text-to-3D system whose text encoder is CLIP. It has seen short captions and \
does not follow complex logic. The score is the CLIP similarity of image and prompt; higher is better.
Think step by step and write down every step:
{_NUMBERED}
Rules for the refined prompt: one English sentence of at most 50 words, which must fit into {LIMIT} CLIP tokens. One \
object, whole, centered, on a plain background. Say what it looks like, not how it moves. Keep every fact of the \
original; add only what makes the object more definite: typical parts, colours, textures. Do not repeat the current \
prompt.
Answer with one JSON object that has exactly these keys, in this order, each a string: {", ".join(STEPS)}."""

SCHEMA: dict[str, Any] = {
    "type": "object",
    "properties": {name: {"type": "string", "description": text} for name, text in STEPS.items()},
    "required": list(STEPS),
    "additionalProperties": False,
}
"""The answer as JSON Schema, in the subset that strict structured output accepts."""


class Unusable(ValueError):
    """An answer that cannot be used; the message says to the model what is wrong."""


@dataclass(frozen=True)
class Message:
    """One message of a conversation."""

    role: str
    """``system``, ``user`` or ``assistant``."""
    text: str
    image: Any = None
    """A ``PIL.Image.Image`` beside the text."""


def opening(original: str, current: str, picture: Picture | None, score: float | None) -> list[Message]:
    """The conversation up to the first answer."""
    asked: dict[str, Any] = {"original prompt": original, "current prompt": current}
    if score is not None:
        asked["score of the image"] = round(score, 4)
    image = None if picture is None else picture.image
    asked["image"] = "none" if image is None else "attached"
    return [Message("system", SYSTEM), Message("user", json.dumps(asked, ensure_ascii=False), image)]


def correction(text: str, fault: Unusable) -> list[Message]:
    """What follows an unusable answer; of an endless one the beginning is enough."""
    text = text[:WHOLE].encode(errors="replace").decode()
    again = f"That cannot be used: {fault}. Answer again with the JSON object alone."
    return [*([Message("assistant", text)] if text else []), Message("user", again)]


def parse(text: str) -> Refinement:
    """The answer in ``text``: JSON alone, fenced, or the first object of that kind among other words.

    Raises:
        Unusable: no such object, or one with other fields, empty or endless ones, or a prompt that CLIP would cut.
    """
    fault = Unusable("it holds no JSON object")
    for found in _objects(text[:WHOLE]):
        try:
            return _checked(found)
        except Unusable as e:
            fault = e
    raise fault


def _objects(text: str) -> Iterator[dict[str, Any]]:
    """JSON objects in a text, from left to right, none inside another; small models wrap theirs in prose."""
    decoder, at = json.JSONDecoder(strict=False), 0
    while (start := text.find("{", at)) >= 0:
        try:
            found, at = decoder.raw_decode(text, start)
        except (ValueError, RecursionError):
            at = start + 1
            continue
        yield found


def _checked(found: dict[str, Any]) -> Refinement:
    names = [f.name for f in dataclasses.fields(Refinement)]
    if missing := [n for n in names if n not in found]:
        raise Unusable(f"the key {missing[0]!r} is missing")
    if wrong := [n for n in names if not isinstance(found[n], str)]:
        raise Unusable(f"{wrong[0]!r} must be a string, got {type(found[wrong[0]]).__name__}")
    fields = {n: " ".join(re.sub(r"[\x00-\x1f\x7f]", " ", found[n]).split()) for n in names}
    if halves := [n for n in names if re.search(r"[\ud800-\udfff]", fields[n])]:
        raise Unusable(f"{halves[0]!r} has half a character (a surrogate), which no file can hold")
    if endless := [n for n in names if len(fields[n]) > LONGEST]:
        raise Unusable(f"{endless[0]!r} has {len(fields[endless[0]])} characters, at most {LONGEST} are allowed")
    if not re.search(r"[^\W\d_]", fields["prompt"]):
        raise Unusable("'prompt' has no words")
    if (n := tokens(fields["prompt"])) > LIMIT:
        raise Unusable(f"'prompt' has {n} CLIP tokens, at most {LIMIT} are allowed; shorten it")
    return Refinement(**fields)
