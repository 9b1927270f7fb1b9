"""Gaussians of one's own in the place of fitted ones: read, set upright, cut out, and brought to size."""

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import torch
from torch import Tensor

from diffuphy.render import capture
from diffuphy.render.placement import Axis, Placement
from diffuphy.render.ply import Up, upright_turn
from diffuphy.types import N_SH, Camera, Gaussians, Look
from diffuphy.workspace import Workspace

log = logging.getLogger(__name__)

STRAYS = 1e-3
"""Share of the Gaussians at each end of each axis that the object's box ignores: a few floaters do not make the object
small. Fewer than a thousand Gaussians have a box that holds all of them."""


@dataclass(frozen=True)
class LoadGaussians:
    """Gaussians of a file, as the object of the film.

    What the header of the file promises is checked when the component is made, before any stage runs. Then, in this
    order: read, turned upright (``up``, then ``turns``), the broken and the transparent ones removed, the object
    cut out by ``region``, centred and scaled to a longest side of 2. How many metres that is, the prompt says; what is
    left of the scene stands still around the object (``rest``).
    """

    VERSION: ClassVar[int] = 1

    path: str = field(metadata={"content": capture.source})
    """A .ply or .splat file of Gaussians, or the folder of a scene trained by the original code, whose newest iteration
    is taken. The result depends on what the file holds, not on what it is called."""
    up: Up = "y_down"
    """Which way is up in the file; y_down is what cameras have and what trained scenes mostly follow."""
    turns: tuple[tuple[Axis, float], ...] = ()
    """Further rotations about the then upright axes, [axis, angle [deg]], the first one first: [[x, 90], [z, -30]]."""
    region: tuple[float, float, float, float, float, float] | None = None
    """Box [xmin, xmax, ymin, ymax, zmin, zmax] around the object, in lengths of the file after all rotations; Gaussians
    outside stand still. None takes all of them as the object."""
    min_opacity: float = 0.02
    """Gaussians more transparent than this are haze and are removed [-]; PhysGaussian's value."""
    sh_degree: int = 3
    """Highest degree of spherical harmonics kept, 0 to 3; what the file has above it is not read."""
    max_gaussians: int = 10_000_000
    """A file with more of them is refused before they are read: ten million take 2.4 GB at degree 3, and about four
    times that while they are read."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "turns", check_turns(self.turns))
        upright_turn(self.up)
        if self.region is not None:
            object.__setattr__(self, "region", tuple(map(float, self.region)))
            low, high = self.region[::2], self.region[1::2]
            if len(self.region) != 6 or not all(a < b for a, b in zip(low, high, strict=True)):
                raise ValueError(
                    f"region must be [xmin, xmax, ymin, ymax, zmin, zmax] with min < max, got {list(self.region)}"
                )
        if not 0.0 <= self.min_opacity < 1.0:
            raise ValueError(f"min_opacity must be in [0, 1), got {self.min_opacity}")
        if self.sh_degree not in N_SH or self.max_gaussians < 1:
            raise ValueError(
                f"sh_degree must be 0, 1, 2 or 3 and max_gaussians at least 1, got {self.sh_degree} and "
                f"{self.max_gaussians}"
            )
        if (count := self.count) > self.max_gaussians:
            raise ValueError(
                f"{self.path} has {count} Gaussians, more than {self.max_gaussians}; raise max_gaussians or thin the "
                "scene out"
            )

    def __call__(self, look: Look, *, work: Workspace | None = None) -> Gaussians:
        """The object: centred, longest side 2, z up.

        Raises:
            ValueError: a file that cannot be read, or in which no object is left.
        """
        work = work or Workspace()
        g, kept = self._read()
        inside = self._inside(g)
        subject = self._placed(g, inside, inside)
        counts = {**kept, "around": int((~inside).sum())}
        work.log(0, gaussians=int(inside.sum()), **counts)
        log.info(
            "%d Gaussians of %s; removed %d broken and %d transparent ones; %d stand around the object",
            int(inside.sum()), capture.source(self.path), kept["broken"], kept["transparent"], counts["around"],
        )  # fmt: skip
        return subject.to(work.device)

    def rest(self) -> Gaussians | None:
        """What stands around the object and does not move, in the object's frame; None where there is nothing."""
        if self.region is None:
            return None
        g, _ = self._read()
        inside = self._inside(g)
        return self._placed(g, inside, ~inside) if bool((~inside).any()) else None

    def cameras(self) -> tuple[Camera, ...]:
        """The cameras of a scene's folder in the object's frame; see ``capture.cameras``."""
        g, _ = self._read()
        place = normalised(g.means[self._inside(g)], self.path)
        quarter = Placement.turns([("x", 90.0 * upright_turn(self.up))])
        turn = Placement.turns(self.turns)
        return tuple(place.camera(turn.camera(quarter.camera(c))) for c in capture.cameras(self.path))

    def longest(self) -> float:
        """Longest side of the object, in lengths of the file."""
        g, _ = self._read()
        return 2.0 / normalised(g.means[self._inside(g)], self.path).scale

    @property
    def count(self) -> int:
        """Gaussians in the file."""
        return capture.count(self.path)

    def _read(self) -> tuple[Gaussians, dict[str, int]]:
        """Sound Gaussians of the file, upright; and how many were removed, and why."""
        g = capture.read(self.path, up=self.up, degree=self.sh_degree)
        whole = sound(g)
        solid = torch.sigmoid(g.logit_opacities) >= self.min_opacity
        keep = whole & solid
        if not bool(keep.any()):
            raise ValueError(
                f"{self.path}: none of {len(g)} Gaussians is left: {int((~whole).sum())} have numbers that are not "
                f"finite, {int((whole & ~solid).sum())} an opacity below {self.min_opacity}"
            )
        removed = {"broken": int((~whole).sum()), "transparent": int((whole & ~solid).sum())}
        return Placement.turns(self.turns)(taken(g, keep)), removed

    def _inside(self, g: Gaussians) -> Tensor:
        """True for the Gaussians of the object, shape (G,)."""
        if self.region is None:
            return torch.ones(len(g), dtype=torch.bool)
        low, high = g.means.new_tensor(self.region[::2]), g.means.new_tensor(self.region[1::2])
        inside = ((g.means >= low) & (g.means <= high)).all(1)
        if not bool(inside.any()):
            first, last = ([round(v, 3) for v in t.tolist()] for t in (g.means.amin(0), g.means.amax(0)))
            raise ValueError(
                f"no Gaussian lies in gaussians.region = {list(self.region)}; upright, the scene reaches from {first} "
                f"to {last}"
            )
        return inside

    def _placed(self, g: Gaussians, inside: Tensor, which: Tensor) -> Gaussians:
        """The Gaussians ``which``, in the frame of the object, those ``inside``."""
        placed = normalised(g.means[inside], self.path)(taken(g, which))
        if not bool((whole := sound(placed)).all()):
            raise ValueError(
                f"{self.path}: {int((~whole).sum())} Gaussians are so large or far away that at the object's scale "
                "float32 does not hold them; remove them from the file, or cut the object out with a larger region"
            )
        return placed


