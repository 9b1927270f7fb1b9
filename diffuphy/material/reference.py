"""The laws in torch, one matrix at a time or in batches: what the Warp functions are tested against.

All functions take F of shape (..., 3, 3) with det F > 0 and parameters by name, each a float or of shape (...,). They
go through a decomposition F = U diag(exp e) Vᵀ: exact in value everywhere, however small the strain, not meant to be
differentiated at equal stretches.
"""

from collections.abc import Mapping
from typing import TypeVar

import torch
from torch import Tensor

from . import moduli
from .elastic import ELASTIC
from .expert import Elastic, Plastic
from .linalg import NEAR
from .plastic import PLASTIC

Law = TypeVar("Law", Elastic, Plastic)


def kirchhoff(F: Tensor, law: str, params: Mapping[str, float | Tensor]) -> Tensor:
    """Kirchhoff stress τ = P Fᵀ = U diag(T) Uᵀ [Pa], shape (..., 3, 3), of one elastic law.

    Raises:
        ValueError: unknown law, missing or impossible parameter, det F ≤ 0.
    """
    theta = check_law(law, ELASTIC, params, F)
    U, e, _ = decompose(F)
    return (U * ELASTIC[law].stress(e, theta)[..., None, :]) @ U.mT


def energy(F: Tensor, law: str, params: Mapping[str, float | Tensor]) -> Tensor:
    """Stored energy ψ per unit rest volume [Pa], shape (...,), of one elastic law. Raises as :func:`kirchhoff`."""
    theta = check_law(law, ELASTIC, params, F)
    return ELASTIC[law].energy(decompose(F)[1], theta)


def return_map(
    F: Tensor, law: str, params: Mapping[str, float | Tensor], dt: float = 0.0,
    memory: Mapping[str, Tensor] | None = None,
) -> Tensor:  # fmt: skip
    """Elastic deformation after the return map, Fe = U diag(z) Vᵀ with ln z = e + b − a ê, shape (..., 3, 3).

    Args:
        dt: time over which a viscous law flows [s].
        memory: what the law remembers (``expert.MEMORY``), each of shape (...,); what is missing is that of new matter:
            log_J that of F, slip and heat zero.

    Raises as :func:`kirchhoff`.
    """
    theta = check_law(law, PLASTIC, params, F)
    U, e, Vh = decompose(F)
    tr = e.sum(-1)
    dev = e - tr[..., None] / 3
    new = {"log_J": tr, "slip": torch.zeros_like(tr), "heat": torch.zeros_like(tr)}
    past = ({**new, **(memory or {})},) if PLASTIC[law].memory else ()
    a, b = PLASTIC[law].flow(dev.norm(dim=-1), tr, theta, dt, *past)
    grown = torch.exp(e) * torch.expm1(b[..., None] - a[..., None] * dev)
    return F + (U * grown[..., None, :]) @ Vh


def check_law(
    name: str, registry: Mapping[str, Law], params: Mapping[str, float | Tensor], F: Tensor
) -> dict[str, Tensor]:
    """The parameters of a law as tensors like F.

    Raises:
        ValueError: unknown law, missing or impossible parameter.
    """
    if name not in registry:
        raise ValueError(f"unknown law {name!r}; known: {', '.join(registry)}")
    law = registry[name]
    if missing := [p.name for p in law.params if p.name not in params]:
        raise ValueError(f"{name} needs {', '.join(p.name for p in law.params)}; {missing[0]!r} is missing")
    theta = {p.name: torch.as_tensor(params[p.name], dtype=F.dtype, device=F.device) for p in law.params}
    if "E" in theta:
        moduli.check(theta)
    return theta


def check_state(F: Tensor) -> None:
    """Raises:
    ValueError: det F ≤ 0 or not a number, for some F.
    """
    det = torch.linalg.det(F.detach())
    if not bool((det > 0).all()):
        raise ValueError(f"det F must be positive, got {float(det.min()):g}: such a state of matter does not exist")


def decompose(F: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """(U, e, Vᵀ) of F = U diag(exp e) Vᵀ, e in no order, of shapes (..., 3, 3), (..., 3), (..., 3, 3).

    Where E = FᵀF − I is small it is decomposed instead of F, with e = ½ ln(1 + λ): so e has the digits of F − I.

    Raises:
        ValueError: det F ≤ 0.
    """
    check_state(F)
    H = _less_one(F)
    E = H + H.mT + H.mT @ H
    near = (E * E).sum((-2, -1)) < NEAR
    value, V = torch.linalg.eigh(torch.where(near[..., None, None], E, torch.zeros_like(E)))
    small = torch.log1p(value) / 2
    U, s, Vh = torch.linalg.svd(F)
    e = torch.where(near[..., None], small, s.log())
    Q = torch.where(near[..., None, None], F @ V * torch.exp(-small)[..., None, :], U)
    return Q, e, torch.where(near[..., None, None], V.mT, Vh)


def log_det(F: Tensor) -> Tensor:
    """ln det F, shape (...,), to the digits of F − I where that is small."""
    H = _less_one(F)
    near = (H * H).sum((-2, -1)) < NEAR
    at = torch.where(near[..., None, None], H, torch.zeros_like(H))
    tr = at.diagonal(dim1=-2, dim2=-1).sum(-1)
    minors = (tr * tr - (at * at.mT).sum((-2, -1))) / 2
    return torch.where(near, torch.log1p(tr + minors + torch.linalg.det(at)), torch.linalg.det(F).log())


def _less_one(F: Tensor) -> Tensor:
    return F - torch.eye(3, dtype=F.dtype, device=F.device)
