"""A mixture of constitutive laws as two Warp functions: stress with return map, and their closed-form adjoint.

Every law lives in the principal frame of the trial deformation F = U S Vᵀ, e = ln S, ê = dev e, so *one* decomposition
serves any number of laws:

    return map   ln z = e + b − a ê,   (a, b) = Σ_c w_c^p (a_c, b_c)        (k = 1 − a, m = tr e/3 + b)
    stress       T = Σ_c w_c^e T^c(z),   τ = U diag(T) Uᵀ,   Fe = U diag(z) Vᵀ

The gates w^p act as given; the identity takes what the others leave. With B = F V = U S nothing else is needed:
τ = B diag(T/s²) Bᵀ and Fe − F = B diag(z/s − 1) Vᵀ, so a particle that does not flow keeps its F to the last bit.

A deformation goes in twice, as F and as H = F − I: H has the digits of strains far below 1, F those of stretches far
below 1. Stress, energy and flow are right to the digits of both (:mod:`.linalg`, :mod:`.near_one`).

Adjoint: with G = Uᵀ sym(τ̄) U and H = Uᵀ F̄e V the gradient is F̄ = U X Vᵀ; diagonal by the chain rule in e, off the
diagonal by divided differences that are smooth at equal stretches,

    X_ij = p (H_ij + H_ji)/2 + m (H_ij − H_ji)/2 + 2 q s_j G_ij
    p = (z_i − z_j)/(s_i − s_j),  m = (z_i + z_j)/(s_i + s_j),  q = (T_i − T_j)/(s_i² − s_j²) = p d/(s_i + s_j)

and never by the adjoint of a singular value decomposition, which does not exist at F = I. Laws that have a direct form
τ(F) and no plasticity are summed without any decomposition. Kernels hold exactly the laws that were asked for.

What a law remembers (``expert.MEMORY``) comes in as the vector h and goes out as h'; without such a law neither exists.
Viscous branches stand beside the mixture, each with a deformation of its own (:mod:`.branch`).

Where det F ≤ 0 no state of the material exists: the functions answer NaN, and ``Mixture.valid`` tells where.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import torch
import warp as wp
from torch import Tensor

from . import principal, sums, volume, wave
from .branch import BRANCHES, BranchFunctions
from .elastic import ELASTIC
from .expert import MEMORY, ElasticFunctions, Layout
from .plastic import PLASTIC


@dataclass(frozen=True)
class Mixture:
    """Warp types and functions of one set of laws at one precision; made by :func:`make_mixture`."""

    laws_e: tuple[str, ...]
    """Names of the elastic laws, columns of w_e."""
    laws_p: tuple[str, ...]
    """Names of the plastic laws, columns of w_p."""
    params: tuple[str, ...]
    """Names of the parameters, in the order of θ."""
    decomposes: bool
    """False if every law has a direct form: then no principal frame is computed."""
    plastic: bool
    """False if nothing can flow: then Fe is F_trial itself."""
    memory: tuple[str, ...]
    """What some law remembers, in the order of h; if nothing, h is no argument below."""
    branches: tuple[str, ...]
    """Viscous branches beside the elastic laws, at most "maxwell"."""
    real: Any
    vec3: Any
    mat33: Any
    w_e_t: Any
    """Vector type of the elastic weights, length max(1, Ke)."""
    w_p_t: Any
    """Vector type of the plastic weights, length max(1, Kp)."""
    theta_t: Any
    """Vector type of θ."""
    memory_t: Any
    """Vector type of h, length max(1, len(memory))."""
    stress: Any
    """(F_trial, H_trial, w_e, w_p, θ, dt[, h]) → (τ [Pa], Fe − F_trial[, h'])."""
    stress_adjoint: Any
    """(F_trial, H_trial, w_e, w_p, θ, dt, τ̄, F̄e[, h, h̄']) → (F̄_trial, w̄_e, w̄_p, θ̄[, h̄]); τ̄ may be any."""
    energy: Any
    """(Fe, He, w_e, θ) → ψ [Pa], energy per unit rest volume; without the branches."""
    wave: Any
    """(Fe, He, w_e, θ) → ρ_0 c² [Pa] of the fastest wave in this state, branches included as stiff as at rest."""
    valid: Any
    """(F) → bool: finite and det F > 0 in whatever frame; one determinant, cheap enough for every substep."""
    branch: BranchFunctions | None
    """Functions of the viscous branch."""

    @property
    def branch_stress(self) -> Any:
        """(F_N, H_N, θ, dt) → (τ_N [Pa], Fe_N − F_N); F_N: trial deformation of the branch."""
        return None if self.branch is None else self.branch.stress

    @property
    def branch_stress_adjoint(self) -> Any:
        """(F_N, H_N, θ, dt, τ̄, F̄e_N) → (F̄_N, θ̄)."""
        return None if self.branch is None else self.branch.stress_adjoint

    @property
    def branch_energy(self) -> Any:
        """(Fe_N, He_N, θ) → ψ_N [Pa]."""
        return None if self.branch is None else self.branch.energy

    @property
    def Ke(self) -> int:
        return len(self.laws_e)

    @property
    def Kp(self) -> int:
        return len(self.laws_p)

    @property
    def is_plastic(self) -> bool:
        return self.plastic


def _known(names: tuple[str, ...], registry: dict[str, Any], kind: str) -> tuple[Any, ...]:
    if unknown := [n for n in names if n not in registry]:
        raise ValueError(f"unknown {kind} law {unknown[0]!r}; known: {', '.join(registry)}")
    if len(set(names)) != len(names):
        raise ValueError(f"{kind} laws must differ, got {names}")
    return tuple(registry[n] for n in names)


@cache
def make_mixture(
    elastic: tuple[str, ...],
    plastic: tuple[str, ...] = ("identity",),
    real: Any = wp.float32,
    branches: tuple[str, ...] = (),
) -> Mixture:
    """Build the functions of a mixture, specialised on its laws.

    Args:
        elastic: names in ``ELASTIC``, at least one; order = columns of w_e. A single law ignores w_e.
        plastic: names in ``PLASTIC``; order = columns of w_p; empty = identity. A single law ignores w_p.
        real: ``wp.float32`` or ``wp.float64``.
        branches: names in ``BRANCHES``.

    Raises:
        ValueError: no elastic law, an unknown name, or one given twice.
    """
    if not elastic:
        raise ValueError(f"a mixture needs at least one elastic law; known: {', '.join(ELASTIC)}")
    laws_e, laws_p = _known(elastic, ELASTIC, "elastic"), _known(plastic, PLASTIC, "plastic")
    beside = _known(branches, BRANCHES, "branch")
    is_plastic = any(not law.is_identity for law in laws_p)
    memory = tuple(m for m in MEMORY if any(m in law.memory for law in laws_p))
    params = tuple(dict.fromkeys(p.name for law in (*laws_e, *laws_p, *beside) for p in law.params))
    layout = Layout(real, params, memory)
    w_e_t, w_p_t = (wp.types.vector(max(1, len(k)), real) for k in (elastic, plastic))
    decomposes = is_plastic or not all(law.is_direct for law in laws_e)
    fe = tuple(law.build(layout) for law in laws_e)
    total = sums.sum_elastic(layout, fe, w_e_t)
    if is_plastic:
        flows = sums.sum_plastic(layout, [(law.build(layout), bool(law.memory)) for law in laws_p], w_p_t)
        made = principal.elastoplastic(layout, total, flows, w_e_t, w_p_t)
        stress, adjoint = made[2:] if memory else made[:2]
    elif decomposes:
        stress, adjoint = principal.elastic(layout, total, w_e_t, w_p_t)
    else:
        stress, adjoint = _direct(layout, fe, w_e_t, w_p_t)
    branch = beside[0].build(layout) if beside else None
    return Mixture(
        elastic, plastic, params, decomposes, is_plastic, memory, branches, real,
        layout.vec3, layout.mat33, w_e_t, w_p_t, layout.theta_t, layout.memory_t,
        stress, adjoint, principal.energy(layout, total, w_e_t), wave.build(layout, total, w_e_t, branch),
        volume.build(real).valid, branch,
    )  # fmt: skip


def _direct(layout: Layout, laws: tuple[ElasticFunctions, ...], w_e_t: Any, w_p_t: Any) -> tuple[Any, Any]:
    """Stress and adjoint of laws that need no principal frame."""
    real, mat33, theta_t = layout.real, layout.mat33, layout.theta_t
    tau_of, tau_adjoint = sums.sum_direct(layout, laws, w_e_t)

    @wp.func(module="unique")
    def stress(F: mat33, H: mat33, w_e: w_e_t, w_p: w_p_t, theta: theta_t, dt: real):
        return tau_of(F, H, w_e, theta), mat33()

    @wp.func(module="unique")
    def stress_adjoint(
        F: mat33, H: mat33, w_e: w_e_t, w_p: w_p_t, theta: theta_t, dt: real, tau_bar: mat33, Fe_bar: mat33
    ):  # fmt: skip
        F_bar, w_e_bar, theta_bar = tau_adjoint(F, H, w_e, theta, tau_bar)
        return Fe_bar + F_bar, w_e_bar, w_p_t(), theta_bar

    return stress, stress_adjoint


def wave_speed(
    elastic: tuple[str, ...],
    w_e: Tensor,
    theta: dict[str, Tensor],
    rho: Tensor,
    branches: tuple[str, ...] = (),
) -> Tensor:
    """Fastest small-strain wave of a mixture at rest, c = √(Σ_c w_c c_c² + Σ_N M_N/ρ) [m/s], shape (N,).

    Exact for elastic mixtures (stresses add, so moduli add) and an upper bound once something flows: no return map here
    stiffens. Viscous laws are integrated implicitly and put no bound of their own on the time step; a branch counts
    with its stiffness before it relaxes. ``Mixture.wave`` is the same of a deformed state.

    Args:
        w_e: weights, shape (N, Ke); a single law counts as weight 1.
        theta: parameters by name, each of shape (N,).
        rho: density, shape (N,) [kg/m³].
    """
    laws = _known(elastic, ELASTIC, "elastic")
    beside = _known(branches, BRANCHES, "branch")
    if len(laws) == 1 and not beside:
        return laws[0].wave_speed(theta, rho)
    c2 = torch.stack([law.wave_speed(theta, rho) ** 2 for law in laws], dim=-1)
    c2 = c2[..., 0] if len(laws) == 1 else (w_e * c2).sum(-1)
    return torch.sqrt(c2 + sum(b.stiffness(theta) for b in beside) / rho)


def rate_gate(w_p: Tensor, plastic: tuple[str, ...], dt: float, dt_ref: float) -> Tensor:
    """Plastic gates whose effect per unit of time does not depend on the time step.

        g_c = 1 − (1 − w_c)^(dt/dt_ref) for every law that flows; the identity takes the rest

    A gate of weight w that acts once per substep acts dt_ref/dt times as often when dt shrinks; in this form strain is
    shed by the same factor over dt_ref whatever dt. One-hot weights are unchanged (at w = 1, where the derivative of
    the formula is infinite, the gate is w itself). For dt ≤ dt_ref no gate exceeds w, so the rest is never negative.

    Args:
        w_p: weights on the simplex, shape (N, Kp).
        plastic: names of the columns.
        dt: substep [s].
        dt_ref: the time over which w is meant [s], at least dt.

    Raises:
        ValueError: not 0 < dt ≤ dt_ref, or partial weights without an identity column to take the rest.
    """
    if not 0.0 < dt <= dt_ref:
        raise ValueError(f"need 0 < dt <= dt_ref, got dt = {dt:g} s, dt_ref = {dt_ref:g} s; raise dt_ref or lower dt")
    if len(plastic) <= 1:
        return w_p
    if "identity" not in plastic:
        raise ValueError(f"rate gates need an 'identity' column to take what the others leave, got {plastic}")
    at = plastic.index("identity")
    partial = w_p < 1.0
    gate = torch.where(partial, -torch.expm1(dt / dt_ref * torch.log1p(-torch.where(partial, w_p, 0.0))), w_p)
    rest = 1.0 - gate.sum(-1) + gate[..., at]
    columns = [rest if c == at else gate[..., c] for c in range(len(plastic))]
    return torch.stack(columns, dim=-1)
