"""What brings an object of any size and place into the frame of the object: centred, longest side 2."""

import math
from collections.abc import Sequence
from typing import Any

from torch import Tensor

from diffuphy.render.scenes.placement import Axis, Placement

STRAYS = 1e-3
"""Share of the Gaussians at each end of each axis that the object's box ignores: a few floaters do not make the object
small. Fewer than a thousand Gaussians have a box that holds all of them."""


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


def box(x: Tensor) -> tuple[Tensor, Tensor]:
    """Lowest and highest corner (3,) of the points (n, 3) but for ``STRAYS`` of them at each end of each axis."""
    k = 1 + int(STRAYS * len(x))
    return x.kthvalue(k, dim=0).values, x.kthvalue(len(x) + 1 - k, dim=0).values
