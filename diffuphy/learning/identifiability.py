"""What a clip can tell of its material: Fisher information, standard errors, and sentences about what it cannot tell.

    I_ab = 1/σ² Σ_i ∂c_i/∂q_a ∂c_i/∂q_b,   var q̂ ≥ I⁻¹

for pixels c_i with independent noise of standard deviation σ (Cramér 1946; Rao 1945), q the coordinates of
``decoder.coordinate``: log10 of what spans decades, the rest over its range. The clip is linear in q to first order,
so I is also the Gauss–Newton Hessian of the squared error. A bound: errors of the simulation come on top of it.
"""

import dataclasses
import itertools
import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from diffuphy.learning.case import Case
from diffuphy.learning.probe import Bench
from diffuphy.material import Param
from diffuphy.material.decoder import coordinate
from diffuphy.material.field import prune
from diffuphy.mpm import FrameReport
from diffuphy.types import MaterialField, SimulationDiverged

log = logging.getLogger(__name__)

STEP = 0.02
"""Half-width of the central difference in a coordinate: far above what rounding does to a clip, far below a decade."""

UNSEEN = 1.0
"""Standard error from which a combination of parameters is not seen: a decade, or a whole range."""


RHO_UNSEEN = (
    "material.learn cannot have 'rho': a drop shows E/rho, yield_stress/rho and viscosity/rho alone, so that all of "
    "them times ten make the same clip; state the density with material.override.rho and learn the others"
)
"""Why density is never learnt."""

RHO = Param("rho", "kg/m³", 1e1, 1e5, log=True, default=1e3)
"""Density as a parameter of ``fisher``; never learnt: a fall depends on E/ρ, σ_Y/ρ and η/ρ alone."""


def sensitivity(clip: Callable[[Tensor], Tensor], q: Tensor, step: float = STEP) -> Tensor:
    """∂c/∂q by central differences, error O(step²), shape (D, P).

    Args:
        clip: (P,) → any shape, D numbers.
        q: where, shape (P,).
    """
    columns = []
    for a in range(len(q)):
        up, down = (clip(q + s * step * torch.eye(len(q), dtype=q.dtype)[a]) for s in (1, -1))
        columns.append(((up - down) / (2 * step)).flatten())
    return torch.stack(columns, 1)


@dataclass(frozen=True)
class Fisher:
    """Fisher information of a clip in the coordinates of its parameters."""

    names: tuple[str, ...]
    """What each coordinate is."""
    information: Tensor
    """I, shape (P, P), float64."""

    @classmethod
    def of(cls, names: Sequence[str], sensitivity: Tensor, noise: float) -> "Fisher":
        """From ∂c/∂q, shape (D, P), and the standard deviation of the noise of each of the D numbers."""
        if not noise > 0:
            raise ValueError(f"noise must be a positive standard deviation, got {noise}")
        J = sensitivity.double()
        return cls(tuple(names), J.T @ J / noise**2)

    @property
    def spectrum(self) -> tuple[Tensor, Tensor]:
        """Eigenvalues, ascending, shape (P,), and eigenvectors as columns, shape (P, P)."""
        values, vectors = torch.linalg.eigh(self.information)
        rounding = self.information.diagonal().max() * len(values) * torch.finfo(torch.float64).eps
        return torch.where(values > rounding, values, 0.0), vectors

    @property
    def condition(self) -> float:
        """Largest over smallest eigenvalue; infinite if something is not seen at all."""
        values, _ = self.spectrum
        return float(values[-1] / values[0]) if values[0] > 0 else math.inf

    @property
    def errors(self) -> Tensor:
        """Least standard error of each coordinate when all are sought, (I⁻¹)_aa^½, shape (P,); infinite for what takes
        part in a direction that is not seen."""
        values, vectors = self.spectrum
        share = vectors.square()
        each = torch.where(share > 1e-12, share / values, 0.0)  # x/0 = ∞
        return each.sum(1).sqrt()

    @property
    def alone(self) -> Tensor:
        """Least standard error of each coordinate if all others were known, I_aa^−½, shape (P,)."""
        return self.information.diagonal().rsqrt()

    def remarks(self) -> list[str]:
        """A sentence for each direction that the clip does not show."""
        said = []
        values, vectors = self.spectrum
        for value, v in zip(values.tolist(), vectors.T, strict=True):
            if value > UNSEEN**-2:
                continue
            part = [a for a in range(len(v)) if abs(float(v[a])) > 0.3]
            if len(part) == 1:
                said.append(f"the clip does not show {self.names[part[0]]}: learn it from another motion, or state it")
            else:
                together = " and ".join(self.names[a] for a in part)
                said.append(f"the clip shows {together} only in combination: state one of them")
        return said


