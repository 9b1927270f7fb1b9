"""Sums over the substeps of a frame that the velocity loss compares with; nothing of this exists unless asked for.

    expected_dv_p = Σ_substeps Σ_i w_ip (f_i / m_i + k g)                    what stress and gravity do to a particle
    impulse       = Σ_substeps Σ_i m_i (v_i after walls − v_i before)       what all walls do to the body

f_i is the impulse that ``p2g`` brings to a node beside its momentum, c = Π (f/m + k g) what walls that hold leave of it
(``nodes``). Hence, with the velocities of two frames,

    v_p(end) − v_p(start) = expected_dv_p + the filter Σ_substeps [(1 − α)(Σ_i w_ip v⁰_i − v_p) + Σ_i w_ip (S c)_i/m_i]
                            + walls,
    Σ_p m_p (v_p(end) − v_p(start)) = M g T + impulse,

the latter to rounding, since the transfer keeps momentum. Both sums are taken in the forward pass and are constants of
the graph: targets, through which no gradient flows.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Literal, get_args

import torch
import warp as wp
from torch import Tensor

from diffuphy.mpm.substep.rows import make_rows
from diffuphy.mpm.substep.transfer import make_transfer
from diffuphy.mpm.substep.variant import Variant

Gather = Literal["expected_dv", "impulse"]
"""Sums that a rollout can take."""


@dataclass(frozen=True)
class Sums:
    """Accumulators of one frame; kernels add to them in place."""

    expected_dv: Tensor | None
    """Velocity change of each particle by stress and gravity, shape (N, 3) [m/s]; None if not asked for."""
    nodal: Tensor | None
    """Impulse of the walls at each node, shape (nodes, 3) [N s]; None if not asked for."""

    @classmethod
    def zero(cls, names: Sequence[Gather], x: Tensor, nodes: int) -> "Sums":
        """Nothing added yet, for particles like ``x`` and so many nodes."""
        return cls(
            x.new_zeros(x.shape) if "expected_dv" in names else None,
            x.new_zeros(nodes, 3) if "impulse" in names else None,
        )

    @property
    def impulse(self) -> Tensor | None:
        """Impulse of all walls on the body, shape (3,) [N s]."""
        return None if self.nodal is None else self.nodal.sum(0, dtype=torch.float64).to(self.nodal.dtype)


def check_gather(names: Sequence[str]) -> None:
    """Refuse a sum that nobody takes.

    Raises:
        ValueError: naming it, and what there is.
    """
    if isinstance(names, str) or (unknown := [n for n in names if n not in get_args(Gather)]):
        got = repr(names) if isinstance(names, str) else repr(unknown[0])
        raise ValueError(f"gather must be a tuple of names out of {get_args(Gather)}, got {got}")


def make_gather(variant: Variant) -> SimpleNamespace:
    """The kernel ``add_forces``, for between ``divide`` and ``move``. Cached."""
    return variant.made(_make_gather)


def _make_gather(variant: Variant) -> SimpleNamespace:
    real, vec3, node_t = variant.real, variant.vec3, variant.node_t
    transfer = make_transfer(variant.scheme, real)
    inside, cell, gather = transfer.spline.inside, transfer.spline.cell, transfer.gather
    second, classic = make_rows(variant).second, variant.scheme.force == "classic"

    @wp.kernel(module="unique", enable_backward=False)
    def add_forces(
        X: wp.array[vec3],
        u: wp.array[vec3],
        acc: wp.array[node_t],  # (nodes,) velocity, mass, velocity change by stress and gravity
        low: vec3,
        dx: real,
        n: wp.vec3i,
        at: wp.int32,
        start: wp.int32,
        expected_dv: wp.array[vec3],  # (N,) [m/s]   in and out
    ):
        p = start + wp.tid()
        g = ((X[p] - low) + u[at + p]) * (real(1.0) / dx)
        if not inside(g, n):
            return
        bx, by, bz, f = cell(g)
        if wp.static(classic):
            mean, _m0, _m1, _m2, _g0, _g1, _g2 = gather(acc, 0, n, bx, by, bz, f)
        else:
            mean, _m0, _m1, _m2 = gather(acc, 0, n, bx, by, bz, f)
        expected_dv[p] = expected_dv[p] + second(mean)

    return SimpleNamespace(add_forces=add_forces)
