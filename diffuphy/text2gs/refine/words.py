"""The vocabulary of prompts besides the objects: materials, verbs, sizes, and words that carry nothing.

Entries are singular, lower case; several words in one entry are a phrase. The rules add plurals themselves.
"""

MATERIALS: dict[str, tuple[str, ...]] = {
    "rubber": ("rubbery", "latex", "silicone", "elastic"),
    "jelly": ("jello", "gelatin", "gelatine", "gelatinous", "gummy", "gel"),
    "soft": ("squishy", "squashy"),
    "foam": ("foam rubber", "foamy", "polyurethane", "styrofoam"),
    "sponge": ("spongy",),
    "bread": ("toast", "brioche"),
    "bun": (),
    "patty": ("meat", "beef"),
    "cheese": ("cheesy", "cheddar"),
    "lettuce": ("salad",),
    "dough": ("doughy",),
    "plasticine": ("modelling clay", "modeling clay", "play dough", "playdough", "play doh", "putty"),
    "sand": ("sandy", "wet sand", "dry sand"),
    "gravel": ("gravelly", "pebble", "rubble"),
    "snow": ("snowy",),
    "salt": ("sugar", "salty"),
    "metal": ("metallic", "aluminium", "aluminum", "tin", "copper", "brass", "bronze", "lead", "silver"),
    "gold": ("golden",),
    "steel": ("iron", "stainless steel"),
    "wood": ("wooden", "timber", "oak"),
    "stone": ("rock", "granite", "marble", "concrete", "ceramic", "porcelain", "rocky"),
    "plastic": ("vinyl", "pvc", "lego"),
    "plush": ("fluffy", "cotton", "wool", "woollen", "furry", "stuffed", "felt"),
    "wax": ("waxy", "candle wax", "paraffin"),
    "chocolate": ("chocolatey",),
    "honey": (),
    "syrup": ("maple syrup", "caramel", "molasses"),
    "butter": ("buttery", "margarine"),
    "icecream": ("ice cream", "gelato"),
    "cream": ("whipped cream", "creme", "creamy", "buttercream", "butter cream", "frosting", "yoghurt", "yogurt", "mayonnaise"),
    "batter": ("pancake batter", "cake batter"),
    "pancake": (),
    "water": ("watery", "liquid"),
    "fluid": (),
    "milk": ("milky",),
    "oil": ("oily",),
    "clay": ("clayey",),
    "slime": ("slimy",),
    "lava": ("magma",),
    "tofu": (),
    "leather": (),
    "cloth": ("fabric",),
    "mud": ("muddy", "wet clay", "quicksand"),
    "ice": ("icy", "frozen"),
    "glass": ("crystal",),
    "cake": ("sponge cake",),
    "apple": ("fruit",),
}
"""Canonical material word, a key of ``material.PRESETS``, and other words for it."""

YIELDING = ("soft", "plush")
"""Adjectives that give way to a real material beside them ("a soft rubber ball" is of rubber)."""

FINE = ("sand", "snow", "salt", "mud")
"""Materials whose pile is a smooth mound, not a heap of stones."""

VERBS: dict[str, tuple[str, ...]] = {
    "falling": ("fall", "falls", "fell", "drop", "drops", "dropped", "dropping", "tumble", "tumbles", "tumbling", "plunging", "plunges",
                "landing", "lands", "crashing", "crashes", "hitting", "hits"),
    "bouncing": ("bounce", "bounces", "bounced", "hop", "hops", "hopping", "jump", "jumps", "jumping", "rebounding", "rebounds"),
    "thrown": ("throw", "throws", "throwing", "toss", "tossed", "tossing", "hurled", "flung", "launched", "flying", "flies", "kicked", "shot"),
    "spinning": ("spin", "spins", "spun", "rotate", "rotates", "rotating", "twirl", "twirling", "twirls", "whirling", "turning", "turns"),
    "sliding": ("slide", "slides", "slid", "slip", "slips", "slipping", "skidding", "skids", "gliding", "glides"),
    "rolling": ("roll", "rolls", "rolled"),
    "melting": ("melt", "melts", "melted", "thaw", "thawing", "thaws", "dissolving", "dissolves", "liquefying", "flowing", "flows", "oozing"),
    "collapsing": ("collapse", "collapses", "collapsed", "crumble", "crumbles", "crumbling", "slump", "slumps", "slumping", "sagging",
                   "sags", "disintegrating", "falling apart", "falls apart", "fall apart", "caving in", "caves in", "toppling", "topples"),
    "squashed": ("squash", "squashes", "squashing", "squish", "squished", "squishing", "crush", "crushed", "crushing", "press", "pressed",
                 "pressing", "squeeze", "squeezed", "squeezing", "compressed", "flattened", "smashed"),
    "poked": ("poke", "pokes", "poking", "prod", "prodded", "prodding", "pushed", "push", "pushing", "punched", "nudged", "jiggling",
              "jiggles", "wobbling", "wobbles"),
}
"""Canonical verb of the scene table, and other forms and words for it."""

