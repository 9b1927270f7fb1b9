"""The laws at a material point, on torch tensors: what a user calls to look at a law, to plot it or to fit it.

    kirchhoff(F, law, params)            τ [Pa]
    energy(F, law, params)               ψ [Pa]
    return_map(F, law, params, dt)       Fe
    remember(F, law, params, dt)         what the law remembers after the step

The same Warp functions as in the simulation, in float32 and float64, on the device of F. Gradients in F, in every
parameter and in the memory are the closed forms of :mod:`.principal`, exact at F = I and at repeated stretches; they
are differentiable once. :mod:`.reference` has the same functions in plain torch.
"""

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import torch
import warp as wp
from torch import Tensor

from diffuphy.compiling import LOCK, load

from . import linalg
from .elastic import ELASTIC
from .expert import MEMORY
from .mixture import Mixture, make_mixture
from .plastic import PLASTIC
from .reference import check_law, check_state, decompose, log_det

REAL = {torch.float32: wp.float32, torch.float64: wp.float64}
Params = Mapping[str, float | Tensor]


def kirchhoff(F: Tensor, law: str, params: Params) -> Tensor:
    """Kirchhoff stress τ = P Fᵀ [Pa] of one elastic law, shape (..., 3, 3).

    Args:
        F: deformation gradients with det F > 0, shape (..., 3, 3), float32 or float64.
        law: name in ``ELASTIC``.
        params: its parameters by name (SI), each a float or of shape (...,).

    Raises:
        ValueError: unknown law, missing or impossible parameter, det F ≤ 0, or another precision.
    """
    _check(F)
    theta = check_law(law, ELASTIC, params, F)
    return _evaluate((law,), (), F, theta, {}, 0.0)[0]


def energy(F: Tensor, law: str, params: Params) -> Tensor:
    """Stored energy ψ per unit rest volume [Pa] of one elastic law, shape (...,). Arguments as :func:`kirchhoff`."""
    _check(F)
    theta = check_law(law, ELASTIC, params, F)
    return ELASTIC[law].energy(_Strains.apply(F), theta)


def return_map(
    F: Tensor, law: str, params: Params, dt: float = 0.0, memory: Mapping[str, Tensor] | None = None
) -> Tensor:
    """Elastic deformation after the flow of one plastic law, Fe = U diag(z) Vᵀ, ln z = e + b − a ê, shape (..., 3, 3).

    Args:
        F: trial elastic deformation gradients with det F > 0, shape (..., 3, 3), float32 or float64.
        law: name in ``PLASTIC``.
        params: its parameters by name (SI), each a float or of shape (...,).
        dt: time over which a viscous law flows [s].
        memory: what the law remembers before the step (``MEMORY``), each of shape (...,). What is missing is that of
            new matter: log_J that of F, slip and heat zero.

    Raises as :func:`kirchhoff`.
    """
    return _flow(F, law, params, dt, memory)[1]


def remember(
    F: Tensor, law: str, params: Params, dt: float = 0.0, memory: Mapping[str, Tensor] | None = None
) -> dict[str, Tensor]:
    """What the law remembers after the step of :func:`return_map`, by name, each of shape (...,); {} of most laws.

    log_J is as it came in: the deformation of a step is added by who deforms.
    """
    found = _flow(F, law, params, dt, memory)[2]
    names = [m for m in MEMORY if m in PLASTIC[law].memory] if law in PLASTIC else []
    return {name: found[..., i] for i, name in enumerate(names)}


def _flow(
    F: Tensor, law: str, params: Params, dt: float, memory: Mapping[str, Tensor] | None
) -> tuple[Tensor, Tensor, Tensor]:
    _check(F)
    theta = check_law(law, PLASTIC, params, F)
    if unknown := [m for m in memory or {} if m not in MEMORY]:
        raise ValueError(f"unknown memory {unknown[0]!r}; known: {', '.join(MEMORY)}")
    # the map is that of the strains alone, but a mixture has an elastic law: its stress is not asked for
    theta = {"E": F.new_ones(()), "nu": F.new_zeros(()), **theta}
    return _evaluate(("hencky",), (law,), F, theta, dict(memory or {}), dt)


def _check(F: Tensor) -> None:
    if F.dtype not in REAL or F.shape[-2:] != (3, 3):
        raise ValueError(f"F must be (..., 3, 3) in float32 or float64, got {tuple(F.shape)} in {F.dtype}")
    check_state(F)


def _evaluate(
    elastic: tuple[str, ...],
    plastic: tuple[str, ...],
    F: Tensor,
    theta: Mapping[str, Tensor],
    memory: Mapping[str, Tensor],
    dt: float,
) -> tuple[Tensor, Tensor, Tensor]:
    """(τ, Fe, h') of one mixture of single laws."""
    with LOCK:
        mixture = make_mixture(elastic, plastic, REAL[F.dtype])
    batch = F.shape[:-2]

    def columns(values: Sequence[Tensor | float]) -> Tensor:
        rows = [torch.as_tensor(v, dtype=F.dtype, device=F.device).expand(batch) for v in values]
        return torch.stack(rows, -1).reshape(-1, len(rows))

    new = {"slip": 0.0, "heat": 0.0}
    if "log_J" in mixture.memory and "log_J" not in memory:
        new["log_J"] = log_det(F)
    h = columns([{**new, **memory}[m] for m in mixture.memory] or [0.0])
    rows = F.reshape(-1, 3, 3).contiguous(), columns([theta[p] for p in mixture.params]), h
    tau, Fe, after = _Point.apply(mixture, dt, *rows)
    return tau.reshape(F.shape), Fe.reshape(F.shape), after.reshape(*batch, -1)


