"""The material stage for a scene of several things: each label has the material of its word, nothing is fitted."""

import logging
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import torch
from torch import Tensor

from diffuphy.material import presets
from diffuphy.material.elastic import ELASTIC
from diffuphy.material.plastic import PLASTIC
from diffuphy.types import Gaussians, Look, MaterialField, Motion, Particles

log = logging.getLogger(__name__)

CHUNK = 1024
"""Particles whose neighbours are sought at once."""


class Labelled(Protocol):
    """Whoever knows what belongs to what (``text2gs.load.LoadGaussians``)."""

    @property
    def materials(self) -> dict[int, str] | None:
        """Material word of each label."""
        ...

    def kinds(self) -> Tensor:
        """Label of each Gaussian of the object, shape (G,)."""
        ...


@dataclass(frozen=True)
class LabelledMaterial:
    """Matter by label: a particle is of what its Gaussian is made of, filler of what the nearest such particle is."""

    VERSION: ClassVar[int] = 2

    source: Labelled
    """Whose labels."""
    elastic: tuple[str, ...] = ()
    """Elastic laws of the result; () those of the materials."""
    plastic: tuple[str, ...] = ()
    """Plastic laws of the result; () those of the materials."""

    def __post_init__(self) -> None:
        if not self.words:
            raise ValueError("no label has a material: gaussians.labels=labels.npy 'gaussians.materials={1: rubber}'")
        found = [presets.lookup(word) for word in self.words]
        for kind, registry in (("elastic", ELASTIC), ("plastic", PLASTIC)):
            own = [name for name in registry if name in {getattr(p, kind) for p in found}]
            object.__setattr__(self, kind, tuple(getattr(self, kind)) or tuple(own))

    @property
    def words(self) -> tuple[str, ...]:
        """Material words, label by label."""
        return tuple((self.source.materials or {}).values())

    def experts(self, motion: Motion) -> tuple[tuple[str, ...], tuple[str, ...], str]:
        """Elastic and plastic laws of the result, and why."""
        return self.elastic, self.plastic, f"what the labels are made of: {', '.join(self.words)}"

    def __call__(
        self, look: Look, motion: Motion, gaussians: Gaussians, particles: Particles, *, work: Any
    ) -> MaterialField:
        """The material of all particles: one-hot, with the parameters of the table.

        Raises:
            ValueError: other Gaussians than those that the labels are of, or a label without particles.
        """
        labels = self.source.kinds().to(particles.x.device)
        if len(labels) != len(gaussians):
            raise ValueError(
                f"{len(labels)} labels do not fit {len(gaussians)} Gaussians; run the stage gaussians again"
            )
        label = of_particles(labels, particles)
        index = torch.full_like(label, -1)
        for k, (name, word) in enumerate(zip(self.source.materials or {}, self.words, strict=True)):
            index[mine := label == name] = k
            if not bool(mine.any()):
                raise ValueError(f"the label {name} ({word}) has no particles; raise sample.cells, or leave it out")
        return self._field(index)

    def expected(self, motion: Motion, share: float = 1.0) -> MaterialField:
        """What a forecast is made with: one row for each label."""
        return self._field(torch.arange(len(self.words)))

    def _field(self, index: Tensor) -> MaterialField:
        return presets.field([presets.lookup(word) for word in self.words], index)


def of_particles(labels: Tensor, particles: Particles) -> Tensor:
    """Label of each particle, shape (N,): that of the Gaussian it stands at; of filler, that of the nearest particle
    that stands at one."""
    carried = particles.gaussian >= 0
    if not bool(carried.any()):
        raise ValueError("no particle stands at a Gaussian; lower sample.opacity")
    known = torch.where(carried, labels[particles.gaussian.clamp_min(0)], 0)
    x, at = particles.x[carried], known[carried]
    filler = (~carried).nonzero()[:, 0]
    for part in filler.split(CHUNK):
        known[part] = at[torch.cdist(particles.x[part], x).argmin(1)]
    return known


def labelled(
    source: Labelled, elastic: tuple[str, ...] = (), plastic: tuple[str, ...] = (), **fitting: Any
) -> LabelledMaterial:
    """The labelled material of a configuration.

    Args:
        source, elastic, plastic: of ``LabelledMaterial``.
        fitting: settings of a fit, which presets of whole runs change; they are logged, and change nothing.
    """
    if fitting:
        log.info("material: %s not used: labels have their materials, nothing is fitted", ", ".join(fitting))
    return LabelledMaterial(source, elastic, plastic)