PRECEDENCE: dict[str, int] = {
    "thrown": 0, "spinning": 0, "rolling": 0, "sliding": 0, "bouncing": 0, "poked": 0, "squashed": 0, "melting": 1, "falling": 2, "collapsing": 3,
}
"""Which verb drives a scene that names several: the lowest number, and among equals the first named. Verbs with a start or an actor
of their own come first; melting changes the material; falling is how most scenes start anyway; collapsing is what a weak material
does after any of them."""

SIZES: dict[str, float] = {
    "tiny": 0.2, "minuscule": 0.2, "miniature": 0.2, "microscopic": 0.1, "small": 0.5, "little": 0.5, "mini": 0.5,
    "big": 2.0, "large": 2.0, "huge": 4.0, "enormous": 4.0, "massive": 4.0, "giant": 6.0, "gigantic": 6.0,
}
"""Size words, as multiples of the default size."""

UNITS: dict[str, float] = {
    "mm": 1e-3, "millimetre": 1e-3, "millimeter": 1e-3, "cm": 1e-2, "centimetre": 1e-2, "centimeter": 1e-2, "dm": 0.1,
    "m": 1.0, "metre": 1.0, "meter": 1.0, "inch": 0.0254, "inches": 0.0254, "foot": 0.3048, "feet": 0.3048, "ft": 0.3048,
}
"""Units of length [m]."""

NUMBERS: dict[str, float] = {
    "half": 0.5, "one": 1, "two": 2, "three": 3, "four": 4, "five": 5, "six": 6, "seven": 7, "eight": 8, "nine": 9, "ten": 10,
    "twelve": 12, "fifteen": 15, "twenty": 20, "thirty": 30, "forty": 40, "fifty": 50, "hundred": 100,
}

COLOURS: dict[str, tuple[str, ...]] = {
    "red": ("crimson", "scarlet"), "orange": (), "yellow": (), "green": (), "blue": (), "purple": ("violet",), "pink": (), "brown": (),
    "black": (), "white": (), "grey": ("gray",),
}

PLACES = ("on", "onto", "in", "into", "inside", "at", "over", "above", "under", "below", "against", "through", "across", "down", "off",
          "upon", "near", "beside", "behind", "to", "towards", "toward", "around", "along", "from", "up", "by")
"""Words that begin a phrase about the surroundings, which the plain scene does not show."""

WITHOUT = ("without", "no", "minus", "lacking", "except", "hold")
AND = ("and", "or", "nor", "plus", ",", "&")
JOINS = (*AND, "then", "while", "as", "but", "before", "after", "until", "when", "that", "which", "who", "where")

FILLERS = frozenset("""
a an the this that these those some any my your its it their his her is are was being be been get gets getting made make out up down
of like shaped very really quite so too just all entirely completely pure solid real toy cute lovely nice beautiful delicious tasty
fresh juicy ripe happy funny old new bouncy wobbly jiggly sticky smooth shiny glossy matte realistic photorealistic hyperrealistic detailed
stylized stylised cartoon cinematic photo photograph picture image video film clip movie animation render rendering shot scene close closeup
dslr 3d 4k 8k hd hdr high low quality resolution unreal engine slow fast slowly quickly motion single piece whole object thing model
tall long wide high across diameter size sized side large-scale scale into apart again over hard gently then camera static looking style
colored coloured color colour painted hot cold warm strawberry vanilla birthday beach bath christmas halloween teacup please show me can
you i want see there here has have having and with gravity under free dry wet glazed iced plain simple round square
ground floor earth table tabletop surface wall air sky room kitchen studio background plate desk
""".split())
"""Words that change nothing the scene can show."""
