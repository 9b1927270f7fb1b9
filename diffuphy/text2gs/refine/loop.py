"""Iterative prompt refinement: draw, score, think, rewrite (§3.2, Algorithm 1)."""

import logging
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from diffuphy.text2gs.refine.cache import Cached
from diffuphy.text2gs.refine.protocols import ImageGenerator, Picture, Refiner, Scorer, Unavailable
from diffuphy.text2gs.refine.rules import Rules
from diffuphy.types import Prompt, Turn
from diffuphy.workspace import Workspace

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Refined(Rules):
    """The sentence understood by ``Rules``, then its words for an image model refined by a language model.

        y₀ = words of the rules,   I_n = G(y_n),   s_n = S(I_n, y_n),   y_{n+1} = R(y₀, y_n, I_n, s_n),
        y* = argmax_n s_n,   stops at s_n ≥ threshold or n = max_iter

    Algorithm 1, with three differences: the refiner is not asked after the last picture, a prompt that was already
    tried ends the loop, and so does a part that cannot answer. Whatever happens there is a result: the best prompt
    scored so far, which at worst is that of the rules. Materials, motion and size stay those of the sentence.
    """

    refiner: Refiner | None = None
    """Writes the prompts."""
    generator: ImageGenerator | None = None
    """Draws them; None: the refiner sees no picture."""
    scorer: Scorer | None = None
    """Compares them; None: nothing can be compared, the refiner is asked once and its prompt is taken."""
    score_against: Literal["current", "original", "min"] = "current"
    """Which words a picture must show: its own prompt (Algorithm 1, which rewards a drift to what is easy to draw), the
    words of the rules, or the worse of both."""
    threshold: float | None = 0.32
    """Score that is good enough; None: none is. The paper names no value; pictures that show their caption have CLIP
    ViT-B/32 cosines of 0.25 to 0.35."""
    max_iter: int = 5
    """Prompts that are tried, that of the rules among them. The paper names no value."""
    seed: int = 0
    """Of the pictures; the same for all, so that prompts are compared and not noise."""
    replies: str = field(default="", metadata={"runtime": True})
    """Folder in which answers are kept, so that nothing is asked twice; empty: nowhere."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.refiner is None:
            raise ValueError("refiner is missing; choose one, such as refine=openai, or refine=rules without any")
        if self.scorer is not None and self.generator is None:
            raise ValueError("a scorer needs pictures; choose a generator, or set scorer to null as well")
        if self.score_against not in ("current", "original", "min"):
            raise ValueError(f"score_against must be 'current', 'original' or 'min', got {self.score_against!r}")
        if self.max_iter < 1:
            raise ValueError(f"max_iter must be at least 1, got {self.max_iter}")

    def __call__(self, *, work: Workspace) -> Prompt:
        """The refined sentence, with every turn that led to it.

        Raises:
            ValueError: a sentence that the rules do not understand.
        """
        prompt = super().__call__(work=work)
        try:
            turns = self._turns(prompt.look.text, work)
        finally:
            for part in (self.refiner, self.generator, self.scorer):
                if part is not None:
                    part.close()
        best = self.best(turns)
        if turns[-1].failure:
            log.warning(
                "prompt refinement ended early: %s; the best prompt so far is kept, %r; force=prompt tries again",
                turns[-1].failure,
                best.prompt,
            )
        return replace(prompt, look=replace(prompt.look, text=best.prompt), turns=turns)

    def score(self, turn: Turn) -> float:
        """The score that counts, of a turn that was scored."""
        against = {"current": ("current",), "original": ("original",), "min": ("current", "original")}
        return min(turn.scores[name] for name in against[self.score_against])

    def best(self, turns: tuple[Turn, ...]) -> Turn:
        """The first of the best; without scores the last one."""
        if self.scorer is None:
            return turns[-1]
        return max((t for t in turns if t.scores), key=self.score, default=turns[0])

    # ------------------------------------------------------------------ the loop
    def _turns(self, original: str, work: Workspace) -> tuple[Turn, ...]:
        """At least one; only the last has no reply."""
        refiner = Cached(self.refiner, Path(self.replies)) if self.refiner and self.replies else self.refiner
        most = 2 if self.scorer is None else self.max_iter
        turns: list[Turn] = []
        current: str | None = original
        while current is not None:
            turn = self._turn(original, current, refiner, work, number=len(turns), last=len(turns) + 1 == most)
            turns.append(turn)
            score = {"score": self.score(turn)} if turn.scores else {}
            work.log(len(turns) - 1, prompt=current, **score)
            log.info(
                "prompt %d of at most %d%s: %s",
                len(turns),
                most,
                "".join(f", {s:.4f}" for s in score.values()),
                current,
            )
            current = turn.reply.get("prompt")
            if current in [t.prompt for t in turns]:
                break
        return tuple(turns)

    def _turn(
        self, original: str, current: str, refiner: Refiner | None, work: Workspace, *, number: int, last: bool
    ) -> Turn:
        """One prompt drawn, scored and, if there is something left to do, rewritten."""
        turn = Turn(current)
        try:
            picture = None if self.scorer is None and last else self._draw(current, work, number)
            if self.scorer is not None and picture is not None:
                own = self.scorer.score(picture, current, device=work.device)
                first = own if current == original else self.scorer.score(picture, original, device=work.device)
                turn = replace(turn, scores={"current": own, "original": first})
            score = self.score(turn) if turn.scores else None
            good = score is not None and self.threshold is not None and score >= self.threshold
            if last or good or refiner is None:
                return turn
            said = refiner.refine(original, current, picture, score, device=work.device)
            return turn if said is None else replace(turn, reply=said.asdict())
        except Unavailable as e:
            return replace(turn, failure=str(e))

    def _draw(self, prompt: str, work: Workspace, number: int) -> Picture | None:
        """The picture, with a copy for people."""
        if self.generator is None:
            return None
        picture = self.generator.generate(prompt, seed=self.seed, device=work.device)
        if picture.image is not None:
            import numpy as np
            import torch

            work.image(f"prompt_{number}", torch.from_numpy(np.array(picture.image.convert("RGB"))) / 255)
        return picture
