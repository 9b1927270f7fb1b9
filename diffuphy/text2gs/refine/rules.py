"""Sentences by rule: an object of the library, what it is made of, what happens to it, how large it is.

What the grammar reads is written out again in canonical words, so that sentences that mean the same give the same
result.
See docs/prompts.md.
"""

import difflib
from dataclasses import dataclass

from diffuphy.text2gs.refine import words as w
from diffuphy.text2gs.refine.grammar import (
    Item,
    Reader,
    Reading,
    head_of,
    is_foreign,
    items_of,
    lexicon,
    lexicon_of,
    means_nothing,
    tokens,
)
from diffuphy.text2gs.shapes.catalogue import RECIPES, WORDS
from diffuphy.text2gs.shapes.primitives import Recipe
from diffuphy.text2gs.shapes.tints import TINTS
from diffuphy.types import Look, Motion, Prompt
from diffuphy.workspace import Workspace

REMEDY = "or use guidance=stable_diffusion for a prior that draws anything"
SIZES_ALLOWED = (0.005, 50.0)
"""Longest side that makes sense for the laws and the grid [m]."""

ADJECTIVES = {"icecream": "ice cream", "wood": "wooden"}
DOING = {
    "falling": "falling onto the ground",
    "bouncing": "bouncing on the ground",
    "thrown": "being thrown across the ground",
    "spinning": "spinning above the ground",
    "sliding": "sliding along the ground",
    "rolling": "rolling along the ground",
    "melting": "melting on the ground",
    "collapsing": "collapsing on the ground",
    "squashed": "being squashed on the ground",
    "poked": "being poked on the ground",
}
"""Verb phrases of `Motion.text`."""


@dataclass(frozen=True)
class Rules:
    """Understands a sentence by rules; offline, deterministic."""

    prompt: str
    """What the film shows ("a rubber burger falling")."""
    default_size: float = 0.5
    """Longest side [m] of an object whose size the sentence does not give; size words are multiples of it."""
    library: bool = True
    """Accept only objects that the procedural library draws, and no word without a meaning to it. False, for a prior
    that draws anything: an unknown noun phrase is the subject, and words that mean nothing here are passed on."""
    style: str = "a DSLR photo of {}, centered, plain background"
    """Sentence around the subject for an image encoder."""
    image_negative: str = "blurry, low quality, text, watermark, cropped, multiple objects"
    """What images must not show, for priors that read it."""
    video_negative: str = "blurry, low quality, text, watermark, camera motion, static"
    """What clips must not show."""

    def __post_init__(self):
        lo, hi = SIZES_ALLOWED
        if not lo <= self.default_size <= hi:
            raise ValueError(f"default_size must be in [{lo}, {hi}] m, got {self.default_size}")
        if "{}" not in self.style:
            raise ValueError(f"style must have a {{}} for the subject, got {self.style!r}")

    def __call__(self, *, work: Workspace) -> Prompt:
        """The sentence as look and motion.

        Raises:
            ValueError: a sentence without a known object, or with a word, number or combination that cannot be placed.
        """
        spoken = tokens(str(self.prompt))
        if not any(t != "," for t in spoken):
            raise ValueError('the prompt is empty; say what the film shows, such as prompt="a rubber burger falling"')
        try:
            return self._refined(spoken)
        except ValueError as e:
            shown = " ".join(str(self.prompt).split())
            raise ValueError(
                f"prompt {shown[:80]!r}: {e}, {REMEDY}" if self.library else f"prompt {shown[:80]!r}: {e}"
            ) from None

    def _refined(self, spoken: list[str]) -> Prompt:
        items = items_of(spoken, lexicon())
        name = None if not self.library and is_foreign(items) else head_of(items)
        if name is None and self.library:
            raise ValueError(_no_object(items))
        if name == "gravel pile" and {i.roles.get("material") for i in items} & set(w.FINE):
            name = "mound"
        if name is not None:
            items = items_of(spoken, lexicon_of(name))
        recipe = RECIPES.get(name or "")
        r = Reader(items, recipe).read()
        if r.unknown and self.library:
            raise ValueError(_unknown(next((x for x in r.unknown if x in w.NOT), r.unknown[0]), recipe))
        if recipe is None and not r.unknown:
            raise ValueError("no noun is left for the subject; name an object")
        return self._composed(r, recipe)

    def _composed(self, r: Reading, recipe: Recipe | None) -> Prompt:
        """The reading in canonical words."""
        named = {target: _one_material(given, target) for target, given in r.materials.items()}
        colours = {target: sorted(set(given))[0] for target, given in r.colours.items()}
        if clash := next((c for c in r.colours.values() if len(set(c)) > 1), None):
            raise ValueError(f"one colour a part, got {' and '.join(sorted(set(clash)))}; leave one out")
        removed = set(r.removed)
        if recipe is not None:
            order = [p.name for p in recipe.parts if p.name not in removed]
            if not order:
                raise ValueError(
                    f"nothing is left of {recipe.name}; keep one of its parts: "
                    f"{', '.join(p.name for p in recipe.parts)}"
                )
            if gone := removed & (set(named) | set(colours)):
                raise ValueError(f"{sorted(gone)[0]!r} is both left out and described; say one of them")
            _simplify(recipe, named, colours)
            defaults = {p.name: p.material for p in recipe.parts if p.name in order}
            materials = named if "" in named else {"": recipe.parts[0].material} | defaults | named
            materials = {k: materials[k] for k in ("", *order) if k in materials}
            phrase = _phrase(recipe, named, colours, sorted(removed, key=[p.name for p in recipe.parts].index))
            surface = _surface(recipe, named, colours, order)
            phrase += f", {' '.join(r.unknown)}" if r.unknown else ""
        else:
            materials = {"": "soft"} | named
            phrase = " ".join([*_adjectives("", named, colours), *r.unknown])
            surface = ""
        verb = min(r.verbs, key=w.PRECEDENCE.__getitem__, default="falling")
        absent = [*sorted(removed), *sorted(set(r.negatives))]
        phrase = f"{_article(phrase)} {phrase}"
        return Prompt(
            look=Look(
                subject=recipe.name if recipe else " ".join(r.unknown),
                text=self.style.format(phrase),
                surface=surface,
                negative=", ".join([*absent, self.image_negative]),
            ),
            motion=Motion(
                verb=verb,
                text=f"{phrase} {DOING[verb]}",
                materials=materials,
                size=self._size(r),
                negative=", ".join([*absent, self.video_negative]),
            ),
        )

    def _size(self, r: Reading) -> float:
        """Longest side [m]."""
        if len(set(r.lengths)) > 1:
            raise ValueError(f"one size a scene, got {' and '.join(f'{x:g} m' for x in r.lengths)}; leave one out")
        size = r.lengths[0] if r.lengths else self.default_size * r.factor
        lo, hi = SIZES_ALLOWED
        if not lo <= size <= hi:
            raise ValueError(f"the size must be in [{lo}, {hi}] m, got {size:g} m; change it")
        return size


