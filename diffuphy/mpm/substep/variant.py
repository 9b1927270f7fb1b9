"""What kernels are compiled for: everything else is data."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from types import SimpleNamespace
from typing import Any

import warp as wp

from diffuphy.compiling import LOCK
from diffuphy.mpm.drive.kernels import HOLDING_KINDS
from diffuphy.mpm.scheme import Scheme

Signature = tuple[Any, ...]

_made: dict[tuple[Any, ...], SimpleNamespace] = {}


@dataclass(frozen=True)
class Variant:
    """One set of kernels. A feature that is False or empty leaves no trace in their source."""

    mixture: Any
    """Laws, from ``material.make_mixture``."""
    real: type
    """``wp.float32`` or ``wp.float64``."""
    scheme: Scheme = Scheme()
    """Transfer and time integration."""
    walls: Signature = ()
    """From ``boundary.signature``."""
    held: tuple[int, ...] = ()
    """Numbers of the walls that take their part of the acceleration before it is sharpened: those that hold always and
    set their nodes. A mirror does so by itself."""
    mirror: bool = False
    """Whether some wall reflects."""
    drives: Signature = ()
    """From ``drive.signature``."""
    body: bool = False
    """Whether there is an acceleration for every particle."""
    measures: bool = False
    """Whether the impulse of the walls is summed."""
    twice: bool = False
    """Whether the nodes are gone through twice although nothing else asks for it, as a backward pass needs."""

    sparse: bool = False
    """Whether only some nodes of the block are worked on, see ``active``."""

    @cached_property
    def elastic(self) -> bool:
        """Whether some wall is elastic, so that nodes know how far from it their matter is."""
        return any(wall[-1] for wall in self.walls)

    @cached_property
    def obstructs(self) -> bool:
        """Whether some drive holds particles, which stop the others."""
        return any(kind in HOLDING_KINDS for kind, _ in self.drives)

    @cached_property
    def loads(self) -> bool:
        """Whether nodes keep their acceleration beside what is left of it to be sharpened."""
        return len(self.held) > 0 or (self.obstructs and self.scheme.sharpen)

    @cached_property
    def two_passes(self) -> bool:
        """Whether nodes read their neighbours, so that a pass must end before the next begins."""
        return self.scheme.sharpen or self.mirror or self.twice or self.elastic or self.obstructs

    @cached_property
    def vec3(self) -> Any:
        return wp.types.vector(3, self.real)

    @cached_property
    def mat33(self) -> Any:
        return wp.types.matrix((3, 3), self.real)

    @cached_property
    def node_t(self) -> Any:
        """Row of a node: see ``transfer``."""
        return wp.types.vector(8, self.real)

    @cached_property
    def step_t(self) -> Any:
        """(Δt of the drift [s], Δt of the kick [s], α of the retention [-], ω² of contact [1/s²]) of a substep."""
        return wp.types.vector(4, self.real)

    def made(self, make: Callable[["Variant"], SimpleNamespace]) -> SimpleNamespace:
        """``make(self)``, made once, by one thread at a time."""
        with LOCK:
            key = (make, self)
            if key not in _made:
                _made[key] = make(self)
            return _made[key]
