"""What each preset and choice of the configuration needs, and whether it fits into memory."""

import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from diffuphy.doctor.machine import Machine
from diffuphy.models import Model, known, missing
from diffuphy.models.registry import NETWORKS, WIDTH

GROUPS = ("experiment", "refine", "guidance", "video_guidance", "evaluate")
"""Groups of the configuration whose choices decide which models are loaded."""

ALLOWANCE = 4 * 2**30
"""Memory beside the weights of a run with diffusion models [byte]: what the autoencoder keeps of one 512 px picture in
float32, 3.2 GiB (counted on the meta device), rounded up."""


@dataclass(frozen=True)
class Need:
    """What one choice loads."""

    choice: str
    """As one types it; empty for the default."""
    models: tuple[Model, ...]
    """Without which it does not run."""
    scores: tuple[Model, ...]
    """Without which some scores are left out."""
    bytes: int | None
    """Memory for weights, and ``ALLOWANCE`` if there are any; None where it is not known."""
    missing: tuple[str, ...] = ()
    """Those of ``models`` and ``scores`` that are not on this machine, or not all that is loaded of them."""
    also: tuple[str, ...] = ()
    """What else it needs."""
    asks: str = ""
    """Which setting it cannot do without, in its own words."""

    def verdict(self, machine: Machine) -> str:
        """Whether this machine's memory will do."""
        if self.asks:
            return self.asks
        if not self.models:
            return "runs"
        if self.bytes is None:
            return "memory not known"
        needs = f"about {gib(self.bytes)}"
        if machine.gpus:
            best = max(machine.gpus, key=lambda g: g.bytes)
            fits = "fits" if self.bytes <= best.bytes else "does not fit"
            return f"{needs}: {fits} {best.name}, {gib(best.bytes)}"
        fits = "fits the memory" if self.bytes <= machine.bytes else "does not fit the memory"
        return f"{needs}: no GPU; {fits} of the CPU, {gib(machine.bytes)}, where it is slow and was never timed"


def gib(count: int) -> str:
    return f"{count / 2**30:.1f} GiB"


def choices(conf: Path) -> list[str]:
    """Every choice of ``GROUPS``, as overrides; first the default, which is none."""
    found = (f"{group}={f.stem}" for group in GROUPS for f in sorted((conf / group).glob("*.yaml")))
    return ["", *found]


def need(choice: str, components: Mapping[str, Any]) -> Need:
    """What the components of a run load.

    Args:
        components: by stage.
    """
    used = [(stage, owner, m) for stage, part in components.items() for owner, m in loaded(part)]
    scores = {m.id: m for stage, _, m in used if stage == "evaluate"}
    runs = {m.id: (m, weights(m, owner)) for stage, owner, m in used if stage != "evaluate"}
    sizes = [size for _, size in runs.values()]
    total = None if None in sizes else sum(size for size in sizes if size is not None) + ALLOWANCE * bool(runs)
    absent = dict.fromkeys(m.id for _, owner, m in used if lacks(owner, m))
    return Need(
        choice,
        tuple(m for m, _ in runs.values()),
        tuple(scores.values()),
        total,
        tuple(absent),
        tuple(also(components)),
    )


def lacks(owner: Any, model: Model) -> bool:
    """Whether anything that a component loads of a model is not on this machine."""
    kinds = getattr(owner, "kinds", None)
    return bool(model.missing() if kinds is None else missing(model.id, kinds, model.setting))


def loaded(component: Any) -> Iterator[tuple[Any, Model]]:
    """Every known model that a setting of a component, or of one inside it, names."""
    if not dataclasses.is_dataclass(component):
        return
    for f in dataclasses.fields(component):
        value = getattr(component, f.name)
        if isinstance(value, str) and (model := known(value)) is not None:
            yield component, model
        yield from loaded(value)


def weights(model: Model, owner: Any) -> int | None:
    """Memory of the weights as their component loads them [byte]; None where their number is not known.

    The text encoder is freed when the words are embedded, and autoencoders stay in float32: what counts is the larger
    of the text encoder alone and of all the others together.
    """
    width = WIDTH[getattr(owner, "dtype", "float32")]
    networks = {p: part.parameters for p, part in model.parts.items() if part.kind in NETWORKS}
    if None in networks.values():
        return None
    sizes = {p: (count or 0) * (4 if p == "vae" else width) for p, count in networks.items()}
    return max(sizes.pop("text_encoder", 0), sum(sizes.values()))


def also(components: Mapping[str, Any]) -> Iterator[str]:
    """Keys that a component takes from the environment."""
    for part in components.values():
        if not dataclasses.is_dataclass(part):
            continue
        for f in dataclasses.fields(part):
            key = getattr(getattr(part, f.name), "key_variable", None)
            if isinstance(key, str):
                yield f"a key in ${key}"
