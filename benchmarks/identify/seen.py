"""What a clip can tell: standard errors from its Fisher information, and what cannot be told apart."""

import dataclasses
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from benchmarks.identify.newton import least_squares
from benchmarks.identify.recover import BEYOND, fitting, made, made_by
from benchmarks.identify.rows import Rows, Stopwatch
from benchmarks.identify.specimens import SPECIMENS, Specimen
from benchmarks.identify.watch import CAMERA, Watch
from diffuphy.learning.case import parameters
from diffuphy.learning.identifiability import RHO, fisher, steady_film
from diffuphy.material import ELASTIC, Param
from diffuphy.mpm import Scheme
from diffuphy.types import MaterialField

NOISE = 0.05
"""Standard deviation of a pixel that the errors are stated for [-]."""
TOGETHER: tuple[tuple[str, tuple[str, ...], dict[str, float]], ...] = (
    ("rubber", ("E",), {}),
    ("rubber", ("E", "nu"), {}),
    ("rubber", ("E", "rho"), {}),
    ("plasticine", ("yield_stress",), {}),
    ("plasticine", ("E", "yield_stress"), {}),
    ("plasticine", ("E", "nu", "yield_stress"), {}),
    ("plasticine", ("E", "yield_stress"), {"yield_stress": 5e5}),
    ("sand", ("friction_angle",), {}),
    ("sand", ("E", "friction_angle"), {}),
    ("sand", ("friction_angle", "rho"), {}),
    ("honey", ("viscosity",), {}),
    ("honey", ("yield_stress", "viscosity"), {}),
    ("honey", ("E", "yield_stress", "viscosity"), {}),
    ("two halves", ("E",), {}),
    ("halves side by side", ("E",), {}),
)
"""Specimen, what is sought together, and values other than its own [SI]."""
SCHEMES = {
    "elastic": Scheme(contact="elastic"),
    "rigid": Scheme(),
    "elastic, not sharpened": Scheme(contact="elastic", sharpen=False),
    "elastic, nothing retained": Scheme(contact="elastic", retain=0.0),
    "elastic, neither": Scheme(contact="elastic", sharpen=False, retain=0.0),
}
"""By their contact; all but the last three sharpen and retain."""
RESOLUTIONS = ((500, "elastic"), (1500, "elastic"), (1500, "rigid"), (4000, "elastic"))
"""Particles of the fit, and the scheme of both simulations."""
GRAINY = (
    (1500, "elastic, not sharpened"), (1500, "elastic, nothing retained"),
    (500, "elastic, neither"), (1500, "elastic, neither"), (4000, "elastic, neither"),
)  # fmt: skip
"""More for sand."""
STRAINS = (6.0, 5.0, 4.0)
"""log10 E of the bodies whose elastic laws are compared: the softer, the larger the strain."""


def middle(specimen: Specimen) -> Tensor:
    """Coordinates of the middle of the specimen's ranges; of halves, one ten times as stiff as the other."""
    if specimen.halves:
        return torch.tensor([4.2, 5.2], dtype=torch.float64)
    return torch.stack(specimen.box()).mean(0)


def at(specimen: Specimen, watch: Watch, other: dict[str, float]) -> MaterialField:
    """The middle of the specimen's ranges, with some values replaced."""
    field = specimen.field(watch.labels, middle(specimen))
    return dataclasses.replace(field, theta=field.theta | {n: torch.full_like(field.rho, v) for n, v in other.items()})


def study(out: Path, only: Sequence[str] = ()) -> Rows:
    """Errors and conditioning of each set of parameters; how far elastic laws differ."""
    rows = Rows(out / "identify_seen.json", ("what", "specimen", "sought", "other"))
    for name, sought, other in TOGETHER:
        key = {"what": "fisher", "specimen": name, "sought": " ".join(sought), "other": str(other)}
        if (not only or name in only) and not rows.has(**key):
            rows.add(**key, **_fisher(SPECIMENS[name], sought, other))
    for name in ("rubber", "plasticine", "honey") if not only else ():
        key = {"what": "scaled", "specimen": name, "sought": "", "other": ""}
        if not rows.has(**key):
            rows.add(**key, largest=_scaled(SPECIMENS[name]))
    for log_E in STRAINS if not only else ():
        key = {"what": "laws", "specimen": "rubber", "sought": f"{log_E:g}", "other": ""}
        if not rows.has(**key):
            rows.add(**key, **_laws(log_E))
    return rows


