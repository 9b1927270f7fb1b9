"""Prompts are understood: by example, and by construction from a grammar."""

import string
import unicodedata

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from diffuphy.text2gs.refine import words as w
from diffuphy.text2gs.refine.grammar import lexicon
from diffuphy.text2gs.refine.rules import DOING, Rules
from diffuphy.text2gs.shapes import RECIPES, Library
from diffuphy.text2gs.shapes.catalogue import WORDS, plural
from diffuphy.text2gs.shapes.tints import COLOURS, TINTS
from diffuphy.types import Prompt
from diffuphy.workspace import Workspace


def read(text: str, **settings) -> Prompt:
    return Rules(text, **settings)(work=Workspace())


# ---------------------------------------------------------------------- by example
@pytest.mark.parametrize(
    ("text", "subject", "whole", "verb"),
    [
        ("a rubber burger falling", "burger", "rubber", "falling"),
        ("A duck made of jelly", "duck", "jelly", "falling"),
        ("a snowman of sand collapsing", "snowman", "sand", "collapsing"),
        ("a golden apple spins", "apple", "gold", "spinning"),
        ("jello cube sliding", "cube", "jelly", "sliding"),
        ("a pile of gravel", "gravel pile", "gravel", "falling"),
        ("a heap of sand falls apart", "mound", "sand", "collapsing"),
        ("a pile of snow", "mound", "snow", "falling"),
        ("a stack of pancakes drops", "pancakes", "pancake", "falling"),
        ("a stack of wooden blocks toppling", "tower", "wood", "collapsing"),
        ("ice cream melts on a hot day", "ice cream", "icecream", "melting"),
        ("a block of ice", "cube", "ice", "falling"),
        ("chocolate cake", "cake", "chocolate", "falling"),
        ("a soft rubber ball bounces", "ball", "rubber", "bouncing"),
        ("teddy bears", "teddy bear", "plush", "falling"),
        ("a crème cake", "cake", "cream", "falling"),
    ],
)
def test_subject_material_and_verb_are_understood(text, subject, whole, verb):
    prompt = read(text)
    assert (prompt.look.subject, prompt.motion.materials[""], prompt.motion.verb) == (subject, whole, verb)


@pytest.mark.parametrize(
    ("text", "part", "material"),
    [
        ("a burger with a jelly patty", "patty", "jelly"),
        ("a cake with chocolate icing", "icing", "chocolate"),
        ("a chocolate icing cake", "icing", "chocolate"),
        ("a burger with a patty made of metal", "patty", "metal"),
        ("a donut with chocolate frosting", "icing", "chocolate"),
        ("a mug of honey", "drink", "honey"),
        ("pancakes with honey", "syrup", "honey"),
        ("a sand snowman with a golden hat", "hat", "gold"),
        ("a teddy bear whose bow tie is made of wood", "bow", "wood"),
    ],
)
def test_a_part_gets_its_own_material_and_colour(text, part, material):
    prompt = read(text.replace("whose", "with its"))
    assert prompt.motion.materials[part] == material
    assert f"{part}={material}" in prompt.look.surface


def test_parts_keep_their_defaults_when_no_material_is_given():
    prompt = read("a burger")
    assert prompt.motion.materials == {"": "bun"} | {p.name: p.material for p in RECIPES["burger"].parts}


def test_a_whole_material_replaces_all_defaults():
    assert read("a rubber burger").motion.materials == {"": "rubber"}


def test_surface_names_only_materials_that_change_colours():
    assert read("a rubber burger").look.surface == ""
    assert read("a snowman of snow").look.surface == ""  # its own material
    assert read("a sand snowman").look.surface == "sand"
    assert read("a green jelly").look.surface == "green"
    assert read("a blue jelly duck").look.surface == "blue jelly"


def test_negated_parts_are_removed_from_look_and_materials():
    prompt = read("a burger without cheese, tomatoes or onions falling")
    assert prompt.look.negative.startswith("cheese, tomato, onions, ")
    assert not {"cheese", "tomato"} & set(prompt.motion.materials)
    assert "without cheese and tomato" in prompt.look.text
    names = [p.name for p in Library().object(prompt.look).parts]
    assert names == ["bun", "patty", "lettuce", "sesame"]


