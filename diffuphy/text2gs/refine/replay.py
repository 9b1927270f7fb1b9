"""A refinement that took place before, walked through again: no network, no weights, no key."""

import dataclasses
import hashlib
import json
import math
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from diffuphy.text2gs.refine.loop import Refined
from diffuphy.text2gs.refine.protocols import Picture, Refinement, Unavailable
from diffuphy.types import Turn


@dataclass(frozen=True)
class Recording:
    """Refiner, generator and scorer in one: all of them say what they said.

    A recording is the result of an earlier prompt stage, ``outputs/prompt/<key>/result.json`` or that folder, or any
    JSON file ``{"turns": [{"prompt": ..., "scores": {"current": ..., "original": ...}, "reply": {...}}, ...]}``.
    """

    path: str = field(metadata={"runtime": True})
    """File, or folder with a ``result.json``."""
    sha256: str = field(init=False)
    """Of the file: what was said decides, not where it lies."""

    def __post_init__(self) -> None:
        if not self.path:
            raise ValueError("path is empty; name a recorded refinement, such as refine.path=outputs/prompt/1f2e...")
        object.__setattr__(self, "sha256", hashlib.sha256(self.file.read_bytes()).hexdigest())
        if not self.turns:
            raise ValueError(f"{self.file} holds no refinement: its list of turns is empty")

    @property
    def file(self) -> Path:
        path = Path(self.path)
        return path / "result.json" if path.is_dir() else path

    @property
    def identity(self) -> str:
        return f"the recording {self.path}"

    @cached_property
    def turns(self) -> tuple[Turn, ...]:
        """What took place.

        Raises:
            ValueError: no recording.
        """
        try:
            turns = tuple(Turn(**t) for t in json.loads(self.file.read_text(encoding="utf-8"))["turns"])
        except (ValueError, TypeError, KeyError, AttributeError):
            turns = (Turn("", {"": 0.0}),)
        if not all(map(_is_whole, turns)):
            raise ValueError(f"{self.file} is no recorded refinement; see docs/prompts.md for what it must hold")
        return turns

    def _turn(self, prompt: str) -> Turn:
        for turn in self.turns:
            if turn.prompt == prompt:
                return turn
        raise Unavailable(f"{self.identity} knows nothing of {prompt!r}; it is about {self.turns[0].prompt!r}")

    def generate(self, prompt: str, *, seed: int, device: str) -> Picture:
        """A picture without pixels."""
        return Picture(self._turn(prompt).prompt, seed)

    def score(self, picture: Picture, text: str, *, device: str) -> float:
        """What was scored, or what went wrong instead."""
        turn = self._turn(picture.prompt)
        if not turn.scores:
            raise Unavailable(turn.failure or f"{self.identity} has no score for {picture.prompt!r}")
        return turn.scores["current" if text == picture.prompt else "original"]

    def refine(
        self, original: str, current: str, picture: Picture | None, score: float | None, *, device: str
    ) -> Refinement | None:
        """What was said, None where it ended, or what went wrong."""
        if original != self.turns[0].prompt:
            raise Unavailable(f"{self.identity} is about {self.turns[0].prompt!r}, not about {original!r}")
        turn = self._turn(current)
        if turn.failure:
            raise Unavailable(turn.failure)
        return Refinement(**turn.reply) if turn.reply else None

    def close(self) -> None:
        """Nothing is held."""


def _is_whole(turn: Turn) -> bool:
    """Whether a turn that was read has the kinds of fields that a turn has."""
    if not (isinstance(turn.scores, dict) and isinstance(turn.reply, dict)):
        return False
    words = (turn.prompt, turn.failure, *turn.reply.values())
    names = {f.name for f in dataclasses.fields(Refinement)}
    return (
        all(isinstance(w, str) for w in words)
        and set(turn.scores) in (set(), {"current", "original"})
        and all(isinstance(s, int | float) and math.isfinite(s) for s in turn.scores.values())
        and set(turn.reply) in (set(), names)
    )


@dataclass(frozen=True)
class Replay(Refined):
    """Algorithm 1 with a ``Recording`` in place of the models: the same turns, and the best of them."""

    path: str = field(default="", metadata={"runtime": True})
    """The recording."""
    threshold: float | None = None
    """Score at which to stop before the recording does; None: where it ends."""
    max_iter: int = 100
    """Turns at most; a recording ends before."""

    def __post_init__(self) -> None:
        recording = Recording(self.path)
        scored = any(t.scores for t in recording.turns) or bool(recording.turns[0].failure)
        object.__setattr__(self, "refiner", recording)
        object.__setattr__(self, "generator", recording if scored else None)
        object.__setattr__(self, "scorer", recording if scored else None)
        super().__post_init__()
