"""The block of grid nodes around the particles; it follows them, so the cost is that of the body and not of a world."""

import math
from dataclasses import dataclass

Index = tuple[int, int, int]

MAX_NODES = 2**31 // 4
"""Most nodes of a block: node indices are 32-bit, with room to spare."""


@dataclass(frozen=True)
class Grid:
    """Nodes x = (origin + i) Δx, i = 0 … shape − 1. The lattice is fixed in space: moving the block changes nothing
    but rounding."""

    dx: float
    """Node spacing Δx [m]."""
    origin: Index
    """Lowest node, in units of Δx."""
    shape: Index
    """Nodes along each axis."""

    @property
    def nodes(self) -> int:
        """Number of nodes."""
        return self.shape[0] * self.shape[1] * self.shape[2]

    @classmethod
    def around(cls, low: tuple[float, ...], high: tuple[float, ...], dx: float) -> "Grid":
        """The smallest block whose particles may move anywhere between ``low`` and ``high`` [m].

        A particle at x touches nodes ⌊x/Δx − ½⌋ … + 2 (quadratic B-spline).
        """
        origin = tuple(math.floor(a / dx - 0.5) for a in low)
        shape = tuple(math.floor(b / dx - 0.5) + 3 - o for b, o in zip(high, origin, strict=True))
        return cls(dx, origin, shape)._checked()  # type: ignore[arg-type]

    def grown(self, cells: int) -> "Grid":
        """The block with ``cells`` more nodes on every side."""
        origin, shape = tuple(o - cells for o in self.origin), tuple(n + 2 * cells for n in self.shape)
        return Grid(self.dx, origin, shape)._checked()  # type: ignore[arg-type]

    def _checked(self) -> "Grid":
        if self.nodes > MAX_NODES:
            raise ValueError(
                f"the particles span {self.shape} grid cells of {self.dx:.3g} m, more than {MAX_NODES} in all; "
                "enlarge dx, or add walls that keep them together"
            )
        return self
