"""Material words as laws and parameters in SI units.

The values are those that look right for objects of about 0.5 m filmed at 30 frames a second on a grid of 2 cm: moduli
lie between 3 kPa and 2 MPa, because a wave of more than 50 m/s costs substeps and shows nothing. They follow the values
that earlier simulators used (PhysGaussian, PhysFlow, NCLaw, OmniPhysGS, Genesis, Newton), not a table of engineering
materials: real rubber is ten times, real stone ten thousand times stiffer.
"""

import difflib
from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from diffuphy.types import MaterialField

from .elastic import ELASTIC
from .plastic import PLASTIC
from .preset import Preset


def _solid(word: str, E: float, nu: float, rho: float, elastic: str = "fixed_corotated") -> Preset:
    """Keeps its shape; a fit may find that it does not."""
    return Preset(word, E, nu, rho, elastic, candidates_plastic=("identity", "von_mises"))


def _ductile(word: str, E: float, nu: float, rho: float, yield_stress: float) -> Preset:
    """Keeps a dent. Hencky elasticity, for which the radial return is exact."""
    return Preset(
        word, E, nu, rho, "hencky", "von_mises", yield_stress=yield_stress, candidates_plastic=("von_mises", "identity")
    )


def _grains(word: str, E: float, nu: float, rho: float, friction_angle: float, cohesion: float = 0.0) -> Preset:
    """Piles up under friction."""
    return Preset(
        word, E, nu, rho, "hencky", "drucker_prager", friction_angle=friction_angle, cohesion=cohesion,
        candidates_plastic=("drucker_prager", "von_mises"),
    )  # fmt: skip


def _paste(word: str, E: float, rho: float, yield_stress: float, viscosity: float) -> Preset:
    """Flows once its yield stress is passed; nearly incompressible."""
    return Preset(
        word, E, 0.42, rho, "hencky", "viscoplastic", yield_stress=yield_stress, viscosity=viscosity,
        candidates_plastic=("viscoplastic", "von_mises"),
    )  # fmt: skip


def _liquid(word: str, rho: float, E: float = 1e5) -> Preset:
    """Only a bulk modulus E/(3(1 − 2ν)) = 1.7 E; 0.5 m of it compresses by 3 % under its own weight."""
    return Preset(word, E, 0.4, rho, "neo_hookean", "fluid", candidates_plastic=("fluid", "viscoplastic"))


