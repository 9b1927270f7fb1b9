"""What the participants said, checked against what they were asked."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.study.design import CRITERIA, Refused

LARGEST = 4 << 20
"""A file of ratings is smaller than this [B]."""


@dataclass(frozen=True)
class Key:
    """Which film is whose."""

    study: str
    films: dict[str, dict[str, str]]
    items: dict[str, dict]

    @classmethod
    def load(cls, path: Path) -> "Key":
        held = _json(path)
        try:
            return cls(held["study"], held["films"], {item["id"]: item for item in held["items"]})
        except (KeyError, TypeError):
            raise Refused(f"{path} is no key of a study; it is the key.json that `study build` wrote") from None


@dataclass(frozen=True)
class Score:
    """A film on the scale from 1 to 5."""

    participant: str
    prompt: str
    method: str
    value: dict[str, int]


@dataclass(frozen=True)
class Preference:
    """Two films of one prompt: 1 where the first is better, 0 where the second is, ½ for no difference."""

    participant: str
    prompt: str
    methods: tuple[str, str]
    value: dict[str, float]


@dataclass(frozen=True)
class Ratings:
    """All that counts, and who was left out."""

    scores: list[Score]
    preferences: list[Preference]
    participants: list[str]
    excluded: dict[str, str]
    """Why a participant does not count, by name."""


def read(key: Key, files: Sequence[Path], *, missed: int = 1) -> Ratings:
    """Read and check files of ratings.

    Args:
        missed: pairs of a film with itself in which a participant may see a difference and still count; one pair is
            missed when any criterion is answered with a side.

    Raises:
        Refused: a file of another study, one that is no file of ratings, or two files of one participant.
    """
    scores: list[Score] = []
    preferences: list[Preference] = []
    participants: dict[str, Path] = {}
    excluded: dict[str, str] = {}
    for file in files:
        held = _json(file)
        if not isinstance(held, dict) or held.get("format") != "diffuphy-study-1":
            raise Refused(f"{file} is no file of ratings (format diffuphy-study-1)")
        if held.get("study") != key.study:
            raise Refused(f"{file} belongs to study {held.get('study')!r}, the key to {key.study!r}")
        who = str(held.get("participant"))
        if who in participants:
            raise Refused(f"{file} and {participants[who]} are of the same participant; keep one")
        participants[who] = file
        mine, pairs, wrong = _answers(key, who, held.get("answers"), file)
        if len(mine) + len(pairs) + wrong[1] < len(key.items):
            excluded[who] = f"answered {len(mine) + len(pairs) + wrong[1]} of {len(key.items)}"
        elif wrong[0] > missed:
            excluded[who] = f"saw a difference in {wrong[0]} of {wrong[1]} pairs of a film with itself"
        else:
            scores += mine
            preferences += pairs
    counted = [who for who in participants if who not in excluded]
    if not counted:
        raise Refused(f"no participant counts: {'; '.join(excluded.values()) or 'no file of ratings'}")
    return Ratings(scores, preferences, counted, excluded)


def _answers(key: Key, who: str, answers: object, file: Path) -> tuple[list[Score], list[Preference], tuple[int, int]]:
    """Scores, preferences, and (missed, shown) pairs of a film with itself."""
    scores, pairs, wrong, shown = [], [], 0, 0
    seen: set[str] = set()
    if not isinstance(answers, list):
        raise Refused(f"{file} has no list of answers")
    for answer in answers:
        name = answer.get("item") if isinstance(answer, dict) else None
        item = key.items.get(name)
        if item is None or name in seen or sorted(answer.get("films", ())) != sorted(item["films"]):
            raise Refused(f"{file}: answer {name!r} is not one of this study's, or comes twice")
        seen.add(name)
        allowed = {"score": (1, 2, 3, 4, 5), "pair": ("left", "none", "right")}[item["kind"]]
        given = {c: answer.get(c) for c in CRITERIA}
        for criterion, value in given.items():
            if type(value) is not type(allowed[0]) or value not in allowed:
                raise Refused(f"{file}: answer {name}: {criterion} must be one of {allowed}, got {value!r}")
        methods = [key.films[f]["method"] for f in answer["films"]]
        if item["kind"] == "score":
            scores.append(Score(who, item["prompt"], methods[0], given))
        elif answer["films"][0] == answer["films"][1]:
            shown += 1
            wrong += any(v != "none" for v in given.values())
        else:
            value = {c: {"left": 1.0, "none": 0.5, "right": 0.0}[v] for c, v in given.items()}
            pairs.append(Preference(who, item["prompt"], (methods[0], methods[1]), value))
    return scores, pairs, (wrong, shown)


def _json(path: Path) -> dict:
    if path.stat().st_size > LARGEST:
        raise Refused(f"{path} has {path.stat().st_size} bytes; a file of ratings has fewer than {LARGEST}")
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as trouble:
        raise Refused(f"{path} is no JSON: {trouble}") from None
