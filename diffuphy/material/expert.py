"""What a constitutive law is: one small file that gives one of the two records below.

All laws are isotropic and written in the principal frame of F = U S Vᵀ: principal stretches s_i > 0, Hencky strains
e_i = ln s_i, deviator ê_i = e_i − tr e / 3. Parameters are shared *by name* among laws: a particle has one "E",
whatever it is made of. A law is built once for every combination of precision and parameter layout, so that its Warp
functions read their parameters at fixed places and nothing is looked up at run time.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import torch
import warp as wp

MEMORY = ("log_J", "slip", "heat")
"""What a particle may remember, in the order of the memory vector h; only what some law reads is kept.

log_J: ln det of the total deformation [-]; the solver adds ln det(I + Δt C) of each step.
slip: accumulated equivalent plastic strain [-], slip' = slip + √(2/3) a |ê|; the mixture adds it.
heat: progress of melting [-], heat' = heat + Δt/melt_time; the mixture adds it.
"""


@dataclass(frozen=True)
class Param:
    """A material parameter and the range a fit may search."""

    name: str
    """Key in ``MaterialField.theta``; laws that use the same name share the value."""
    unit: str
    """SI unit ("-" when dimensionless)."""
    lo: float
    """Least value that is allowed."""
    hi: float
    """Largest value that is allowed."""
    log: bool
    """Whether the range is searched in the logarithm (moduli span decades)."""
    default: float
    """Value of a particle of which nothing is known."""

    def __post_init__(self) -> None:
        if not self.lo <= self.default <= self.hi or self.lo >= self.hi:
            got = f"lo = {self.lo:g}, default = {self.default:g}, hi = {self.hi:g}"
            raise ValueError(f"{self.name}: need lo <= default <= hi and lo < hi, got {got}")
        if self.log and self.lo <= 0.0:
            raise ValueError(f"{self.name}: a logarithmic range needs lo > 0, got {self.lo}")


@dataclass(frozen=True)
class Layout:
    """Precision of the kernels and the place of every parameter in the vector θ."""

    real: Any
    """``wp.float32`` or ``wp.float64``."""
    params: tuple[str, ...]
    """Names of the parameters, in the order of θ."""
    memory: tuple[str, ...] = ()
    """Names of what is remembered, in the order of h; a part of ``MEMORY``."""
    aliases: tuple[tuple[str, str], ...] = ()
    """Pairs (name a law asks for, name of the parameter it gets): one law may serve twice with other parameters."""

    @cached_property
    def vec3(self) -> Any:
        return wp.types.vector(3, self.real)

    @cached_property
    def mat33(self) -> Any:
        return wp.types.matrix((3, 3), self.real)

    @cached_property
    def theta_t(self) -> Any:
        return wp.types.vector(max(1, len(self.params)), self.real)

    @cached_property
    def memory_t(self) -> Any:
        return wp.types.vector(max(1, len(self.memory)), self.real)

    def at(self, name: str) -> int:
        """Index of a parameter in θ."""
        return self.params.index(dict(self.aliases).get(name, name))

    def remembers(self, name: str) -> int:
        """Index in h of something that is remembered."""
        return self.memory.index(name)

    def renamed(self, **aliases: str) -> "Layout":
        """The same layout for a law that is to read other parameters than those it asks for."""
        return replace(self, aliases=tuple(aliases.items()))


@dataclass(frozen=True)
class ElasticFunctions:
    """Warp functions of one elastic law, each to the digits of the strain however small that is.

    s, d, e: principal stretches, d_i = s_i − 1 and e_i = ln s_i, which have digits that s has not; F, H = F − I
    likewise; θ as laid out.
    """

    energy: Any
    """(s, d, e, θ) → ψ [Pa], energy per unit rest volume."""
    stress: Any
    """(s, d, e, θ) → T (3,) [Pa], principal Kirchhoff stresses T_i = ∂ψ/∂e_i."""
    stress_adjoint: Any
    """(s, d, e, θ, T̄) → (ē, θ̄) with ē_j = Σ_i T̄_i ∂T_i/∂e_j."""
    slope: Any
    """(s, d, e, θ) → (d_12, d_20, d_01), divided differences d_ij = (T_i − T_j)/(s_i − s_j), smooth at s_i = s_j."""
    direct: Any = None
    """(F, H, θ) → τ (3, 3) [Pa] without a decomposition; None if the law has no such form."""
    direct_adjoint: Any = None
    """(F, H, θ, τ̄) → (F̄, θ̄); τ̄ need not be symmetric."""


@dataclass(frozen=True)
class PlasticFunctions:
    """Warp functions of one plastic law; n = |ê|, tr = Σ e_i of the trial state.

    A return map keeps the principal frame and is given by two scalars: ln z_i = m + k ê_i. They are written as what
    flows, a = 1 − k and b = m − tr/3, so that a state that does not flow has a = b = 0 *exactly*. A law with memory
    also reads the vector h of what the particle remembers, as the last argument, at ``layout.remembers(name)``.
    """

    flow: Any
    """(n, tr, θ, dt) → (a, b), with memory (n, tr, θ, dt, h) → (a, b)."""
    flow_adjoint: Any
    """(n, tr, θ, dt, ā, b̄) → (n̄, t̄r, θ̄), with memory (n, tr, θ, dt, ā, b̄, h) → (n̄, t̄r, θ̄, h̄)."""


@dataclass(frozen=True)
class Elastic:
    """An elastic law: stored energy ψ(s), principal Kirchhoff stress T, and how fast its waves run."""

    name: str
    """Key in the registry and in ``MaterialField.elastic``."""
    params: tuple[Param, ...]
    """Parameters the law reads."""
    build: Callable[[Layout], ElasticFunctions]
    """Warp functions for one layout."""
    wave_speed: Callable[[dict[str, torch.Tensor], torch.Tensor], torch.Tensor]
    """(θ by name, ρ) → c [m/s], the fastest small-strain wave at rest; sets the time step."""
    energy: Callable[[torch.Tensor, dict[str, torch.Tensor]], torch.Tensor]
    """Torch reference: (e (..., 3), θ by name) → ψ (...,) [Pa]."""
    stress: Callable[[torch.Tensor, dict[str, torch.Tensor]], torch.Tensor]
    """Torch reference: (e (..., 3), θ by name) → T (..., 3) [Pa]."""
    is_direct: bool = False
    """Whether the built functions have a form without a decomposition."""


@dataclass(frozen=True)
class Plastic:
    """A plastic law: a return map on the Hencky strains."""

    name: str
    """Key in the registry and in ``MaterialField.plastic``."""
    params: tuple[Param, ...]
    """Parameters the law reads."""
    build: Callable[[Layout], PlasticFunctions]
    """Warp functions for one layout."""
    flow: Callable[..., tuple[torch.Tensor, torch.Tensor]]
    """Torch reference: (n, tr, θ by name, dt) → (a, b), with memory (n, tr, θ by name, dt, h by name) → (a, b)."""
    is_identity: bool = False
    """True only for the map that changes nothing."""
    memory: tuple[str, ...] = ()
    """What the law reads of ``MEMORY``; only a simulation with such a law keeps it."""

    def __post_init__(self) -> None:
        if unknown := [m for m in self.memory if m not in MEMORY]:
            raise ValueError(f"{self.name}: unknown memory {unknown[0]!r}; known: {', '.join(MEMORY)}")
