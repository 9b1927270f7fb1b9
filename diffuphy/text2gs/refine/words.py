"""The vocabulary of prompts besides the objects: materials, verbs, sizes, and words that carry nothing.

Entries are singular, lower case; several words in one entry are a phrase. The grammar adds plurals itself.
"""


def _table(text: str) -> dict[str, tuple[str, ...]]:
    """Lines "word: other, other" as a dict; a line without a colon goes on with the one above."""
    out: dict[str, tuple[str, ...]] = {}
    for line in filter(None, map(str.strip, text.splitlines())):
        word, colon, others = line.partition(":")
        word = word if colon else next(reversed(out))
        out[word] = out.get(word, ()) + tuple(x.strip() for x in (others if colon else line).split(",") if x.strip())
    return out


MATERIALS = _table(
    """
    rubber: rubbery, latex, silicone, elastic
    jelly: jello, gelatin, gelatine, gelatinous, gummy, gel
    soft: squishy, squashy
    foam: foam rubber, foamy, polyurethane, styrofoam
    sponge: spongy
    bread: toast, brioche
    bun:
    patty: meat, beef
    cheese: cheesy, cheddar
    lettuce: salad
    dough: doughy
    plasticine: modelling clay, modeling clay, play dough, playdough, play doh, putty
    sand: sandy, wet sand, dry sand
    gravel: gravelly, pebble, rubble
    snow: snowy
    salt: sugar, salty
    metal: metallic, aluminium, aluminum, tin, copper, brass, bronze, lead, silver
    gold: golden
    steel: iron, stainless steel
    wood: wooden, timber, oak
    stone: rock, granite, marble, concrete, ceramic, porcelain, rocky
    plastic: vinyl, pvc, lego
    plush: fluffy, cotton, wool, woollen, furry, stuffed, felt
    wax: waxy, candle wax, paraffin
    chocolate: chocolatey
    honey:
    syrup: maple syrup, caramel, molasses
    butter: buttery, margarine
    icecream: ice cream, gelato
    cream: whipped cream, creme, creamy, buttercream, butter cream, frosting, yoghurt, yogurt, mayonnaise
    batter: pancake batter, cake batter
    pancake:
    water: watery, liquid
    fluid:
    milk: milky
    oil: oily
    clay: clayey
    slime: slimy
    lava: magma
    tofu:
    leather:
    cloth: fabric
    mud: muddy, wet clay, quicksand
    ice: icy, frozen
    glass: crystal
    cake: sponge cake
    apple: fruit
    """
)
"""Canonical material word, a key of ``material.PRESETS``, and other words for it."""

YIELDING = ("soft", "plush")
"""Adjectives that give way to a real material beside them ("a soft rubber ball" is of rubber)."""

FINE = ("sand", "snow", "salt", "mud")
"""Materials whose pile is a smooth mound, not a heap of stones."""

VERBS = _table(
    """
    falling: fall, falls, fell, drop, drops, dropped, dropping, tumble, tumbles, tumbling, plunging, plunges,
        landing, lands, crashing, crashes, hitting, hits
    bouncing: bounce, bounces, bounced, hop, hops, hopping, jump, jumps, jumping, rebounding, rebounds
    thrown: throw, throws, throwing, toss, tossed, tossing, hurled, flung, launched, flying, flies, kicked
    spinning: spin, spins, spun, rotate, rotates, rotating, twirl, twirling, twirls, whirling, turning, turns
    sliding: slide, slides, slid, slip, slips, slipping, skidding, skids, gliding, glides
    rolling: roll, rolls, rolled
    melting: melt, melts, melted, thaw, thawing, thaws, dissolving, dissolves, liquefying, flowing, flows,
        oozing
    collapsing: collapse, collapses, collapsed, crumble, crumbles, crumbling, slump, slumps, slumping, sagging,
        sags, disintegrating, falling apart, falls apart, fall apart, caving in, caves in, toppling, topples
    squashed: squash, squashes, squashing, squish, squished, squishing, crush, crushed, crushing, press,
        pressed, pressing, squeeze, squeezed, squeezing, compressed, flattened, smashed
    poked: poke, pokes, poking, prod, prodded, prodding, pushed, push, pushing, punched, nudged, jiggling,
        jiggles, wobbling, wobbles
    """
)
"""Canonical verb of the scene table, and other forms and words for it."""