PRESETS: dict[str, Preset] = {
    p.word: p
    for p in (
        # Elastic. Rubber: OmniPhysGS and Physics3D 2e6, DreamPhysics 5e4; in between a fall of 1 m shows 10 % strain.
        _solid("rubber", 4e5, 0.40, 1000.0, "neo_hookean"),
        _solid("jelly", 3e4, 0.40, 1000.0, "neo_hookean"),  # NCLaw 1e5; a third of it wobbles at 0.5 m
        _solid("gelatin", 6e4, 0.40, 1050.0, "neo_hookean"),
        _solid("pudding", 2e4, 0.40, 1050.0, "neo_hookean"),
        _solid("tofu", 4e4, 0.40, 1050.0, "neo_hookean"),
        _solid("soft", 5e4, 0.35, 500.0),
        _solid("leather", 3e5, 0.35, 800.0),
        # Porous and light. PhysGaussian bread 2e3 and 0.3 at 200 kg/m³; stiffer so that a bun springs back.
        _solid("foam", 4e4, 0.20, 200.0),
        _solid("sponge", 1.5e4, 0.15, 200.0),
        _solid("bread", 2e4, 0.20, 250.0),
        _solid("bun", 3e4, 0.25, 300.0),
        _solid("cake", 2e4, 0.20, 350.0),
        _solid("pancake", 3e4, 0.30, 500.0),
        _solid("cloth", 2e4, 0.25, 250.0),
        _solid("plush", 1.5e4, 0.25, 200.0),
        _solid("fur", 1.5e4, 0.25, 200.0),
        # Food that keeps its shape.
        _solid("patty", 1.5e5, 0.40, 1000.0),
        _solid("meat", 1e5, 0.42, 1050.0),
        _solid("cheese", 8e4, 0.40, 1100.0),
        _solid("lettuce", 3e4, 0.30, 400.0),
        _solid("fruit", 4e5, 0.35, 900.0),
        _solid("apple", 6e5, 0.30, 850.0),
        # Stiff: at most 2 MPa, where a fall of 1 m shows 5 % strain and still needs only 300 substeps a frame.
        _solid("wood", 1.5e6, 0.30, 600.0),
        _solid("plastic", 1e6, 0.38, 950.0),
        _solid("ice", 2e6, 0.30, 920.0),
        _solid("glass", 2e6, 0.22, 2500.0),
        _solid("stone", 2e6, 0.22, 2400.0),
        # Ductile. PhysFlow metal 1e7 and 8 kPa, Genesis 1e6 and 10 kPa, which a fall of 0.6 m (15 kPa) squashes;
        # here an impact at 3 m/s (ρ c v ≈ 0.2 MPa) dents metals, and they bounce.
        _ductile("metal", 2e6, 0.30, 2500.0, 2e5),
        _ductile("steel", 2e6, 0.30, 2500.0, 2.4e5),
        _ductile("gold", 1.5e6, 0.40, 2500.0, 1.5e5),
        _ductile("wax", 5e5, 0.40, 900.0, 1e4),
        _ductile("chocolate", 8e5, 0.35, 1250.0, 2e4),
        _ductile("butter", 1.5e5, 0.40, 950.0, 4e3),
        # NCLaw plasticine 3e5 and 5 kPa, PhysFlow playdoh 1e5 and 1 kPa; above ρ g H / 2, so that they stand.
        _ductile("plasticine", 3e5, 0.30, 1200.0, 6e3),
        _ductile("clay", 3e5, 0.35, 1600.0, 8e3),
        _ductile("playdoh", 1e5, 0.40, 1100.0, 4e3),
        # Granular. NCLaw 1e6, 0.2, 25°; PhysGaussian 30°; Genesis 45°. Snow coheres to 3κc = 0.5 kPa: stands under its
        # own weight, crumples on impact and holds together.
        _grains("sand", 1e6, 0.20, 1600.0, 35.0),
        _grains("gravel", 1.5e6, 0.20, 1700.0, 40.0),
        _grains("salt", 1e6, 0.20, 1200.0, 33.0),
        _grains("snow", 3e5, 0.20, 300.0, 30.0, cohesion=1e-3),
        # Pastes. PhysFlow jam 50 Pa and 200 Pa s, Newton mud 300 Pa and 100 Pa s.
        _paste("dough", 8e4, 1100.0, 6e2, 400.0),
        _paste("icecream", 8e4, 600.0, 5e2, 300.0),
        _paste("cream", 3e4, 600.0, 1e2, 30.0),
        _paste("batter", 5e4, 1050.0, 2e1, 60.0),
        _paste("honey", 5e4, 1400.0, 1e1, 60.0),
        _paste("syrup", 5e4, 1300.0, 1e1, 20.0),
        _paste("slime", 3e4, 1050.0, 5e1, 150.0),
        _paste("mud", 8e4, 1700.0, 2e2, 80.0),
        _paste("lava", 1e5, 2400.0, 2e2, 500.0),
        _paste("melted", 5e4, 1000.0, 1.5e1, 200.0),
        # Liquids.
        _liquid("water", 1000.0),
        _liquid("fluid", 1000.0),
        _liquid("milk", 1030.0),
        _liquid("oil", 900.0),
    )
}
"""Word → preset."""

ALIASES = {
    "ice cream": "icecream",
    "play doh": "playdoh",
    "modelling clay": "plasticine",
    "sponge cake": "cake",
    "jello": "jelly",
    "fabric": "cloth",
    "liquid": "fluid",
    "rock": "stone",
    "concrete": "stone",
}
"""Other words for the same materials."""


