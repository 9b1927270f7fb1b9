"""One material: what a word means to the simulator, and what a fit may find instead."""

from dataclasses import dataclass

import torch

from . import moduli
from .elastic import ELASTIC
from .expert import Param
from .plastic import PLASTIC


@dataclass(frozen=True)
class Preset:
    """What a word means: laws, parameters, and what a fit may choose instead."""

    word: str
    """The material word."""
    E: float
    """Young's modulus [Pa]."""
    nu: float
    """Poisson's ratio [-]."""
    rho: float
    """Density [kg/m³]."""
    elastic: str = "fixed_corotated"
    """Elastic law; fixed corotated because it stays stable in strong compression at little cost."""
    plastic: str = "identity"
    """Plastic law."""
    yield_stress: float = 1e3
    """Uniaxial yield stress [Pa]."""
    friction_angle: float = 30.0
    """Internal friction angle [deg]."""
    cohesion: float = 0.0
    """Volumetric strain per axis that a granular material bears in tension [-]."""
    viscosity: float = 10.0
    """True shear viscosity [Pa s]."""
    candidates_elastic: tuple[str, ...] = ()
    """Elastic laws a fit may choose among, its own first; empty = its own alone (films rarely tell them apart)."""
    candidates_plastic: tuple[str, ...] = ()
    """Plastic laws a fit may choose among, its own first; empty = its own alone."""

    def __post_init__(self) -> None:
        for name, registry in ((self.elastic, ELASTIC), (self.plastic, PLASTIC)):
            if name not in registry:
                raise ValueError(f"{self.word}: unknown law {name!r}; known: {', '.join(registry)}")
        object.__setattr__(self, "candidates_elastic", self.candidates_elastic or (self.elastic,))
        object.__setattr__(self, "candidates_plastic", self.candidates_plastic or (self.plastic,))
        for own, names in ((self.elastic, self.candidates_elastic), (self.plastic, self.candidates_plastic)):
            if names[0] != own:
                raise ValueError(f"{self.word}: its own law {own!r} must come first among the candidates, got {names}")
        moduli.check({"E": torch.tensor(self.E), "nu": torch.tensor(self.nu)})
        if not self.rho > 0.0:
            raise ValueError(f"{self.word}: rho must be positive [kg/m³], got {self.rho:g}")
        for p in self.params:
            if not p.lo <= (got := getattr(self, p.name)) <= p.hi:
                raise ValueError(f"{self.word}: {p.name} must be in [{p.lo:g}, {p.hi:g}] {p.unit}, got {got:g}")

    @property
    def params(self) -> tuple[Param, ...]:
        """Parameters its two laws read."""
        own = {p.name: p for p in (*ELASTIC[self.elastic].params, *PLASTIC[self.plastic].params)}
        return tuple(own.values())

    @property
    def theta(self) -> dict[str, float]:
        """The values of those parameters by name [SI]."""
        return {p.name: getattr(self, p.name) for p in self.params}