def _fisher(specimen: Specimen, sought: tuple[str, ...], other: dict[str, float]) -> dict[str, Any]:
    watch, clock = fitting(specimen), Stopwatch()
    known = {p.name: p for p in parameters((specimen.elastic,), (specimen.plastic,))} | {"rho": RHO}
    params: list[Param] = [known[n] for n in sought]
    labels = watch.labels * int(specimen.halves)
    field = at(specimen, watch, other)
    found = fisher(steady_film(watch.bench, field), field, params, labels, NOISE)
    return {
        "names": list(found.names), "errors": found.errors.tolist(), "alone": found.alone.tolist(),
        "condition": found.condition, "remarks": found.remarks(), "seconds": clock.seconds,
    }  # fmt: skip


def _scaled(specimen: Specimen) -> float:
    """Largest difference of a pixel when density and everything in pascals are eight times as large."""
    watch = fitting(specimen)
    field = at(specimen, watch, {})
    pascals = [n for n in ("E", "yield_stress", "viscosity") if n in field.theta]
    heavy = dataclasses.replace(
        field, rho=8 * field.rho, theta=field.theta | {n: 8 * field.theta[n] for n in pascals}
    )  # fmt: skip
    with torch.no_grad():
        a, b = (watch.bench.film(watch.bench.simulate(f)) for f in (field, heavy))
    return float((a - b).abs().max())


def _laws(log_E: float) -> dict[str, Any]:
    """Root mean square difference of the clips of elastic laws from neo-Hookean, and of another draw of particles."""
    rubber = SPECIMENS["rubber"]
    mine = fitting(rubber)
    q = torch.tensor([log_E], dtype=torch.float64)

    def clip(watch: Watch, law: str) -> Tensor:
        return watch.see(watch.drop(dataclasses.replace(rubber, elastic=law), q), CAMERA)

    own = clip(mine, "neo_hookean")
    laws = [n for n in ("fixed_corotated", "hencky", "stvk", "stvk_hencky") if n in ELASTIC]
    differ = {law: float((clip(mine, law) - own).square().mean().sqrt()) for law in laws}
    draw = float((clip(made_by(rubber, "same", 1), "neo_hookean") - own).square().mean().sqrt())
    z = mine.drop(rubber, q).x[:, :, 2]
    high = z.amax(1) - z.amin(1)
    flat = float(1 - high.min() / high[0])
    return {"differ": differ, "another_draw": draw, "flattened": flat}


def biases(out: Path) -> Rows:
    """Where a fit ends that starts at the truth, by resolution and scheme: what discretisation does to an estimate."""
    rows = Rows(out / "identify_resolution.json", ("specimen", "particles", "scheme", "seed"))
    for seed in (1, 2):
        for name in ("rubber", "plasticine", "sand", "honey", "two halves", "halves side by side"):
            for particles, scheme in (*RESOLUTIONS, *(GRAINY if name == "sand" else ())):
                key = {"specimen": name, "particles": particles, "scheme": scheme, "seed": seed}
                if not rows.has(**key):
                    rows.add(**key, **_bias(SPECIMENS[name], particles, SCHEMES[scheme], seed))
    return rows


@cache
def _target(specimen: Specimen, theirs: Watch) -> Tensor:
    """The clip of the middle of the specimen's ranges."""
    return theirs.see(theirs.drop(specimen, middle(specimen)), CAMERA)


def _bias(specimen: Specimen, particles: int, scheme: Scheme, seed: int) -> dict[str, Any]:
    theirs = made(seed, 2.0, dataclasses.replace(specimen.probe, scheme=scheme), specimen.seam)
    mine = made(0, 1.0, dataclasses.replace(theirs.bench.probe, particles=particles), specimen.seam)
    (lo, hi), q, target = specimen.box(BEYOND), middle(specimen), _target(specimen, theirs)
    clock = Stopwatch()
    found = least_squares(lambda at: mine.see(mine.drop(specimen, at), CAMERA) - target, q, lo=lo, hi=hi)
    seconds = clock.seconds / found.clips
    return {"bias": specimen.errors(found.q, q), "rms": (2 * found.cost / target.numel()) ** 0.5, "seconds": seconds}
