"""What one frame took."""

import dataclasses
from dataclasses import dataclass

from torch import Tensor

from diffuphy.mpm.diagnostics import Balance
from diffuphy.mpm.grid import Grid


@dataclass(frozen=True)
class FrameReport:
    """What one frame took."""

    n_sub: int
    """Substeps."""
    dt: float
    """Length of one [s]."""
    wave: float
    """Fastest wave c at rest [m/s]."""
    speed: float
    """Bound V on the speed of a particle [m/s]."""
    grid: Grid
    """Block of nodes."""
    reruns: int
    """How often it was enlarged because particles left it."""
    halvings: int = 0
    """How often the substep was halved because waves became too fast for it."""
    active: int | None = None
    """Nodes of the block that were worked on; None: all of them."""
    gone: int = 0
    """Particles that have left the bounds of the scene since the beginning."""
    removed: float = 0.0
    """Mass that has left with them [kg]; 0 where they are frozen."""
    balance: Balance | None = dataclasses.field(default=None, repr=False, compare=False)
    """Mass, momenta, energies and extremes at the end of the frame, with ``diagnose=True``."""
    expected_dv: Tensor | None = dataclasses.field(default=None, repr=False, compare=False)
    """Velocity change of each particle by stress and gravity, shape (N, 3) [m/s], if gathered; see ``mpm.gather``."""
    impulse: Tensor | None = dataclasses.field(default=None, repr=False, compare=False)
    """Impulse of all walls on the body, shape (3,) [N s], if gathered."""
