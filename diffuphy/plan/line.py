"""One decision, and all of them."""

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Line:
    """One decision."""

    what: str
    """The part of the system decided on."""
    decision: str
    """``run``, ``cached``, ``kept``, ``left out`` or a value."""
    why: str
    seconds: float | None = None
    """Time that it takes or, left out, saves [s]; None where nothing is known to measure it by."""
    megabytes: float | None = None
    """Memory likewise [MB]."""
    would: Mapping[str, Any] = field(default_factory=dict, repr=False, compare=False)
    """Of something left out: the components, by stage name, of a run that had it."""

    @classmethod
    def kept(cls, what: str, needed: bool, why: str, why_not: str, would: Mapping[str, Any] | None = None) -> "Line":
        """A part that is kept where it is needed.

        Args:
            would: the components of a run that had it; their cost says what leaving it out saves.
        """
        return cls(what, "kept", why) if needed else cls(what, "left out", why_not, would=would or {})

    @property
    def because(self) -> str:
        """Why, and what it takes or saves."""
        if self.seconds is None and self.megabytes is None:
            return self.why
        found = [f"{amount(self.seconds)} s"] if self.seconds is not None else []
        found += [f"{amount(self.megabytes)} MB"] if self.megabytes is not None else []
        return f"{self.why}; {'saves ' if self.decision == 'left out' else 'about '}{', '.join(found)}"

    def stored(self) -> dict[str, Any]:
        """What is kept of it in a file."""
        return {f.name: getattr(self, f.name) for f in dataclasses.fields(self) if f.name != "would"}


def amount(value: float) -> str:
    """Two digits of a time or a size; nothing below a hundredth is worth a digit."""
    if abs(value) < 0.01:
        return "0"
    return f"{value:.0f}" if abs(value) >= 10 else f"{value:.2g}"


@dataclass(frozen=True)
class Plan:
    """Components with nothing left open, and the reasons."""

    components: dict[str, Any]
    lines: tuple[Line, ...]

    def __str__(self) -> str:
        width = [max(len(getattr(line, f)) for line in self.lines) for f in ("what", "decision")]
        rows = (f"  {line.what:<{width[0]}}  {line.decision:<{width[1]}}  {line.because}" for line in self.lines)
        return "plan\n" + "\n".join(rows)

    def save(self, path: Path) -> None:
        path.write_text(json.dumps([line.stored() for line in self.lines], indent=1, ensure_ascii=False))
