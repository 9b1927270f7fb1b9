"""What refines a prompt: one that draws a picture of it, one that scores the picture, one that writes a better prompt.

A component of each kind holds only settings; networks are loaded on first use and let go of by ``close``.
"""

import dataclasses
from dataclasses import dataclass
from typing import Any, Protocol


class Unavailable(RuntimeError):
    """A part of the refinement cannot answer; one line that says what to change. It ends the refinement, never the
    film."""


@dataclass(frozen=True)
class Picture:
    """A picture, and what it was asked to show."""

    prompt: str
    seed: int
    image: Any = None
    """A ``PIL.Image.Image``; None in a replay, which keeps the words and scores alone."""


@dataclass(frozen=True)
class Refinement:
    """The five steps of the chain of thought, in order (§3.2); the last one drives the loop, the others say why."""

    original_analysis: str
    """What the original prompt asks for: object, parts, materials, colours; what it leaves open."""
    current_evaluation: str
    """Whether the current prompt keeps every fact of the original, and where an image model would misread it."""
    image_assessment: str
    """What the picture shows, and what it lacks; without a picture, what it would probably lack."""
    clip_prompt: str
    """The caption a perfect picture would have, at most 20 words."""
    prompt: str
    """The refined prompt."""

    def asdict(self) -> dict[str, str]:
        return dataclasses.asdict(self)


class ImageGenerator(Protocol):
    """Draws pictures of sentences."""

    def generate(self, prompt: str, *, seed: int, device: str) -> Picture:
        """The same picture for the same prompt and seed.

        Raises:
            Unavailable: no weights, no memory.
        """
        ...

    def close(self) -> None:
        """Let go of the networks."""
        ...


class Scorer(Protocol):
    """Says how well a picture shows a sentence."""

    def score(self, picture: Picture, text: str, *, device: str) -> float:
        """Larger is better.

        Raises:
            Unavailable: no weights, no memory.
        """
        ...

    def close(self) -> None:
        """Let go of the networks."""
        ...


class Refiner(Protocol):
    """Writes a better prompt."""

    @property
    def identity(self) -> str:
        """All that decides how it answers, in words: replies are kept under it."""
        ...

    def refine(
        self, original: str, current: str, picture: Picture | None, score: float | None, *, device: str
    ) -> Refinement | None:
        """A better prompt than ``current`` for what ``original`` asks; None: there is none.

        Args:
            picture: what an image model makes of ``current``, if there is one.
            score: that of the picture.

        Raises:
            Unavailable: no network, no answer, a refusal, no usable answer after asking again.
        """
        ...

    def close(self) -> None:
        """Let go of networks and connections."""
        ...
