"""Refiners that talk: a language model is asked, its answer is read, and asked for again if it cannot be used."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from diffuphy.text2gs.refine.protocols import Picture, Refinement, Unavailable
from diffuphy.text2gs.refine.reply import Message, Unusable, correction, opening, parse


@dataclass(frozen=True)
class Chat:
    """Base of the refiners with a language model. A backend says who it is and answers one conversation."""

    corrections: int = field(default=2, kw_only=True)
    """How often a model is told what is wrong with its answer before it is given up; small local ones need it."""

    def __post_init__(self) -> None:
        if self.corrections < 0:
            raise ValueError(f"corrections must not be negative, got {self.corrections}")

    @property
    def identity(self) -> str:
        raise NotImplementedError

    def ask(self, messages: Sequence[Message], *, device: str) -> str:
        """The model's next message.

        Raises:
            Unavailable: it cannot be asked, or refuses.
            Unusable: it was cut off or left empty.
        """
        raise NotImplementedError

    def clean(self, text: str) -> str:
        """The text without what must not be kept."""
        return text

    def close(self) -> None:
        """Let go of networks and connections."""

    def refine(
        self, original: str, current: str, picture: Picture | None, score: float | None, *, device: str
    ) -> Refinement:
        """See ``Refiner.refine``."""
        messages = opening(original, current, picture, score)
        fault: Unusable | None = None
        for _ in range(self.corrections + 1):
            text = ""
            try:
                text = self.ask(messages, device=device)
                said = parse(text)
            except Unusable as e:
                fault = e
                messages += correction(text, e)
                continue
            return replace(said, **{name: self.clean(value) for name, value in said.asdict().items()})
        raise Unavailable(f"{self.identity} gave {self.corrections + 1} answers that cannot be used; the last: {fault}")