def check_turns(turns: Sequence[Sequence[Any]]) -> tuple[tuple[Axis, float], ...]:
    """Rotations (axis, angle [deg]) as they were given, in a list or a tuple.

    Raises:
        ValueError: no axis, or no angle.
    """
    found = tuple((axis, float(angle)) for axis, angle in turns)
    if any(axis not in ("x", "y", "z") or not math.isfinite(angle) for axis, angle in found):
        raise ValueError(f"turns must be a list of [x, y or z, degrees], got {[list(t) for t in found]}")
    return found


def normalised(means: Tensor, path: str) -> Placement:
    """What centres the box of an object's ``means`` (G, 3) and makes its longest side 2; ``path`` is for the error."""
    low, high = box(means.double())
    longest = float((high - low).amax())
    if not longest > 0.0:
        raise ValueError(
            f"{path}: the {len(means)} Gaussians of the object lie in one point; an object needs an extent"
        )
    scale = 2.0 / longest
    return Placement(Placement.turns(()).quat, scale, -scale * (low + high) / 2)


def sound(g: Gaussians) -> Tensor:
    """True where every number of a Gaussian is finite, its sizes too, and its orientation is one, shape (G,)."""
    size, norm = g.log_scales.exp(), torch.linalg.vector_norm(g.quats, dim=1)
    finite = [t.flatten(1).isfinite().all(1) for t in (g.means, g.log_scales, size, g.sh)]
    return torch.stack([*finite, g.logit_opacities.isfinite(), norm > 0.0, norm.isfinite()]).all(0)


def taken(g: Gaussians, keep: Tensor) -> Gaussians:
    """The Gaussians where ``keep`` is true."""
    return Gaussians(g.means[keep], g.quats[keep], g.log_scales[keep], g.logit_opacities[keep], g.sh[keep])


def box(x: Tensor) -> tuple[Tensor, Tensor]:
    """Lowest and highest corner (3,) of the points (n, 3) but for ``STRAYS`` of them at each end of each axis."""
    k = 1 + int(STRAYS * len(x))
    return x.kthvalue(k, dim=0).values, x.kthvalue(len(x) + 1 - k, dim=0).values
