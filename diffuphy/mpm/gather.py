"""Sums over the substeps of a frame that the velocity loss compares with; nothing of this exists unless asked for.

    expected_dv_p = Σ_substeps [ Σ_i w_ip (q_i − q⁰_i) / m_i + g Δt ]       what stress and gravity do to a particle
    impulse       = Σ_substeps Σ_i m_i (v_i after walls − v_i before)       what all walls do to the body

q_i is the momentum that ``p2g`` brings to a node, q⁰_i what it would bring without stress, so that (q_i − q⁰_i)/m_i =
Δt f_i/m_i with the internal force f_i = −Σ_p V_p τ_p ∇w_ip. Hence, with the velocities of two frames,

    v_p(end) − v_p(start) = expected_dv_p + the filter Σ_substeps (Σ_i w_ip q⁰_i/m_i − v_p) + walls,
    Σ_p m_p (v_p(end) − v_p(start)) = M g T + impulse,

the latter to rounding, since the transfer keeps momentum. Both sums are taken in the forward pass and are constants of
the graph: targets, through which no gradient flows.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, Literal, get_args

import torch
import warp as wp
from torch import Tensor

from diffuphy.mpm.boundary import Signature, make_contact
from diffuphy.mpm.kernels import cached, make_kernels, make_spline

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


def make_gather(mixture: Any, walls: Signature, real: type) -> SimpleNamespace:
    """The kernels ``p2g_free``, ``add_forces`` and ``add_walls``, for between ``p2g`` and ``grid_update``. Cached."""
    return cached(_make_gather, mixture, walls, real)


def _make_gather(mixture: Any, walls: Signature, real: type) -> SimpleNamespace:
    forward = make_kernels(mixture, walls, real)
    vec3, mat33, vec4, wall_t = forward.vec3, forward.mat33, forward.vec4, forward.wall_t
    spline, apply = make_spline(real), make_contact(walls, real).apply
    weights, inside, cell, columns = spline.weights, spline.inside, spline.cell, spline.columns
    velocity, place = forward.velocity, forward.place

    @wp.kernel(module="unique", enable_backward=False)
    def p2g_free(
        X: wp.array[vec3],  # (N,) [m]   position at the beginning of the frame
        u: wp.array[vec3],  # (N,) [m]   displacement since
        v: wp.array[vec3],  # (N,) [m/s]
        C: wp.array[mat33],  # (N,) [1/s]
        m: wp.array[real],  # (N,) [kg]
        low: vec3,  # [m]  lowest node
        dx: real,
        n: wp.vec3i,  # nodes along each axis
        at: wp.int32,  # first row of this state in u, v, C
        free: wp.array[vec4],  # (nodes,) momentum without stress [kg m/s], -   out
    ):
        p = wp.tid()
        r = at + p
        g = ((X[p] - low) + u[r]) * (real(1.0) / dx)
        if not inside(g, n):
            return
        bx, by, bz, f = cell(g)
        wx, wy, wz = weights(f[0]), weights(f[1]), weights(f[2])
        A = (m[p] * dx) * C[r]
        q3 = m[p] * v[r] - A * f
        q = vec4(q3[0], q3[1], q3[2], real(0.0))
        a0, a1, a2 = columns(A)
        for i in range(3):
            for j in range(3):
                w_ij = wx[i] * wy[j]
                q_ij = q + wp.static(real(i)) * a0 + wp.static(real(j)) * a1
                o = ((bx + i) * n[1] + by + j) * n[2] + bz
                wp.atomic_add(free, o, (w_ij * wz[0]) * q_ij)
                wp.atomic_add(free, o + 1, (w_ij * wz[1]) * (q_ij + a2))
                wp.atomic_add(free, o + 2, (w_ij * wz[2]) * (q_ij + real(2.0) * a2))

    @wp.kernel(module="unique", enable_backward=False)
    def add_forces(
        X: wp.array[vec3],
        u: wp.array[vec3],
        grid: wp.array[vec4],  # (nodes,) momentum [kg m/s], mass [kg]
        free: wp.array[vec4],  # (nodes,) momentum without stress [kg m/s], -
        g_dt: vec3,  # [m/s]  g Δt
        low: vec3,
        dx: real,
        n: wp.vec3i,
        at: wp.int32,
        expected_dv: wp.array[vec3],  # (N,) [m/s]   in and out
    ):
        p = wp.tid()
        g = ((X[p] - low) + u[at + p]) * (real(1.0) / dx)
        if not inside(g, n):
            return
        bx, by, bz, f = cell(g)
        wx, wy, wz = weights(f[0]), weights(f[1]), weights(f[2])
        dv = vec4()
        for i in range(3):
            for j in range(3):
                for k in range(3):
                    o = ((bx + i) * n[1] + by + j) * n[2] + bz + k
                    a = grid[o]
                    if a[3] > real(0.0):
                        dv += (wx[i] * wy[j] * wz[k] / a[3]) * (a - free[o])
        expected_dv[p] = expected_dv[p] + (vec3(dv[0], dv[1], dv[2]) + g_dt)

    @wp.kernel(module="unique", enable_backward=False)
    def add_walls(
        grid: wp.array[vec4],  # (nodes,) momentum [kg m/s], mass [kg]
        row: wp.array2d[wall_t],  # (steps, walls)
        sdf: wp.array[real],  # samples of signed-distance walls [m]
        s: wp.int32,  # row of this step
        g_dt: vec3,
        dx: real,
        n: wp.vec3i,
        impulse: wp.array[vec3],  # (nodes,) [N s]   in and out; one row a node, so that no order of threads matters
    ):
        o = wp.tid()
        a = grid[o]
        if a[3] > real(0.0):
            v = velocity(a, g_dt)
            impulse[o] = impulse[o] + a[3] * (apply(v, place(o, n, dx), row, sdf, s) - v)

    return SimpleNamespace(p2g_free=p2g_free, add_forces=add_forces, add_walls=add_walls)
