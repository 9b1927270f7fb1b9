"""What stands around the object: Gaussians of the scene that no simulation moves."""

import dataclasses
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from diffuphy.render.film.captured import standing
from diffuphy.render.skin import Skin
from diffuphy.types import Gaussians, Particles


class Around(Protocol):
    """Whoever knows what stands around the object (``text2gs.load.LoadGaussians``)."""

    def rest(self) -> Gaussians | None:
        """Gaussians in the object's frame; None where there is nothing."""
        ...

    def floor(self) -> float | None:
        """Height of the ground in the object's frame; None where the object's underside is the floor."""
        ...


@dataclass(frozen=True)
class Scenery:
    """A skin, and Gaussians that stay where they are: drawn together, each hides the other."""

    skin: Skin
    """Of the object."""
    gaussians: Gaussians
    """Those of the skin, then those that stay, at rest, in metres."""

    def __call__(self, x: Tensor, F: Tensor) -> tuple[Tensor, Tensor]:
        """Centres (G, 3) [m] and deformations (G, 3, 3) for particles at ``x`` (N, 3) deformed by ``F`` (N, 3, 3)."""
        means, F_g = self.skin(x, F)
        still = self.gaussians.means[len(means) :]
        return torch.cat([means, still]), torch.cat([F_g, torch.eye(3).to(F_g).expand(len(still), 3, 3)])


def with_scenery(skin: Skin, around: Around | None, particles: Particles) -> Skin | Scenery:
    """``skin``, with what stands around its object if there is anything; as :func:`scenery` places it."""
    still = scenery(around, particles)
    return skin if still is None else Scenery(skin, together(skin.gaussians, still))


def scenery(around: Around | None, particles: Particles) -> Gaussians | None:
    """What stands around the object, in metres, z up; None where there is nothing.

    The floor of the simulation, z = 0, is where the object of ``particles`` stood in its scene: what stands around is
    placed as if the lowest particle were there. Where the scene has a ground of its own, that is the floor.
    """
    rest = around.rest() if around is not None else None
    if around is None or rest is None:
        return None
    return standing(particles, around.floor())(rest.to(particles.x.device))


def together(*parts: Gaussians) -> Gaussians:
    """All of some Gaussians, of one degree, on the device and in the precision of the first."""
    names = [f.name for f in dataclasses.fields(Gaussians)]
    return Gaussians(**{n: torch.cat([getattr(g, n).to(parts[0].means) for g in parts]) for n in names})
