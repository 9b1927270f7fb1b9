"""No refinement: the words of the prompt as they are."""

from dataclasses import dataclass

from diffuphy.text2gs.refine.grammar import items_of, lexicon, tokens
from diffuphy.text2gs.refine.rules import SIZES_ALLOWED
from diffuphy.text2gs.shapes.catalogue import RECIPES
from diffuphy.types import Look, Motion, Prompt
from diffuphy.workspace import Workspace


@dataclass(frozen=True)
class Verbatim:
    """Nothing is read into a sentence: what DiffuPhyGS (2025), §4.4, calls without LLM-CoT-IPR.

    A prior that reads text gets the prompt itself. What physics must know is what single words say: the first object
    of the library, the first material, the first motion word; everything else keeps its default.
    """

    prompt: str
    """What the film shows."""
    default_size: float = 0.5
    """Longest side [m]."""

    def __post_init__(self) -> None:
        lo, hi = SIZES_ALLOWED
        if not lo <= self.default_size <= hi:
            raise ValueError(f"default_size must be in [{lo}, {hi}] m, got {self.default_size}")

    def __call__(self, *, work: Workspace) -> Prompt:
        """The sentence as look and motion.

        Raises:
            ValueError: an empty sentence.
        """
        spoken = " ".join(str(self.prompt).split())
        if not spoken:
            raise ValueError('the prompt is empty; say what the film shows, such as prompt="a rubber burger falling"')
        roles = [item.roles for item in items_of(tokens(spoken), lexicon())]

        def first(role: str, default: str) -> str:
            return next((r[role] for r in roles if role in r), default)

        name = first("object", "")
        own = RECIPES[name].parts[0].material if name else "soft"
        verb = first("verb", "falling")
        motion = Motion(verb, spoken, {"": first("material", own)}, self.default_size)
        return Prompt(Look(name or spoken, spoken), motion)
