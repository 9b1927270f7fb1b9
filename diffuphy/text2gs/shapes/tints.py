"""What a material word does to the colours of an object."""

from dataclasses import dataclass, replace

from diffuphy.text2gs.shapes.primitives import RGB, Paint


@dataclass(frozen=True)
class Tint:
    """A surface: colours move to `colour` by `strength`, and the light on them changes."""

    colour: RGB
    strength: float = 0.85
    """0 keeps the object's colours, 1 keeps only their brightness."""
    grain: float = 0.0
    gloss: float = 0.0
    glow: float = 0.0


TINTS = {
    "jelly": Tint((0.93, 0.16, 0.22), 0.78, gloss=0.75, glow=0.55),
    "sand": Tint((0.86, 0.70, 0.44), 0.92, grain=0.16),
    "gravel": Tint((0.55, 0.53, 0.50), 0.92, grain=0.22),
    "stone": Tint((0.58, 0.57, 0.55), 0.92, grain=0.13),
    "snow": Tint((0.95, 0.97, 1.00), 0.92, grain=0.04),
    "salt": Tint((0.95, 0.94, 0.93), 0.92, grain=0.12),
    "ice": Tint((0.70, 0.88, 0.97), 0.85, gloss=0.7, glow=0.45),
    "glass": Tint((0.74, 0.90, 0.88), 0.80, gloss=0.8, glow=0.50),
    "water": Tint((0.25, 0.58, 0.88), 0.85, gloss=0.7, glow=0.40),
    "mud": Tint((0.38, 0.26, 0.16), 0.92, grain=0.10, gloss=0.15),
    "metal": Tint((0.70, 0.72, 0.75), 0.95, gloss=0.9),
    "steel": Tint((0.62, 0.66, 0.71), 0.95, gloss=0.9),
    "gold": Tint((1.00, 0.76, 0.20), 0.95, gloss=0.9),
    "wood": Tint((0.66, 0.43, 0.23), 0.92, grain=0.10),
    "chocolate": Tint((0.36, 0.19, 0.10), 0.95, gloss=0.35),
    "honey": Tint((0.95, 0.62, 0.08), 0.85, gloss=0.7, glow=0.35),
    "syrup": Tint((0.55, 0.25, 0.06), 0.85, gloss=0.7, glow=0.20),
    "butter": Tint((1.00, 0.88, 0.45), 0.90, gloss=0.2, glow=0.15),
    "wax": Tint((0.95, 0.90, 0.78), 0.80, gloss=0.35, glow=0.30),
    "cheese": Tint((1.00, 0.76, 0.20), 0.90, glow=0.10),
    "bread": Tint((0.85, 0.60, 0.32), 0.85, grain=0.08),
    "bun": Tint((0.85, 0.56, 0.26), 0.85, grain=0.05),
    "patty": Tint((0.40, 0.22, 0.12), 0.90, grain=0.18),
    "lettuce": Tint((0.42, 0.75, 0.22), 0.85, grain=0.05),
    "dough": Tint((0.94, 0.86, 0.68), 0.88, glow=0.10),
    "batter": Tint((0.96, 0.86, 0.62), 0.88, glow=0.10),
    "pancake": Tint((0.86, 0.60, 0.30), 0.85, grain=0.06),
    "cake": Tint((0.90, 0.70, 0.42), 0.85, grain=0.12),
    "apple": Tint((0.84, 0.15, 0.12), 0.85, gloss=0.4),
    "icecream": Tint((0.99, 0.90, 0.76), 0.85, glow=0.12),
    "cream": Tint((0.99, 0.96, 0.90), 0.88, glow=0.12),
    "sponge": Tint((0.97, 0.84, 0.32), 0.80, grain=0.22),
    "plasticine": Tint((0.35, 0.62, 0.78), 0.40),
    "clay": Tint((0.72, 0.42, 0.30), 0.85, grain=0.05),
    "tofu": Tint((0.97, 0.94, 0.85), 0.90, glow=0.10),
    "slime": Tint((0.42, 0.82, 0.24), 0.85, gloss=0.7, glow=0.30),
    "lava": Tint((0.95, 0.33, 0.06), 0.90, grain=0.18, glow=0.40),
    "milk": Tint((0.98, 0.97, 0.94), 0.90, gloss=0.3),
    "oil": Tint((0.80, 0.64, 0.12), 0.85, gloss=0.8, glow=0.25),
    "leather": Tint((0.50, 0.29, 0.16), 0.85, grain=0.06, gloss=0.2),
    "red": Tint((0.88, 0.13, 0.12)),
    "orange": Tint((0.98, 0.52, 0.08)),
    "yellow": Tint((1.00, 0.83, 0.14)),
    "green": Tint((0.25, 0.68, 0.25)),
    "blue": Tint((0.16, 0.40, 0.86)),
    "purple": Tint((0.52, 0.25, 0.74)),
    "pink": Tint((0.98, 0.56, 0.70)),
    "brown": Tint((0.48, 0.29, 0.16)),
    "black": Tint((0.13, 0.13, 0.15)),
    "white": Tint((0.97, 0.97, 0.96)),
    "grey": Tint((0.55, 0.56, 0.58)),
}
"""Material and colour words that change how a thing looks. Rubber, plush, foam, plastic and the like keep the object's
colours."""

COLOURS = ("red", "orange", "yellow", "green", "blue", "purple", "pink", "brown", "black", "white", "grey")
"""Words of `TINTS` that are colours: they recolour a material ("green jelly") and mean none themselves."""


def tint_of(phrase: str) -> Tint:
    """The tint of "sand", "green" or "green jelly": light from the material, colour from the colour word.

    Raises:
        ValueError: for a word that changes no colours.
    """
    found = None
    for word in sorted(phrase.split(), key=lambda w: w in COLOURS):
        if word not in TINTS:
            raise ValueError(f"surface {word!r} changes no colours; known are: {', '.join(TINTS)}")
        found = TINTS[word] if found is None else replace(found, colour=TINTS[word].colour)
    if found is None:
        raise ValueError("a surface phrase must name a material or a colour")
    return found


def parse_surface(surface: str) -> dict[str, Tint]:
    """Tints by part from `Look.surface`: "sand", "icing=chocolate", "gold, hat=green jelly"; the key "" is the whole
    object."""
    tints = {}
    for item in filter(None, (s.strip() for s in surface.split(","))):
        part, _, phrase = item.rpartition("=")
        tints[part.strip()] = tint_of(phrase)
    return tints


def _luminance(colour: RGB) -> float:
    return 0.2126 * colour[0] + 0.7152 * colour[1] + 0.0722 * colour[2]


def tinted(paint: Paint, tint: Tint, reference: RGB, feature: bool) -> Paint:
    """The paint under a tint: hue from the tint, brightness relative to the `reference` colour from the paint.

    A feature keeps most of its own colour, so that eyes stay eyes on a snowman of sand.
    """
    strength = tint.strength * (0.3 if feature else 1.0)

    def move(c: RGB) -> RGB:
        factor = min(1.08, 0.30 + 0.70 * (_luminance(c) / max(_luminance(reference), 0.05)) ** 0.6)
        r, g, b = (x + strength * (min(1.0, t * factor) - x) for x, t in zip(c, tint.colour, strict=True))
        return (r, g, b)

    return replace(
        paint,
        colour=move(paint.colour),
        second=move(paint.second),
        third=move(paint.third),
        grain=max(paint.grain, tint.grain * (0.4 if feature else 1.0)),
        gloss=max(paint.gloss, tint.gloss),
        glow=paint.glow if feature else max(paint.glow, tint.glow),
    )
