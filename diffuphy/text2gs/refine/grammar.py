"""The grammar of prompts: words to phrases, phrases to a reading.

It is that of a noun phrase: words before the noun, "made of" after it, parts after "with", what is left out after
"without", surroundings after a preposition, a verb anywhere.
"""

import functools
import itertools
import re
import unicodedata
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from diffuphy.text2gs.refine import words as w
from diffuphy.text2gs.shapes.catalogue import RECIPES, WORDS, plural
from diffuphy.text2gs.shapes.primitives import Recipe

COLLECTIVE = {
    "tower": {"cube": "tower", "pancakes": "pancakes"},
    "gravel pile": {"cube": "tower", "pancakes": "pancakes"},
}
"""What a stack or pile of another object is."""


def _forms(phrases: Iterable[str]) -> set[tuple[str, ...]]:
    """The phrases and their plurals, split into words."""
    return {tuple(f.split()) for p in phrases for f in (p, plural(p))}


@functools.cache
def lexicon() -> dict[tuple[str, ...], dict[str, Any]]:
    """Phrase → its roles: object, material, colour, verb, size."""
    table: dict[tuple[str, ...], dict[str, Any]] = {}

    def enter(phrases: Iterable[tuple[str, ...]], role: str, value: Any) -> None:
        for phrase in phrases:
            table.setdefault(phrase, {})[role] = value

    for word, name in WORDS.items():
        enter(_forms([word]), "object", name)
    for word, others in w.MATERIALS.items():
        enter(_forms([word, *others]), "material", word)
    for word, others in w.COLOURS.items():
        enter(_forms([word, *others]), "colour", word)
    for verb, forms in w.VERBS.items():
        enter((tuple(f.split()) for f in (verb, *forms)), "verb", verb)
    for word, factor in w.SIZES.items():
        enter([(word,)], "size", factor)
    return table


@functools.cache
def lexicon_of(name: str) -> dict[tuple[str, ...], dict[str, Any]]:
    """The lexicon with the parts of an object added."""
    table = {phrase: dict(roles) for phrase, roles in lexicon().items()}
    for part in RECIPES[name].parts:
        for phrase in _forms([part.name, *part.words]):
            table.setdefault(phrase, {})["part"] = part.name
    return table


def tokens(text: str) -> list[str]:
    """Lower-case words, numbers and commas of a sentence in any script; accents, emoji and other marks fall away."""
    plain = unicodedata.normalize("NFKD", text).casefold()
    plain = "".join(c for c in plain if not unicodedata.combining(c))
    plain = re.sub(r"['’`]s\b|\b[34]d\b|\b[48]k\b", " ", plain)
    plain = re.sub(r"(?<=\d),(?=\d)", ".", plain)
    return re.findall(r"\d+(?:\.\d+)?|[^\W\d_]+|,", plain)


@dataclass
class Item:
    """A phrase of the sentence and the roles it may play."""

    text: str
    roles: dict[str, Any]


def items_of(words: list[str], lexicon: dict[tuple[str, ...], dict[str, Any]]) -> list[Item]:
    """The sentence cut into the longest known phrases."""
    out, i = [], 0
    longest = max(map(len, lexicon))
    while i < len(words):
        n = next((n for n in range(longest, 1, -1) if tuple(words[i : i + n]) in lexicon and i + n <= len(words)), 1)
        phrase = tuple(words[i : i + n])
        out.append(Item(" ".join(phrase), lexicon.get(phrase, {})))
        i += n
    return out


def means_nothing(item: Item) -> bool:
    """Whether a word has no role and builds no sentence."""
    return not item.roles and item.text not in (*w.FILLERS, *w.PLACES, *w.JOINS, *w.WITHOUT, "with", "of", "made")


def is_foreign(items: list[Item]) -> bool:
    """Whether the first noun phrase holds words that mean nothing here ("an old boot made of jelly")."""
    phrase = itertools.takewhile(lambda i: i.text not in ("with", "made", *w.JOINS, *w.WITHOUT, *w.PLACES), items)
    return any(map(means_nothing, phrase))