def test_default_negatives_remove_nothing():
    for recipe in RECIPES.values():
        assert Library().object(read(f"a {recipe.name}").look).parts == recipe.parts


@pytest.mark.parametrize(
    ("words", "metres"),
    [
        ("30 cm", 0.3),
        ("30cm", 0.3),
        ("0.3-metre", 0.3),
        ("0,3 m", 0.3),
        ("2 m tall", 2.0),
        ("half a metre tall", 0.5),
        ("two metres wide", 2.0),
        ("12 in", 0.3048),
        ("1 foot", 0.3048),
        ("tiny", 0.1),
        ("huge", 2.0),
        ("tiny little", 0.05),
    ],
)
def test_sizes_are_metres(words, metres):
    """Size words multiply the default 0.5 m."""
    assert read(f"a {words} rubber duck").motion.size == pytest.approx(metres, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "verb"),
    [
        ("a gravel pile falling then collapsing", "falling"),
        ("a gravel pile collapses after it fell", "falling"),
        ("a ball falls and bounces", "bouncing"),
        ("a burger thrown, spinning", "thrown"),
        ("a burger spinning, thrown", "spinning"),
        ("an ice cream falling and melting", "melting"),
    ],
)
def test_one_verb_drives_the_scene(text, verb):
    """The order of `words.PRECEDENCE`; the first named among equals."""
    assert read(text).motion.verb == verb


def test_refined_sentences_are_sentences():
    prompt = read("RUBBER burger!!! drops")
    assert prompt.look.text == "a DSLR photo of a rubber burger, centered, plain background"
    assert prompt.motion.text == "a rubber burger falling onto the ground"
    assert read("apple").look.text.startswith("a DSLR photo of an apple,")


# ---------------------------------------------------------------------- what is refused
@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "empty"),
        ("  !?  🍔 ", "empty"),
        ("a purple elephant", "no object of the library"),
        ("汉堡", "no object of the library"),
        ("a burgr falling", "did you mean 'burger'"),
        ("a burger with bacon", "the parts of burger are"),
        ("a ruber duck", "did you mean 'rubber'"),
        ("two burgers", "one object"),
        ("a duck and a burger", "one object"),
        ("a duck falling on a cube", "one object"),
        ("a burger made of rubber and jelly", "one material"),
        ("a red and blue ball", "one colour"),
        ("a 0 cm duck", "size"),
        ("a 3 cm 5 cm duck", "one size"),
        ("a burger without cheese with jelly cheese", "left out and described"),
        ("a jelly without jelly", "nothing is left"),
    ],
)
def test_what_cannot_be_placed_is_refused_in_one_line(text, says):
    with pytest.raises(ValueError, match=says) as e:
        read(text)
    assert "\n" not in str(e.value)
    assert says == "empty" or "guidance=stable_diffusion" in str(e.value)


def test_open_vocabulary_takes_any_noun_phrase():
    prompt = read("a purple elephant made of rubber bouncing", library=False)
    assert prompt.look.subject == "elephant"
    assert prompt.motion.materials == {"": "rubber"}
    assert prompt.motion.text == "a purple rubber elephant bouncing on the ground"


@pytest.mark.parametrize(
    ("text", "subject", "whole"),
    [
        ("a vase of flowers", "vase of flowers", "soft"),
        ("an old boot made of jelly, 20 cm", "boot", "jelly"),
        ("a duck boat of steel", "boat", "steel"),
        ("a rubber burger with bacon", "burger", "rubber"),
    ],
)
def test_open_vocabulary_keeps_the_head(text, subject, whole):
    prompt = read(text, library=False)
    assert subject in prompt.look.subject
    assert prompt.motion.materials[""] == whole


def test_words_passed_on_reach_the_sentence():
    assert "bacon" in read("a burger with bacon", library=False).look.text


@pytest.mark.parametrize("settings", [{"default_size": 0.0}, {"default_size": float("nan")}, {"style": "no place"}])
def test_impossible_settings_are_refused(settings):
    with pytest.raises(ValueError):
        Rules("a burger", **settings)