def lookup(word: str) -> Preset:
    """The preset of a material word, case, hyphens and surplus blanks ignored.

    Raises:
        ValueError: for a word that is not known; the message lists the nearest known ones.
    """
    key = " ".join(word.lower().replace("-", " ").split())
    key = ALIASES.get(key, key)
    if key in PRESETS:
        return PRESETS[key]
    near = difflib.get_close_matches(key, [*PRESETS, *ALIASES], n=3, cutoff=0.5)
    hint = f"nearest known: {', '.join(near)}" if near else f"known: {', '.join(sorted(PRESETS))}"
    raise ValueError(f"unknown material {word!r}; {hint}")


def melt(preset: Preset) -> Preset:
    """What a material becomes when it melts: a Bingham fluid of the same density.

    Yield stress 15 Pa and viscosity 200 Pa s (or what the material already has, if less): a stack of height H = 0.2 m
    sinks at the rate ρ g H/(3η) ≈ 3 /s at first, slows as it spreads, and stops only as a film about 3 cm thick.
    """
    if preset.plastic == "fluid":
        return preset
    flows = preset.plastic == "viscoplastic"
    melted = PRESETS["melted"]
    return replace(
        melted,
        word=f"melted {preset.word}",
        rho=preset.rho,
        yield_stress=min(preset.yield_stress, melted.yield_stress) if flows else melted.yield_stress,
        viscosity=min(preset.viscosity, melted.viscosity) if flows else melted.viscosity,
    )


def _ordered(names: Sequence[str], registry: dict[str, object]) -> tuple[str, ...]:
    return tuple(n for n in registry if n in names)


def candidates(words: Sequence[str], *, melting: bool = False) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Elastic and plastic laws that a fit may choose among for a scene of these materials, in registry order.

    Args:
        words: material words.
        melting: whether they melt.

    Raises:
        ValueError: no word, or an unknown one.
    """
    if not words:
        raise ValueError("a scene needs at least one material word")
    chosen = [melt(p) if melting else p for p in map(lookup, words)]
    elastic = [n for p in chosen for n in p.candidates_elastic]
    plastic = [n for p in chosen for n in p.candidates_plastic]
    return _ordered(elastic, ELASTIC), _ordered(plastic, PLASTIC)


def field(
    presets: Preset | Sequence[Preset],
    index: Tensor | int,
    *,
    dtype: torch.dtype = torch.float32,
    device: torch.device | str | None = None,
) -> MaterialField:
    """One-hot material field: particle p is made of ``presets[index[p]]``.

    Only laws that occur are columns, in registry order. A parameter that a preset's own laws do not read takes the
    preset's value all the same, so that every θ is defined for every particle.

    Args:
        presets: one or several.
        index: which preset each particle has, shape (N,); or N, for one preset everywhere.
        dtype, device: of the result; the device defaults to that of ``index``.

    Raises:
        ValueError: no preset, or an index outside them.
    """
    kinds = [presets] if isinstance(presets, Preset) else list(presets)
    if not kinds:
        raise ValueError("a material field needs at least one preset")
    if isinstance(index, int):
        index = torch.zeros(index, dtype=torch.long)
    index = index.to(device=device or index.device, dtype=torch.long)
    if len(index) and not (0 <= int(index.min()) and int(index.max()) < len(kinds)):
        raise ValueError(f"index must be in [0, {len(kinds) - 1}], got {int(index.min())} to {int(index.max())}")
    elastic = _ordered([p.elastic for p in kinds], ELASTIC)
    plastic = _ordered([p.plastic for p in kinds], PLASTIC)
    names = dict.fromkeys(p.name for kind in kinds for p in kind.params)

    def column(values: list[float]) -> Tensor:
        return torch.tensor(values, dtype=dtype, device=index.device)[index]

    def one_hot(names: tuple[str, ...], own: list[str]) -> Tensor:
        return torch.stack([column([float(name == o) for o in own]) for name in names], dim=-1)

    return MaterialField(
        elastic=elastic,
        plastic=plastic,
        w_e=one_hot(elastic, [p.elastic for p in kinds]),
        w_p=one_hot(plastic, [p.plastic for p in kinds]),
        theta={n: column([getattr(p, n) for p in kinds]) for n in names},
        rho=column([p.rho for p in kinds]),
    )
