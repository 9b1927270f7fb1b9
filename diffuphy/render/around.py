"""What stands around the object: Gaussians of the scene that no simulation moves."""

import dataclasses
from dataclasses import dataclass
from typing import Protocol, Self

import torch
from torch import Tensor

from diffuphy.render.skin import to_metres
from diffuphy.types import Gaussians, Particles


class Around(Protocol):
    """Whoever knows what stands around the object (``text2gs.load.LoadGaussians``)."""

    def rest(self) -> Gaussians | None:
        """Gaussians in the object's frame; None where there is nothing."""
        ...


@dataclass(frozen=True)
class Still:
    """Gaussians that stay where they are, drawn together with those that move: one picture, each hiding the other.

    The floor of the simulation, z = 0, is where the object stood in its scene: the rest is placed about an object whose
    lowest particle is there.
    """

    gaussians: Gaussians
    """In metres."""

    @classmethod
    def of(cls, around: Around | None, particles: Particles) -> Self | None:
        """Of the object that ``particles`` make up; None where nothing stands around it."""
        rest = around.rest() if around is not None else None
        if rest is None:
            return None
        g = to_metres(rest.to(particles.x.device), particles)
        down = torch.stack([g.means.new_zeros(()), g.means.new_zeros(()), particles.x[:, 2].amin().to(g.means)])
        return cls(dataclasses.replace(g, means=g.means - down))

    def beside(self, moving: Gaussians) -> Gaussians:
        """Those that move, then those that stay."""
        names = [f.name for f in dataclasses.fields(Gaussians)]
        return Gaussians(**{n: torch.cat([getattr(moving, n), getattr(self.gaussians, n)]) for n in names})

    def moved(self, means: Tensor, F: Tensor) -> tuple[Tensor, Tensor]:
        """Centres and deformations of all, given those of the moving ones."""
        still = self.gaussians.means
        return torch.cat([means, still]), torch.cat([F, torch.eye(3).to(F).expand(len(still), 3, 3)])