# ---------------------------------------------------------------------- the vocabulary
def test_every_material_word_has_a_preset():
    presets = pytest.importorskip("diffuphy.material.presets").PRESETS
    used = {p.material for r in RECIPES.values() for p in r.parts} | set(w.MATERIALS)
    assert used <= set(presets), used - set(presets)


def test_every_verb_has_a_scene():
    scenes = pytest.importorskip("diffuphy.mpm.scene").SCENES
    assert set(w.VERBS) == set(w.PRECEDENCE) == set(DOING) == set(scenes)


def test_default_materials_are_words_of_the_vocabulary():
    assert {p.material for r in RECIPES.values() for p in r.parts} <= set(w.MATERIALS)
    assert set(w.COLOURS) == set(COLOURS) <= set(TINTS)
    assert set(TINTS) - set(COLOURS) <= set(w.MATERIALS)


def test_no_word_means_two_things_of_a_kind():
    """Synonyms are disjoint among objects, among materials and among verbs, and no verb names a thing."""
    objects = [x for r in RECIPES.values() for x in (r.name, *r.words)]
    materials = [x for word, others in w.MATERIALS.items() for x in (word, *others)]
    verbs = [x for verb, forms in w.VERBS.items() for x in (verb, *forms)]
    for words in (objects, materials, verbs):
        assert len(words) == len(set(words)), {x for x in words if words.count(x) > 1}
    things = {f(x) for x in (*objects, *materials) for f in (str, plural)}
    assert not things & set(verbs)
    assert not set(w.FILLERS) & {" ".join(p) for p in lexicon()}
    for recipe in RECIPES.values():
        parts = [x for p in recipe.parts for x in (p.name, *p.words)]
        assert len(parts) == len(set(parts)), recipe.name


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "a burger that is not rubber falling",
            "cannot place 'not': say what it is made of and what it does, not what",
        ),
        ("a ball that does not bounce", "cannot place 'not'"),
        ("a ball that doesn't bounce", "cannot place 'doesn'"),
        ("a rubber ball of 200 g falling", "cannot place '200 g': a prompt says how long .* material.override.rho"),
        ("a rubber ball that falls for two seconds", "cannot place 'two seconds'"),
        ("a rubber ball thrown, 3 m/s", "cannot place '3 m s'"),
        ("a metal ball bouncing on a jelly", "one object a scene: 'jelly' is a second one"),
        ("a metal ball falling onto a red cake and bouncing", "one object a scene: 'cake' is a second one"),
        ("a ruber buger faling", "did you mean 'burger' or "),
    ],
)
def test_what_cannot_be_filmed_is_said(text, message):
    """Leaving out a "not" would turn the sentence around; a speed is no length; a second object is not passed over
    because it is a material too; the nearest word comes first."""
    with pytest.raises(ValueError, match=message):
        read(text)


@pytest.mark.parametrize(
    "text", ["on jelly", "on a jelly floor", "on a wooden table", "onto the sand", "against stone"]
)
def test_what_the_surroundings_are_made_of_is_passed_over(text):
    assert read(f"a rubber ball falling {text}") == read("a rubber ball falling")


# ---------------------------------------------------------------------- by construction
MODIFIERS = {word: word for word in w.MATERIALS if word not in w.YIELDING} | {
    other: word for word, others in w.MATERIALS.items() for other in others if word not in w.YIELDING
}
PHRASES = {" ".join(p) for p in lexicon()}
ARTICLES = ("", "a ", "the ", "one ")
SCENERY = ("", " on a table", " onto the floor", " against a wall", " in a studio")
SIZES = {"": 0.5, "tiny ": 0.1, "30 cm ": 0.3, "a 2 m tall ": 2.0, "huge ": 2.0}
FORMS = {form: verb for verb, forms in w.VERBS.items() for form in (verb, *forms)}


def whole(prompt: Prompt) -> str:
    return prompt.motion.materials[""]


def expected(name: str, material: str) -> str:
    return material or RECIPES[name].parts[0].material