def _kernels(mixture: Mixture) -> tuple[Any, Any]:
    """Kernels of stress and return map, and of their adjoint, made by one thread at a time."""
    with LOCK:
        return _make_kernels(mixture)


@cache
def _make_kernels(mixture: Mixture) -> tuple[Any, Any]:
    """A mixture of single laws reads no weights."""
    real, mat33, theta_t, memory_t = mixture.real, mixture.mat33, mixture.theta_t, mixture.memory_t
    eye = linalg.build(real).eye
    w_e_t, w_p_t, remembers = mixture.w_e_t, mixture.w_p_t, len(mixture.memory) > 0

    @wp.kernel(module="unique", enable_backward=False)
    def forward(
        F: wp.array(dtype=mat33),  # (N,)
        theta: wp.array(dtype=theta_t),  # (N,) SI
        h: wp.array(dtype=memory_t),  # (N,)
        dt: real,
        tau: wp.array(dtype=mat33),  # (N,) [Pa]   out
        Fe: wp.array(dtype=mat33),  # (N,)   out
        h_out: wp.array(dtype=memory_t),  # (N,)   out
    ):
        p = wp.tid()
        if wp.static(remembers):
            tau_p, flow_p, h_p = mixture.stress(F[p], F[p] - eye(), w_e_t(), w_p_t(), theta[p], dt, h[p])
            h_out[p] = h_p
        else:
            tau_p, flow_p = mixture.stress(F[p], F[p] - eye(), w_e_t(), w_p_t(), theta[p], dt)
        tau[p] = tau_p
        Fe[p] = F[p] + flow_p

    @wp.kernel(module="unique", enable_backward=False)
    def backward(
        F: wp.array(dtype=mat33),
        theta: wp.array(dtype=theta_t),
        h: wp.array(dtype=memory_t),
        dt: real,
        tau_bar: wp.array(dtype=mat33),
        Fe_bar: wp.array(dtype=mat33),
        h_out_bar: wp.array(dtype=memory_t),
        F_bar: wp.array(dtype=mat33),  # out
        theta_bar: wp.array(dtype=theta_t),  # out
        h_bar: wp.array(dtype=memory_t),  # out
    ):
        p = wp.tid()
        if wp.static(remembers):
            F_p, _w_e, _w_p, theta_p, h_p = mixture.stress_adjoint(
                F[p], F[p] - eye(), w_e_t(), w_p_t(), theta[p], dt, tau_bar[p], Fe_bar[p], h[p], h_out_bar[p]
            )
            h_bar[p] = h_p
        else:
            F_p, _w_e, _w_p, theta_p = mixture.stress_adjoint(
                F[p], F[p] - eye(), w_e_t(), w_p_t(), theta[p], dt, tau_bar[p], Fe_bar[p]
            )
        F_bar[p] = F_p
        theta_bar[p] = theta_p

    return forward, backward


def _launch(kernel: Any, kinds: Sequence[Any], dt: float, inputs: Sequence[Tensor], outputs: Sequence[Tensor]) -> None:
    """Launch a kernel on the memory of these tensors, in torch's stream; inputs first, dt after the third."""
    device = wp.device_from_torch(inputs[0].device)
    tensors = (*(t.detach().contiguous() for t in inputs), *outputs)
    arrays = [wp.from_torch(t, dtype=kind) for t, kind in zip(tensors, kinds, strict=True)]
    load(kernel, device)
    stream = wp.stream_from_torch(inputs[0].device) if device.is_cuda else None
    wp.launch(kernel, len(inputs[0]), [*arrays[:3], dt, *arrays[3:]], device=device, stream=stream)


class _Point(torch.autograd.Function):
    """(F, θ, h) → (τ, Fe, h'), differentiable once."""

    @staticmethod
    def forward(ctx: Any, mixture: Mixture, dt: float, F: Tensor, theta: Tensor, h: Tensor) -> tuple[Tensor, ...]:
        m = mixture
        ctx.mixture, ctx.dt = mixture, dt
        ctx.save_for_backward(F, theta, h)
        out = torch.empty_like(F), torch.empty_like(F), torch.zeros_like(h)
        kinds = (m.mat33, m.theta_t, m.memory_t, m.mat33, m.mat33, m.memory_t)
        _launch(_kernels(m)[0], kinds, dt, (F, theta, h), out)
        return out

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, *bars: Tensor) -> tuple[Tensor | None, ...]:
        m, (F, theta, h) = ctx.mixture, ctx.saved_tensors
        out = torch.empty_like(F), torch.empty_like(theta), torch.zeros_like(h)
        kinds = (m.mat33, m.theta_t, m.memory_t, m.mat33, m.mat33, m.memory_t, m.mat33, m.theta_t, m.memory_t)
        _launch(_kernels(m)[1], kinds, ctx.dt, (F, theta, h, *bars), out)
        return (None, None, *out)


class _Strains(torch.autograd.Function):
    """F → e, principal Hencky strains; F̄ = U diag(ē/s) Vᵀ, right for any function that is symmetric in them."""

    @staticmethod
    def forward(ctx: Any, F: Tensor) -> Tensor:
        U, e, Vh = decompose(F)
        ctx.save_for_backward(U, e, Vh)
        return e

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, e_bar: Tensor) -> Tensor:
        U, e, Vh = ctx.saved_tensors
        return (U * (e_bar * torch.exp(-e))[..., None, :]) @ Vh
