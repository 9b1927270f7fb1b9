"""Particles that leave the bounds of a scene: an error, or they stay behind.

Looked at once a frame. Who has left is no longer handed to the solver, which then works on fewer particles; nothing of
this is compiled into a kernel, and a scene without bounds has none of it.
"""

import dataclasses
from dataclasses import dataclass, field

import torch
from torch import Tensor

from diffuphy.mpm.scene import Scene
from diffuphy.mpm.state import Matter, State
from diffuphy.types import SimulationDiverged


@dataclass
class Members:
    """The particles that still take part."""

    scene: Scene
    """Its bounds and what happens to those who leave them."""
    rows: Tensor | None = None
    """Indices of those who take part, None: all."""
    removed: float = 0.0
    """Mass of those who were removed [kg]."""
    count: int = field(default=0)
    """How many have left."""

    def of(self, t: Tensor | None) -> Tensor | None:
        """Rows of those who take part."""
        return t if t is None or self.rows is None else t[self.rows]

    def state(self, whole: State) -> State:
        """The state of those who take part."""
        if self.rows is None:
            return whole
        return State(*(self.of(t) for t in whole.tensors()), whole.time)  # type: ignore[arg-type]

    def matter(self, whole: Matter) -> Matter:
        """The matter of those who take part."""
        if self.rows is None:
            return whole
        return Matter(*(self.of(t) for t in whole.tensors()), self.of(whole.tag))  # type: ignore[arg-type]

    def joined(self, part: State, before: State) -> State:
        """``part`` in the places of those who take part, the others as ``before``."""
        if self.rows is None:
            return part
        rows = self.rows
        both = zip(before.tensors(), part.tensors(), strict=True)
        return State(*(None if a is None or b is None else a.index_copy(0, rows, b) for a, b in both), part.time)  # type: ignore[arg-type]

    def spread(self, t: Tensor | None, n: int) -> Tensor | None:
        """A sum over those who take part as one over all ``n``, zero for the others."""
        if t is None or self.rows is None:
            return t
        return t.new_zeros(n, *t.shape[1:]).index_copy(0, self.rows, t)

    def watch(self, state: State, m: Tensor, frame: int) -> tuple[State, bool]:
        """The state in which those who have left since the last call are at rest where they are, and whether there were
        any.

        Raises:
            SimulationDiverged: the scene has it so; naming the first of them, and where it is.
        """
        if self.scene.bounds is None:
            return state, False
        low, high = (state.x.new_tensor(corner) for corner in self.scene.bounds)
        inside = ((state.x.detach() >= low) & (state.x.detach() <= high)).all(1)
        new = ~inside
        if self.rows is not None:
            new = torch.zeros_like(new).index_fill(0, self.rows, True) & new
        if not bool(new.any()):
            return state, False
        if self.scene.leaving == "error":
            p = int(new.nonzero()[0])
            raise SimulationDiverged(
                f"particle {p} ({int(new.sum())} in all) left the bounds of the scene in frame {frame}, at "
                f"t = {state.time:.6g} s: x = {_text(state.x[p])} m, |v| = {float(state.v[p].norm()):.3g} m/s, bounds "
                f"{_text(self.scene.bounds[0])} … {_text(self.scene.bounds[1])} m; enlarge bounds, or set leaving to "
                "'freeze' or 'remove'"
            )
        takes_part = torch.ones_like(new) if self.rows is None else torch.zeros_like(new).index_fill(0, self.rows, True)
        self.rows = (takes_part & inside).nonzero()[:, 0]
        self.count += int(new.sum())
        if self.scene.leaving == "remove":
            self.removed += float(m.detach()[new].double().sum())
        v = torch.where(new[:, None], torch.zeros_like(state.v), state.v)
        C = torch.where(new[:, None, None], torch.zeros_like(state.C), state.C)
        return dataclasses.replace(state, v=v, C=C), True


def _text(x: Tensor | tuple[float, ...]) -> str:
    return "(" + ", ".join(f"{float(a):.4g}" for a in x) + ")"