# fmt: off
PRECEDENCE: dict[str, int] = {
    "thrown": 0, "spinning": 0, "rolling": 0, "sliding": 0, "bouncing": 0, "poked": 0, "squashed": 0, "melting": 1,
    "falling": 2, "collapsing": 3,
}
"""Which verb drives a scene that names several: the lowest number, and among equals the first named.

Verbs with a start or an actor of their own come first; melting changes the material; falling is how most scenes start
anyway; collapsing is what a weak material does after any of them.
"""

SIZES: dict[str, float] = {
    "tiny": 0.2, "minuscule": 0.2, "miniature": 0.2, "microscopic": 0.1, "small": 0.5, "little": 0.5, "mini": 0.5,
    "big": 2, "large": 2, "huge": 4, "enormous": 4, "massive": 4, "giant": 6, "gigantic": 6,
}
"""Size words, as multiples of the default size."""

UNITS: dict[str, float] = {
    "mm": 0.001, "millimetre": 0.001, "millimeter": 0.001, "cm": 0.01, "centimetre": 0.01, "centimeter": 0.01,
    "dm": 0.1, "m": 1, "metre": 1, "meter": 1, "inch": 0.0254, "inches": 0.0254, "foot": 0.3048, "feet": 0.3048,
    "ft": 0.3048,
}
"""Units of length [m]."""

NO_LENGTHS = frozenset(
    "g gram kg kilogram kilo lb pound ounce oz tonne n newton pa kpa mpa s sec second ms minute degree deg hz rpm "
    "litre liter l ml percent".split()
)
"""Units of what a prompt cannot say."""

NO_QUANTITY = (
    "a prompt says how long a thing is and no other quantity; density is material.override.rho [kg/m³], stiffness "
    "material.override.E [Pa], duration scene.seconds"
)

NUMBERS: dict[str, float] = {
    "half": 0.5, "one": 1, "two": 2, "three": 3, "four": 4, "five": 5, "six": 6, "seven": 7, "eight": 8, "nine": 9,
    "ten": 10, "twelve": 12, "fifteen": 15, "twenty": 20, "thirty": 30, "forty": 40, "fifty": 50, "hundred": 100,
}
"""Number words."""
# fmt: on

COLOURS = _table(
    """
    red: crimson, scarlet
    orange:
    yellow:
    green:
    blue:
    purple: violet
    pink:
    brown:
    black:
    white:
    grey: gray
    """
)
"""Colour words, keys of ``shapes.tints.TINTS``, and other words for them."""

PLACES = tuple(
    """
    on onto in into inside at over above under below against through across down off upon near beside behind to
    towards toward around along from up by
    """.split()
)
"""Words that begin a phrase about the surroundings, which the plain scene does not show."""

WITHOUT = ("without", "no", "minus", "lacking", "except", "hold")
NOT = ("not", "never", "doesn", "don", "isn", "aren", "won", "cannot", "non")
"""Words that deny what follows; a prompt says what there is ("doesn" is what is left of "doesn't")."""
MADE = ("of", "out", "from", "in", "entirely", "completely")
"""What follows "made"."""
AND = ("and", "or", "nor", "plus", ",")
JOINS = (*AND, "then", "while", "as", "but", "before", "after", "until", "when", "that", "which", "who", "where")
"""Words that end a noun phrase."""

FILLERS = frozenset(
    """
    3d 4k 8k a again air all an animation any apart are background bath be beach beautiful been being birthday
    bouncy camera can cartoon christmas cinematic clip close closeup cold color colored colour coloured completely
    cute delicious desk detailed diameter dry dslr earth engine entirely fast film floor free fresh funny gently
    get gets getting glazed glossy gravity ground halloween happy hard has have having hd hdr her here high his
    hot hyperrealistic i iced image is it its jiggly juicy just kitchen like long looking lovely low make matte me
    model motion movie my new nice object old out painted photo photograph photorealistic picture piece plain
    plate please pure quality quickly quite real realistic really render rendering resolution ripe room round
    scale scene see shaped shiny shot show side simple single size sized sky slow slowly smooth so solid some
    static sticky strawberry studio style stylised stylized surface table tabletop tall tasty the
    their there these thing this those too toy unreal vanilla very video wall want warm was wet whole wide wobbly
    you your
    """.split()
)
"""Words that change nothing the scene can show."""