def _one_material(given: list[str], target: str) -> str:
    """The one material of a target; soft and plush yield to a real one."""
    real = sorted({m for m in given if m not in w.YIELDING}) or sorted(set(given))
    if len(real) > 1:
        raise ValueError(
            f"one material for {target or 'the whole object'}, got {' and '.join(real)}; "
            "give others to parts, as in 'a burger with a jelly patty'"
        )
    return real[0]


def _simplify(recipe: Recipe, named: dict[str, str], colours: dict[str, str]) -> None:
    """Drop what says nothing new: the own material of the object or of a part, and the name of an only part."""
    if len(recipe.parts) == 1:
        for given in (named, colours):
            if (only := given.pop(recipe.parts[0].name, None)) is not None:
                given.setdefault("", only)
    if named.get("") == recipe.parts[0].material:
        del named[""]
    for part in recipe.parts:
        if named.get(part.name) == named.get("", part.material):
            del named[part.name]


def _adjectives(target: str, named: dict[str, str], colours: dict[str, str]) -> list[str]:
    words = [d[target] for d in (colours, named) if target in d]
    return [ADJECTIVES.get(x, x) for x in words]


def _article(phrase: str) -> str:
    return "an" if phrase[:1] in "aeiou" else "a"


def _phrase(recipe: Recipe, named: dict[str, str], colours: dict[str, str], removed: list[str]) -> str:
    """Noun phrase in canonical words: "rubber burger with jelly patty, without cheese"."""
    whole = _adjectives("", named, colours)
    if recipe.name == "mound" and not named.get(""):
        whole.append("sand")
    phrase = " ".join(recipe.title.format(" ".join(whole)).split())
    details = [
        " ".join([*_adjectives(p.name, named, colours), p.name])
        for p in recipe.parts
        if p.name in named or p.name in colours
    ]
    phrase += f" with {' and '.join(details)}" if details else ""
    return phrase + (f" without {' and '.join(removed)}" if removed else "")


def _surface(recipe: Recipe, named: dict[str, str], colours: dict[str, str], order: list[str]) -> str:
    """`Look.surface`: tints of the whole and of parts, for words that change colours."""
    out = []
    for target in ("", *order):
        default = next((p.material for p in recipe.parts if p.name == target), recipe.parts[0].material)
        shown = [colours[target]] if target in colours else []
        material = named.get(target)
        if material in TINTS and material != default:
            shown.append(material)
        if shown:
            out.append((f"{target}=" if target else "") + " ".join(shown))
    return ", ".join(out)


def _no_object(items: list[Item]) -> str:
    candidates = [i.text for i in items if means_nothing(i)]
    alike = {
        m: max(difflib.SequenceMatcher(None, m, c).ratio() for c in candidates)
        for c in candidates
        for m in difflib.get_close_matches(c, WORDS, n=3, cutoff=0.6)
    }
    near = sorted(alike, key=alike.__getitem__, reverse=True)[:3]
    hint = f"did you mean {' or '.join(repr(m) for m in near)}? " if near else ""
    return f"no object of the library is named; {hint}it has: {', '.join(sorted(RECIPES))}; name one"


def _unknown(word: str, recipe: Recipe | None) -> str:
    if word in w.NOT:
        return (
            f"cannot place {word!r}: say what it is made of and what it does, not what it is not; "
            "'without' leaves a part out"
        )
    parts = [x for p in recipe.parts for x in (p.name, *p.words)] if recipe else []
    vocabulary = [*parts, *(" ".join(p) for p in lexicon())]
    near = difflib.get_close_matches(word, vocabulary, n=3, cutoff=0.6)
    hint = f"did you mean {' or '.join(repr(m) for m in dict.fromkeys(near))}? " if near else ""
    of = f"; the parts of {recipe.name} are: {', '.join(p.name for p in recipe.parts)}" if recipe else ""
    return f"cannot place {word!r}; {hint}leave it out{of}"
