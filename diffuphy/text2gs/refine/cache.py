"""Answers kept on disk, under the hash of all that was said."""

import hashlib
import json
import os
from dataclasses import dataclass
from pathlib import Path

from diffuphy.text2gs.refine.protocols import Picture, Refinement, Refiner
from diffuphy.text2gs.refine.reply import SCHEMA, SYSTEM


@dataclass(frozen=True)
class Cached:
    """A refiner that is asked everything once.

    key = SHA-256(who is asked, instructions, schema, original, current, score, pixels)
    """

    refiner: Refiner
    folder: Path
    """One file an answer; made if missing. The words are all it holds."""

    @property
    def identity(self) -> str:
        return self.refiner.identity

    def path(self, original: str, current: str, picture: Picture | None, score: float | None) -> Path:
        """Where the answer is kept."""
        image = None if picture is None or picture.image is None else picture.image.convert("RGB")
        pixels = None if image is None else [image.size, hashlib.sha256(image.tobytes()).hexdigest()]
        rounded = None if score is None else round(score, 4)  # as it is said to the refiner
        said = [self.identity, SYSTEM, SCHEMA, original, current, rounded, pixels]
        return self.folder / f"{hashlib.sha256(json.dumps(said).encode()).hexdigest()[:32]}.json"

    def refine(
        self, original: str, current: str, picture: Picture | None, score: float | None, *, device: str
    ) -> Refinement | None:
        """The kept answer; without one, or with a damaged file, the refiner's own, which is kept."""
        path = self.path(original, current, picture, score)
        try:
            kept = json.loads(path.read_text(encoding="utf-8"))
            return None if kept is None else Refinement(**kept)
        except (FileNotFoundError, ValueError, TypeError):
            said = self.refiner.refine(original, current, picture, score, device=device)
        self.folder.mkdir(parents=True, exist_ok=True)
        partial = path.with_suffix(f".{os.getpid()}.partial")
        partial.write_text(json.dumps(said and said.asdict(), indent=1), encoding="utf-8")
        os.replace(partial, path)
        return said

    def close(self) -> None:
        self.refiner.close()
