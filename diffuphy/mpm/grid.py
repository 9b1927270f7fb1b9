"""The block of grid nodes around the particles; it follows them, so the cost is that of the body and not of a world."""

import math
from dataclasses import dataclass

Index = tuple[int, int, int]

MAX_NODES = 2**31 // 4
"""Most nodes of a block: node indices are 32-bit, with room to spare."""


@dataclass(frozen=True)
class Grid:
    """Nodes x = (origin + shift + i) Δx, i = 0 … shape − 1. The lattice is fixed in space: moving the block changes
    nothing but rounding."""

    dx: float
    """Node spacing Δx [m]."""
    origin: Index
    """Lowest node, in units of Δx."""
    shape: Index
    """Nodes along each axis."""
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Where the lattice lies, 0 ≤ shift < 1 [Δx]: mirror walls have a plane of nodes on them."""

    @property
    def low(self) -> tuple[float, ...]:
        """Place of the lowest node [m]."""
        return tuple((o + s) * self.dx for o, s in zip(self.origin, self.shift, strict=True))

    @property
    def nodes(self) -> int:
        """Number of nodes."""
        return self.shape[0] * self.shape[1] * self.shape[2]

    @classmethod
    def around(
        cls,
        low: tuple[float, ...],
        high: tuple[float, ...],
        dx: float,
        order: int = 2,
        shift: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> "Grid":
        """The smallest block whose particles may move anywhere between ``low`` and ``high`` [m].

        A particle at x touches nodes ⌊x/Δx − (order − 1)/2⌋ … + order (B-spline of that degree).
        """
        half = 0.5 * (order - 1)
        first = [math.floor(a / dx - s - half) for a, s in zip(low, shift, strict=True)]
        last = [math.floor(b / dx - s - half) + order for b, s in zip(high, shift, strict=True)]
        shape = tuple(b + 1 - a for a, b in zip(first, last, strict=True))
        return cls(dx, tuple(first), shape, shift)._checked()  # type: ignore[arg-type]

    def grown(self, cells: int) -> "Grid":
        """The block with ``cells`` more nodes on every side."""
        origin, shape = tuple(o - cells for o in self.origin), tuple(n + 2 * cells for n in self.shape)
        return Grid(self.dx, origin, shape, self.shift)._checked()  # type: ignore[arg-type]

    def _checked(self) -> "Grid":
        if self.nodes > MAX_NODES:
            raise ValueError(
                f"the particles span {self.shape} grid cells of {self.dx:.3g} m, more than {MAX_NODES} in all; "
                "enlarge dx, or add walls that keep them together"
            )
        return self