def head_of(items: list[Item]) -> str | None:
    """Name of the object that the sentence is about: the last object word of the first noun phrase that has one."""
    found: str | None = None
    collective = False
    for item in items:
        ends = "verb" in item.roles or item.text in ("with", "made", *w.JOINS, *w.WITHOUT, *w.PLACES)
        if found is None or not ends:
            name = item.roles.get("object")
            if name is not None and not collective:
                found = name
            elif collective and name in COLLECTIVE[found]:
                return COLLECTIVE[found][name]
            if item.text == "of" and found is not None:
                if found not in COLLECTIVE:
                    return found
                collective = True
        else:
            break
    return found


@dataclass
class Reading:
    """What has been understood so far."""

    subject: str
    materials: dict[str, list[str]] = field(default_factory=dict)
    colours: dict[str, list[str]] = field(default_factory=dict)
    verbs: list[str] = field(default_factory=list)
    removed: list[str] = field(default_factory=list)
    negatives: list[str] = field(default_factory=list)
    unknown: list[str] = field(default_factory=list)
    factor: float = 1.0
    lengths: list[float] = field(default_factory=list)


class Reader:
    """Walks over the items once; `target` is the noun that "made of" would speak about, `pending` the adjectives that
    wait for one, `collecting` is true between "a stack" and the noun it is a stack of."""

    def __init__(self, items: list[Item], recipe: Recipe | None):
        self.items, self.recipe = items, recipe
        self.reading = Reading(recipe.name if recipe else "")
        self.pending: list[tuple[str, str]] = []
        self.target, self.expecting, self.collecting = "", False, False
        self.i = 0

    def read(self) -> Reading:
        while self.i < len(self.items):
            item = self.items[self.i]
            if not (self._skipped(item) or self._quantity(item) or self._noun(item)):
                self.reading.unknown.append(item.text)
            self.i += 1
        self._flush("")
        return self.reading

    def _flush(self, target: str) -> None:
        """Give the waiting adjectives to a noun."""
        for kind, word in self.pending:
            (self.reading.materials if kind == "material" else self.reading.colours).setdefault(target, []).append(word)
        self.pending = []

    def _skipped(self, item: Item) -> bool:
        """Words that build the sentence: negation, surroundings, "made of", joins, fillers."""
        if item.text in w.WITHOUT:
            self._negation()
        elif item.text == "made":
            self.expecting = True
            while self.i + 1 < len(self.items) and self.items[self.i + 1].text in w.MADE:
                self.i += 1
        elif item.text in w.PLACES:
            self._surroundings()
        elif item.text == "of" and self.recipe is None and self._is_free(self.i + 1):
            self.reading.unknown.append("of")
        elif item.text == "of":
            self.expecting = not self.collecting
            if self.target == "" and self.recipe is not None and self.recipe.of and not self.pending:
                self.target = self.recipe.of
        elif item.text in w.JOINS or item.text == "with":
            self._flush(self.target if self.expecting else "")
            self.expecting = False
            self.target = "" if item.text != "with" else self.target
        else:
            return item.text in w.FILLERS and not item.roles
        return True

    def _is_free(self, i: int) -> bool:
        """Whether there is an item i, and it is a word without a meaning here."""
        return i < len(self.items) and means_nothing(self.items[i])

    def _negation(self) -> None:
        """Read "without cheese, lettuce and onions": parts are removed, other words go to the negative prompt."""
        while self.i + 1 < len(self.items):
            item = self.items[self.i + 1]
            if (
                "verb" in item.roles
                or item.text in ("with", "made", "then", "while", "but", *w.PLACES)
                or re.match(r"\d", item.text)
            ):
                break
            if "part" in item.roles:
                self.reading.removed.append(item.roles["part"])
            elif item.text not in w.AND and item.text not in w.FILLERS and item.text not in w.WITHOUT:
                self.reading.negatives.append(item.text)
            self.i += 1

    def _surroundings(self) -> None:
        """Pass over "onto a wooden table"; an object among the words would be a second one."""
        self._flush("")
        while self.i + 1 < len(self.items):
            item = self.items[self.i + 1]
            if "verb" in item.roles or item.text in ("with", "made", *w.JOINS, *w.WITHOUT):
                break
            if "object" in item.roles and "part" not in item.roles and self._is_thing(self.i + 1):
                raise ValueError(f"one object a scene: {item.text!r} is a second one; leave it out")
            self.i += 1

    def _is_thing(self, i: int) -> bool:
        """Whether the object word at i of the surroundings is one: of those that are materials too, "a jelly" is, and
        "jelly" and "a jelly floor" are not."""
        if "material" not in self.items[i].roles:
            return True
        ends = i + 1 == len(self.items) or self.items[i + 1].text in ("with", "made", *w.JOINS, *w.WITHOUT, *w.PLACES)
        article = next((item.text for item in reversed(self.items[:i]) if not item.roles), "")
        return (ends or "verb" in self.items[i + 1].roles) and article in ("a", "an", "another")

    def _quantity(self, item: Item) -> bool:
        """Lengths ("30 cm", "half a metre"), size words, counts."""
        r = self.reading
        if "size" in item.roles:
            r.factor *= item.roles["size"]
            return True
        if not (re.match(r"\d", item.text) or item.text in w.NUMBERS):
            return False
        number = w.NUMBERS[item.text] if item.text in w.NUMBERS else float(item.text)
        after = [x.text for x in self.items[self.i + 1 : self.i + 3]]
        after_article = after[1:] if after[:1] in (["a"], ["an"]) else after
        unit = next((u for u in after_article[:1] for u in (u, u.removesuffix("s")) if u in w.UNITS or u == "in"), None)
        last = self.i + 1 + len(after) - len(after_article)
        told = after_article[:1] if unit is None else [x.text for x in self.items[last + 1 : last + 2]]
        if {x for u in told for x in (u, u.removesuffix("s"))} & w.NO_LENGTHS:
            quantity = " ".join(x.text for x in self.items[self.i : last + (1 if unit is None else 2)])
            raise ValueError(f"cannot place {quantity!r}: {w.NO_QUANTITY}")
        if unit is None:
            if number != 1:
                raise ValueError(
                    f"one object a scene: cannot place the number {item.text!r}; a size needs a unit, such as 30 cm"
                )
            return True
        r.lengths.append(number * (w.UNITS["inch"] if unit == "in" else w.UNITS[unit]))
        self.i += 1 + (len(after) - len(after_article))
        return True

    def _noun(self, item: Item) -> bool:
        """The subject, its parts, its materials and colours, its verbs."""
        r, roles, recipe = self.reading, item.roles, self.recipe
        if recipe is not None and self._is_subject(item, recipe):
            self._flush("")
            self.target, self.expecting = "", False
            self.collecting = roles["object"] != recipe.name and recipe.name != "mound"
        elif recipe is not None and "part" in roles and not (self.expecting and "material" in roles):
            self._part(recipe, roles)
        elif "material" in roles or "colour" in roles:
            kind = "material" if "material" in roles else "colour"
            if self.expecting:
                (r.materials if kind == "material" else r.colours).setdefault(self.target, []).append(roles[kind])
            else:
                self.pending.append((kind, roles[kind]))
        elif "verb" in roles:
            self._flush("")
            self.target, self.expecting = "", False
            r.verbs.append(roles["verb"])
        elif "object" in roles and recipe is not None:
            raise ValueError(f"one object a scene: {item.text!r} is a second one beside {r.subject!r}; leave it out")
        else:
            return False
        return True

    def _part(self, recipe: Recipe, roles: dict[str, Any]) -> None:
        """A part, made of what waits for a noun; or of what its name says ("pancakes with honey": the syrup is
        honey)."""
        part = next(p for p in recipe.parts if p.name == roles["part"])
        if not self.pending and roles.get("material", part.material) != part.material:
            self.pending = [("material", roles["material"])]
        self._flush(part.name)
        self.target, self.expecting = part.name, False

    def _is_subject(self, item: Item, recipe: Recipe) -> bool:
        """An object word that names the subject and is not spoken of as a material ("a duck of cake"), part or
        modifier."""
        name = item.roles.get("object")
        named = name == recipe.name or (name in COLLECTIVE and recipe.name in (*COLLECTIVE[name].values(), "mound"))
        return named and not (self.expecting and "material" in item.roles)