def fisher(
    film: Callable[[MaterialField], Tensor], field: MaterialField, params: Sequence[Param], labels: Tensor, noise: float
) -> Fisher:
    """Fisher information of a clip in the parameters of its regions: two clips a parameter and region.

    Args:
        film: the clip of a material, any shape.
        field: where; its laws stay.
        params: which parameters, with their scales; ``RHO`` is the density.
        labels: region of each particle, shape (N,), int64.
        noise: standard deviation of a pixel [-].
    """
    regions = int(labels.max()) + 1
    which = [(p, r) for p in params for r in range(regions)]

    def clip(q: Tensor) -> Tensor:
        values = {**field.theta, "rho": field.rho}
        for (p, r), shift in zip(which, q.tolist(), strict=True):
            values[p.name] = torch.where(labels == r, moved(p, values[p.name], shift), values[p.name])
        rho = values.pop("rho")
        return film(dataclasses.replace(field, theta=values, rho=rho))

    names = [p.name if regions == 1 else f"{p.name} of region {r}" for p, r in which]
    return Fisher.of(names, sensitivity(clip, torch.zeros(len(which), dtype=torch.float64)), noise)


def moved(p: Param, value: Tensor, shift: float) -> Tensor:
    """A parameter shifted in its coordinate, see ``decoder.coordinate``."""
    return value * 10**shift if p.log else value + shift * (p.hi - p.lo)


def value_at(p: Param, q: float) -> float:
    """The parameter at a coordinate, the inverse of ``decoder.coordinate``."""
    return 10**q if p.log else p.lo + q * (p.hi - p.lo)


def coordinate_of(p: Param, value: float) -> float:
    """Coordinate of a parameter, see ``decoder.coordinate``."""
    return float(coordinate(p, torch.tensor(value, dtype=torch.float64)))


def stated(found: Fisher, params: Sequence[Param]) -> dict[str, float]:
    """Standard errors for a report: ``error_E`` in dex, ``error_nu`` in the parameter's own unit."""
    known, numbers = {p.name: p for p in params}, {}
    for name, error in zip(found.names, found.errors.tolist(), strict=True):
        p = known[name.split()[0]]
        numbers["error_" + name.replace(" of region ", "_")] = error if p.log else error * (p.hi - p.lo)
    return numbers | {"condition": found.condition}


def certainty(case: Case, field: MaterialField, params: Sequence[Param], noise: float) -> dict[str, float]:
    """How certain a material can be that was found from the clip of a drop; what the clip does not show is warned of.

    Args:
        field: the material of the draft particles, one-hot on its laws.
        params: what was learnt.
        noise: standard deviation of a pixel [-].

    Returns:
        Standard errors, the condition number of the Fisher information, and by ``differ_A_B`` the root mean square
        difference of the clips of candidate elastic laws A and B; nothing, with a warning, where a material beside the
        found one cannot be simulated.
    """
    try:
        film = steady_film(case.bench, field)
        found = fisher(film, field, params, case.labels, noise)
        laws = _laws_apart(film, field)
    except SimulationDiverged as trouble:
        log.warning("material: no certainty stated, a material beside the found one cannot be simulated: %s", trouble)
        return {}
    same = [f"the clip does not tell {a} from {b}: at small strain they are the same law"
            for (a, b), apart in laws.items() if apart < noise]  # fmt: skip
    for words in (*found.remarks(), *same):
        log.warning("material: %s", words)
    return stated(found, params) | {f"differ_{a}_{b}": apart for (a, b), apart in laws.items()}


def steady_film(bench: Bench, field: MaterialField) -> Callable[[MaterialField], Tensor]:
    """Clips of materials near ``field``, all with its time step: a number of substeps that changes is a jump in what
    is to be differentiated."""
    reports: list[FrameReport] = []
    with torch.no_grad():
        bench.simulate(prune(field).field, report=reports)
    dt = min(report.dt for report in reports)

    def film(other: MaterialField) -> Tensor:
        with torch.no_grad():
            return bench.film(bench.simulate(prune(other).field, dt=dt))

    return film


def _laws_apart(film: Callable[[MaterialField], Tensor], field: MaterialField) -> dict[tuple[str, str], float]:
    """Root mean square difference of the clips of each two elastic laws, if there are several."""
    rows = torch.eye(len(field.elastic)).to(field.w_e)
    pairs = list(itertools.combinations(range(len(rows)), 2))
    clips = [film(dataclasses.replace(field, w_e=row.expand_as(field.w_e).contiguous())) for row in rows if pairs]
    return {(field.elastic[a], field.elastic[b]): float((clips[a] - clips[b]).square().mean().sqrt()) for a, b in pairs}
