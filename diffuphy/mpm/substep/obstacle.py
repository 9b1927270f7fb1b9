"""Held matter as an obstacle: what drives hold is a rough rigid wall for all other matter, wherever it moves.

    mark    V_i = Σ_p V_p (v_p + C_p d_ip) / Σ_p V_p        over the held particles p whose nearest node is i
    join    β_i = Σ_p w_ip m_p / m_i                        over the free particles that are one piece with held matter
    stop    u ← V_i   if β_i > ½ or (u − V_i)·∇m_i < 0      of a node that is marked; else unchanged

Held particles bring the nodes neither mass nor stress: as heavy as their matter they would give way, by f Δt/m in a
substep Δt under a steady force f, and a body at rest on them would creep in. Marked nodes follow them whatever the
force, as those of a wall do (``boundary.kernels``), and what presses on them is compressed against them. Those within
half a cell of a particle are marked, so that a single layer of particles has no gaps.

∇m is that of the mass of the free matter, which leads out of the obstacle into what touches it (Bardenhagen, Guilkey,
Roessig, Brackbill, Witzel & Foster 2001), on either side of a thin one. Matter that is pressed on sticks, as that of
two bodies on common nodes does, and may leave; what is one piece with held matter is not let go. The velocity of a
stopped node is given: no gradient goes through it. Which nodes are marked, and which stop, is held fixed.
"""

from types import SimpleNamespace
from typing import Any

import warp as wp

from diffuphy.mpm.drive import make_drives
from diffuphy.mpm.substep.mirror import make_reflection
from diffuphy.mpm.substep.places import make_places
from diffuphy.mpm.substep.rows import make_rows
from diffuphy.mpm.substep.simd import make_simd
from diffuphy.mpm.substep.transfer import make_transfer
from diffuphy.mpm.substep.variant import Variant

FREE, TOUCHED, JOINED = 0, 1, 2
"""What a node is to held matter, as the last number of its row: nothing, marked, marked and of one piece with it."""

SHARE = 0.5
"""β from which on a node is one piece with held matter: most of its mass is."""


def make_obstacle(variant: Variant) -> SimpleNamespace:
    """Warp functions of particles, ``mark``, ``join`` and ``brings``, the share of one that nodes get; and of nodes,
    ``pin``, V_i and what the node is, and ``stops``, whether it follows the obstacle. Cached."""
    return variant.made(_make_obstacle)


def _make_obstacle(v: Variant) -> SimpleNamespace:
    return SimpleNamespace(**_make_leaving(v), **_make_stopping(v))


def _make_leaving(v: Variant) -> dict[str, Any]:
    """What a particle leaves at its nodes: 0–2 V_p (v_p + C_p d), 3 V_p, 7 w m."""
    real, vec3, mat33, node_t = v.real, v.vec3, v.mat33, v.node_t
    transfer, rows, add = make_transfer(v.scheme, real), make_rows(v), make_simd(real).add
    scatter, row, classic = transfer.scatter, rows.row, v.scheme.force == "classic"

    @wp.func(module="unique")
    def mark(
        pins: wp.array[node_t], base: wp.int32, n: wp.vec3i, bx: wp.int32, by: wp.int32, bz: wp.int32, f: vec3,
        dx: real, vol: real, v: vec3, C: mat33,
    ):  # fmt: skip
        i, j, k = wp.int32(f[0] + real(0.5)), wp.int32(f[1] + real(0.5)), wp.int32(f[2] + real(0.5))
        d = dx * (vec3(real(i), real(j), real(k)) - f)
        o = base + ((bx + i) * n[1] + by + j) * n[2] + bz
        add(pins, o, k, vol, row(v + C * d, real(1.0), vec3()))

    @wp.func(module="unique")
    def join(
        pins: wp.array[node_t], base: wp.int32, n: wp.vec3i, bx: wp.int32, by: wp.int32, bz: wp.int32, f: vec3, m: real
    ):  # fmt: skip
        q, z = node_t(), node_t()
        q[7] = m
        if wp.static(classic):
            scatter(pins, base, n, bx, by, bz, f, q, z, z, z, z, z, z)
        else:
            scatter(pins, base, n, bx, by, bz, f, q, z, z, z)

    drive, obstructs = make_drives(v.drives, real), v.obstructs
    holding, drive_t = drive.holding, drive.drive_t

    @wp.func(module="unique")
    def brings(tag: wp.array[wp.int32], p: wp.int32, drive_row: wp.array2d[drive_t], s: wp.int32) -> real:
        """0 of a particle that is held, 1 of any other."""
        if wp.static(obstructs):
            if holding(tag[p], drive_row, s):
                return real(0.0)
        return real(1.0)

    return {"mark": mark, "join": join, "brings": brings}


def _make_stopping(v: Variant) -> dict[str, Any]:
    real, vec3, node_t, mirror = v.real, v.vec3, v.node_t, v.mirror
    reflection, flat = make_reflection(v), make_places().flat
    summed, folded = reflection.summed, reflection.folded

    @wp.func(module="unique")
    def pin(
        pins: wp.array[node_t], m: real, o: wp.int32, at: wp.vec3i, n: wp.vec3i, scene: wp.int32, lanes: wp.int32,
        low: wp.vec3i, high: wp.vec3i, sticky: wp.vec3i,
    ) -> node_t:  # fmt: skip
        """V_i and, last, what the node is; of a node with the mass m."""
        r = node_t()
        if wp.static(mirror):
            r = folded(pins, at, n, scene, lanes, low, high, sticky)
        else:
            r = summed(pins, o, scene, lanes, n[0] * n[1] * n[2])
        q = node_t()
        if r[3] > real(0.0):
            for k in range(3):
                q[k] = r[k] / r[3]
            q[7] = wp.where(r[7] > real(SHARE) * m, real(JOINED), real(TOUCHED))
        return q

    @wp.func(module="unique")
    def mass(acc: wp.array[node_t], base: wp.int32, i: wp.int32, j: wp.int32, k: wp.int32, n: wp.vec3i) -> real:
        o = flat(i, j, k, n)
        if o < 0:
            return real(0.0)
        return acc[base + o][3]

    @wp.func(module="unique")
    def stops(u: vec3, q: node_t, acc: wp.array[node_t], base: wp.int32, at: wp.vec3i, n: wp.vec3i) -> bool:
        """Whether a node with the velocity u, the row q of ``pin`` and the masses of ``acc`` around takes that of the
        obstacle."""
        if q[7] == real(FREE):
            return False
        if q[7] == real(JOINED):
            return True
        i, j, k = at[0], at[1], at[2]
        slope = vec3(
            mass(acc, base, i + 1, j, k, n) - mass(acc, base, i - 1, j, k, n),
            mass(acc, base, i, j + 1, k, n) - mass(acc, base, i, j - 1, k, n),
            mass(acc, base, i, j, k + 1, n) - mass(acc, base, i, j, k - 1, n),
        )
        return wp.dot(u - vec3(q[0], q[1], q[2]), slope) < real(0.0)

    return {"pin": pin, "stops": stops}
