"""Views of matter: every particle in the colour of what it is made of or of what it undergoes.

    paint = painter("stress", trajectory, field)      # its scale is that of the whole film
    colors = paint(Moment.of(trajectory, t))          # (N, 3)
    card = paint.legend(height)                       # rgba

A view is one entry of ``VIEWS``; a new one needs nothing else.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, Self

import torch
from torch import Tensor

from diffuphy.geometry import volume_ratio
from diffuphy.render.film import colormap
from diffuphy.render.film.colormap import CATEGORIES, OTHER, Scale
from diffuphy.types import MaterialField, Trajectory

SAMPLED = 2**22
"""Values of a film, at most, that its scale is found from, evenly chosen from all frames: percentiles do not need
more."""

SHOWN = 0.01
"""Share of a law in all particles below which it has no entry in the legend."""


@dataclass(frozen=True)
class Moment:
    """N particles at one time."""

    x: Tensor
    """Positions, shape (N, 3) [m]."""
    v: Tensor
    """Velocities, shape (N, 3) [m/s]."""
    F: Tensor
    """Total deformation gradients, shape (N, 3, 3)."""
    Fe: Tensor | None = None
    """Elastic part of F, shape (N, 3, 3); None where nothing flows: it is F then."""

    @classmethod
    def of(cls, trajectory: Trajectory, t: int) -> Self:
        """Frame ``t`` of a trajectory."""
        Fe = None if trajectory.Fe is None else trajectory.Fe[t]
        return cls(trajectory.x[t], trajectory.v[t], trajectory.F[t], Fe)


@dataclass(frozen=True)
class View:
    """One quantity of a particle."""

    label: str
    """What a legend calls it."""
    unit: str
    """SI; empty for a ratio."""
    kind: Literal["linear", "log", "ratio"]
    """Scale of its colours."""
    values: Callable[[Moment, MaterialField | None], Tensor]
    """(moment, field) → (N,)."""
    matter: bool = False
    """Whether it asks for the material."""


def _stiffness(now: Moment, field: MaterialField | None) -> Tensor:
    assert field is not None
    return field.theta["E"]


def _stress(now: Moment, field: MaterialField | None) -> Tensor:
    from diffuphy.material.cauchy import cauchy, von_mises

    assert field is not None
    if now.Fe is None and any(law != "identity" for law in field.plastic):
        raise ValueError(
            f"this motion does not say what of its deformation is elastic, and {', '.join(field.plastic)} may flow: "
            "simulate again (force=trajectory)"
        )
    return von_mises(cauchy(now.F if now.Fe is None else now.Fe, volume_ratio(now.F, now.Fe).to(now.F), field))


VIEWS = {
    "E": View("Young's modulus", "Pa", "log", _stiffness, matter=True),
    "stress": View("von Mises stress", "Pa", "linear", _stress, matter=True),
    "J": View("volume ratio J", "", "ratio", lambda now, field: volume_ratio(now.F, now.Fe).to(now.F)),
    "velocity": View("speed", "m/s", "linear", lambda now, field: torch.linalg.vector_norm(now.v, dim=1)),
}
"""Quantities by name."""

PAINTED = ("material", *VIEWS)
"""Views that give particles a colour."""

IMAGES = ("depth", "normals")
"""Views that are made of pictures, not of particles."""

ALL = ("colour", *IMAGES, *PAINTED)
"""Every view of a film."""


class Painter(Protocol):
    """Colours of particles, and what they mean."""

    def __call__(self, now: Moment) -> Tensor:
        """Colours (N, 3) in [0, 1]."""
        ...

    def legend(self, height: int) -> Tensor:
        """Card for a film of ``height`` px, rgba (h, w, 4) in [0, 1]."""
        ...


def wants_matter(view: str) -> bool:
    """Whether a view asks for the material."""
    return view == "material" or (view in VIEWS and VIEWS[view].matter)


def painter(view: str, trajectory: Trajectory, field: MaterialField | None = None) -> Painter:
    """Who paints the particles of a film, on one scale for all of its frames.

    Raises:
        ValueError: a view of another name, or one of the material without a material.
    """
    if view not in PAINTED:
        raise ValueError(f"a painted view is one of {', '.join(PAINTED)}, got {view!r}")
    if field is None and wants_matter(view):
        raise ValueError(f"the view {view!r} shows what the particles are made of; give their material")
    if view == "material":
        assert field is not None
        return Mixed.of(field)
    frames, count = trajectory.x.shape[:2]
    step = max(1, -(-frames * count // SAMPLED))
    values = [VIEWS[view].values(Moment.of(trajectory, t), field) for t in range(0, frames, step)]
    return Measured(VIEWS[view], Scale.of(torch.cat(values), VIEWS[view].kind), field)


@dataclass(frozen=True)
class Measured:
    """Paints by one quantity."""

    view: View
    scale: Scale
    field: MaterialField | None = None

    def __call__(self, now: Moment) -> Tensor:
        return self.scale.colors(self.view.values(now, self.field))

    def legend(self, height: int) -> Tensor:
        return colormap.bar(self.view.label, self.view.unit, self.scale, height)


@dataclass(frozen=True)
class Mixed:
    """Paints by the laws that a particle follows: the mean of their colours, by their weights."""

    names: tuple[str, ...]
    """Laws, the most frequent first."""
    shares: tuple[float, ...]
    """Mean weight of each."""
    colors: Tensor
    """Of each particle, shape (N, 3)."""

    @classmethod
    def of(cls, field: MaterialField, kind: Literal["pairs", "elastic", "plastic"] = "pairs") -> Self:
        """By pairs of an elastic and a plastic law, or by those of one kind.

        A pair has the product of both weights. The six most frequent have colours, all others are grey.
        """
        if kind == "pairs":
            labels = [e if p == "identity" else f"{e} + {p}" for e in field.elastic for p in field.plastic]
            weights = (field.w_e[:, :, None] * field.w_p[:, None, :]).flatten(1)
        else:
            labels = list(field.elastic if kind == "elastic" else field.plastic)
            weights = field.w_e if kind == "elastic" else field.w_p
        order = weights.mean(0).argsort(descending=True, stable=True).tolist()
        weights = weights[:, order]
        palette = torch.tensor(OTHER).repeat(len(order), 1)
        palette[: len(CATEGORIES)] = CATEGORIES[: len(order)]
        colors = weights @ palette.to(weights)
        return cls(tuple(labels[k] for k in order), tuple(weights.mean(0).tolist()), colors)

    def __call__(self, now: Moment | None = None) -> Tensor:
        return self.colors

    @property
    def entries(self) -> list[tuple[str, float, int]]:
        """(law, share, number of its colour) of what has a share to speak of."""
        found = zip(self.names, self.shares, range(len(CATEGORIES)), strict=False)
        return [(name, share, k) for name, share, k in found if share >= SHOWN]

    def legend(self, height: int) -> Tensor:
        return colormap.names([(f"{name} {share:.0%}", CATEGORIES[k]) for name, share, k in self.entries], height)


def onto_gaussians(colors: Tensor, index: Tensor, weight: Tensor) -> Tensor:
    """Colours of Gaussians (G, 3) from those of particles (N, 3) that they follow.

    Args:
        index, weight: the particles and their shares, shape (G, k) each (``Skin``).
    """
    return (weight[..., None] * colors[index]).sum(1)


def check_view(view: str, also: Sequence[str] = ()) -> None:
    """Refuse a view that there is not.

    Raises:
        ValueError: naming it and those there are.
    """
    for name in (view, *also):
        if name not in ALL:
            raise ValueError(f"a view is one of {', '.join(ALL)}, got {name!r}")
