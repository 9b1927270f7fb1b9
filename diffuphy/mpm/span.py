"""The time and the block of nodes of one frame."""

from dataclasses import dataclass

import numpy as np

from diffuphy.mpm.boundary.layout import STIFFNESS
from diffuphy.mpm.grid import Grid


@dataclass(frozen=True)
class Span:
    """The time and the block of nodes of one frame."""

    grid: Grid
    start: float
    """Time at the beginning [s]."""
    dt: float
    """Length of a substep Δt [s]."""
    n_sub: int
    """Number of substeps."""
    wave: float = 0.0
    """Fastest wave c at rest [m/s]: retention and contact go by the time that it takes through a cell."""
    retain: float = 0.0
    """Time constant τ of the retention [Δx/c]; 0 for none."""
    half_kick: bool = False
    """Whether the first kick is half as long, and one more of that length ends the frame."""

    @property
    def end(self) -> float:
        """Time at the end [s]."""
        return self.start + self.n_sub * self.dt

    @property
    def steps(self) -> int:
        """Number of rounds between particles and grid."""
        return self.n_sub + int(self.half_kick)

    @property
    def alpha(self) -> float:
        """Share that a round retains, α = 1 − Δt/τ, at least 0 [-].

        A motion of which the grid misses the share ε loses (1 − α) ε in a round, hence ε/τ in a second whatever Δt is;
        exp(−Δt/τ) would lose 0.69 of that at Δt = 0.8 τ. In τ < Δt nothing is kept, as in APIC.
        """
        if self.retain == 0.0:
            return 0.0
        return max(0.0, 1.0 - self.dt * self.wave / (self.retain * self.grid.dx))

    @property
    def omega2(self) -> float:
        """Square of the frequency of elastic contact, ω² = STIFFNESS c²/Δx² [1/s²]."""
        return STIFFNESS * (self.wave / self.grid.dx) ** 2

    def wave_bar(self, alpha_bar: float, omega_bar: float) -> float:
        """Gradient in c of a loss with those in α and in ω²."""
        alpha = -self.dt / (self.retain * self.grid.dx) * alpha_bar if self.alpha > 0.0 else 0.0
        return alpha + 2.0 * STIFFNESS * self.wave / self.grid.dx**2 * omega_bar

    def table(self) -> np.ndarray:
        """Drift Δt [s], kick Δt [s], α and ω² of each round, shape (steps, 4)."""
        out = np.zeros((self.steps, 4))
        out[:] = self.dt, self.dt, self.alpha, self.omega2
        if self.half_kick:
            out[0, 1] = 0.5 * self.dt
            out[-1, :3] = 0.0, 0.5 * self.dt, 1.0
        return out
