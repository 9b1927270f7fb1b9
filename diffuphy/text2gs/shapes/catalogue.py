"""The table of objects, found by name."""

import difflib

from diffuphy.text2gs.shapes import food, garden, sweets, things, toys
from diffuphy.text2gs.shapes.primitives import Recipe

RECIPES: dict[str, Recipe] = {
    r.name: r for r in (*food.RECIPES, *sweets.RECIPES, *garden.RECIPES, *toys.RECIPES, *things.RECIPES)
}
"""Objects by canonical name."""

WORDS: dict[str, str] = {w: r.name for r in RECIPES.values() for w in (r.name, *r.words)}
"""Every singular word or phrase for an object, and the canonical name it stands for."""


IRREGULAR = {"tomato": "tomatoes", "man": "men", "leaf": "leaves", "cactus": "cacti"}
"""Endings of singular words, and of their plurals."""


def plural(phrase: str) -> str:
    """English plural of the last word ("teddy bear" → "teddy bears", "cherry" → "cherries")."""
    for end, many in IRREGULAR.items():
        if phrase.endswith(end):
            return phrase.removesuffix(end) + many
    if phrase.endswith(("s", "x", "ch", "sh")):
        return phrase + "es"
    if phrase.endswith("y") and phrase[-2] not in "aeiou":
        return phrase[:-1] + "ies"
    return phrase + "s"


def find(subject: str) -> Recipe:
    """The object that a word stands for.

    Raises:
        ValueError: for a word that names none; the message lists the nearest names.
    """
    word = " ".join(subject.lower().split())
    for candidate in (word, *(w for w in WORDS if plural(w) == word)):
        if candidate in WORDS:
            return RECIPES[WORDS[candidate]]
    near = difflib.get_close_matches(word, WORDS, n=3, cutoff=0.5)
    hint = f"did you mean {' or '.join(near)}? " if near else ""
    raise ValueError(f"no object of the library is called {subject!r}; {hint}it has: {', '.join(sorted(RECIPES))}")