def is_plain(word: str, material: str) -> bool:
    """The two words side by side are no phrase with a meaning of its own ("cheese burger", "ice cream")."""
    name = WORDS[word]
    pairs = (f"{m} {o}" for m in (material, material.rsplit(maxsplit=1)[-1]) for o in (word, word.split(maxsplit=1)[0]))
    parts = {x for p in RECIPES[name].parts for x in (p.name, *p.words)}
    own = {x for p in parts for x in (p, plural(p))} | {x for p in parts for x in p.split()}
    fine = name == "gravel pile" and MODIFIERS.get(material) in w.FINE
    return not (set(pairs) & PHRASES or material in own or fine)


@settings(max_examples=400, deadline=None, derandomize=True)
@given(
    article=st.sampled_from(ARTICLES),
    size=st.sampled_from(sorted(SIZES)),
    material=st.sampled_from(["", *sorted(MODIFIERS)]),
    word=st.sampled_from(sorted(WORDS)),
    form=st.sampled_from(["", *sorted(FORMS)]),
    scenery=st.sampled_from(SCENERY),
    after=st.booleans(),
    upper=st.booleans(),
)
def test_what_is_composed_is_recovered(article, size, material, word, form, scenery, after, upper):
    """Any (article, size, material, object, verb, scenery), in two orders and in capitals."""
    if material and not is_plain(word, material):
        return
    adjective, made = ("", f" made of {material}") if after and material else (f"{material} " if material else "", "")
    text = f"{article if not size.startswith('a ') else ''}{size}{adjective}{word}{made} {form}{scenery}!"
    prompt = read(text.upper() if upper else text)
    assert prompt.look.subject == WORDS[word], text
    assert whole(prompt) == expected(WORDS[word], MODIFIERS.get(material, "")), text
    assert prompt.motion.verb == FORMS.get(form, "falling"), text
    assert prompt.motion.size == pytest.approx(SIZES[size], rel=1e-12), text


@settings(max_examples=150, deadline=None, derandomize=True)
@given(
    st.sampled_from(sorted(RECIPES)),
    st.sampled_from(sorted(m for m in w.MATERIALS if m not in w.YIELDING and m != "icecream")),
    st.sampled_from(sorted(FORMS)),
)
def test_order_case_and_synonyms_do_not_matter(name, material, form):
    """The same meaning gives the same result, so that stages further on are not run again."""
    if not is_plain(name, material):
        return
    first = read(f"a {material} {name} {form}")
    for text in (f"{form}: {name}, made out of {material}", f"A {name.upper()} OF {material} {form} onto the floor"):
        if RECIPES[name].of and " OF " in text:
            continue  # "a mug of honey" speaks about the drink
        assert read(text) == first, text


@settings(max_examples=200, deadline=None, derandomize=True)
@given(
    st.sampled_from([(r.name, p.name) for r in RECIPES.values() for p in r.parts]),
    st.sampled_from(["jelly", "gold", "sand"]),
)
def test_every_part_can_be_given_a_material(place, material):
    name, part = place
    if len(RECIPES[name].parts) == 1 or material in {x for p in RECIPES[name].parts for x in (p.name, *p.words)}:
        return
    prompt = read(f"a {name} with a {material} {part}")
    assert prompt.motion.materials.get(part, prompt.motion.materials[""]) == material


ALPHABET = st.one_of(st.characters(), st.sampled_from(string.ascii_lowercase + " ,.-'0123456789🍔é\n"))
KNOWN = st.sampled_from(
    sorted({x for p in lexicon() for x in p} | set(w.FILLERS) | set(w.PLACES) | {"with", "of", "made", "no", "3", "cm"})
)


@settings(max_examples=400, deadline=None, derandomize=True)
@given(st.one_of(st.text(ALPHABET), st.lists(KNOWN, max_size=12).map(" ".join)), st.booleans())
def test_garbage_raises_nothing_but_a_value_error_in_one_line(text, library):
    try:
        prompt = read(text, library=library)
    except ValueError as e:
        assert len(str(e).splitlines()) == 1
    else:
        assert prompt.motion.verb in w.VERBS
        assert set(prompt.motion.materials.values()) <= set(w.MATERIALS)
        assert unicodedata.is_normalized("NFC", prompt.look.text) or not library
        if library:
            assert Library().object(prompt.look).name == prompt.look.subject
