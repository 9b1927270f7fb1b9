"""The kernels of a round in order: forward, and backward."""

import warp as wp

from diffuphy.mpm.engine.launch import Bound, Command, Program, alone
from diffuphy.mpm.state import Bars
from diffuphy.mpm.substep.adjoint import Needs, make_adjoint
from diffuphy.mpm.substep.gather import Sums, make_gather
from diffuphy.mpm.substep.kernels import make_kernels
from diffuphy.mpm.substep.nodes import make_nodes
from diffuphy.mpm.substep.nodes_adjoint import make_nodes_adjoint
from diffuphy.mpm.substep.sharpen import make_sharpening

Phases = list[list[Command]]


def forward(b: Bound, status: wp.array, flowed: tuple[wp.array, wp.array], sums: Sums | None = None) -> Program:
    """One round: particles to grid, grid, grid to particles.

    Args:
        flowed: room for the elastic parts after flow, of the body and of its viscous branch; the arrays of a single
            state may take it themselves.
    """
    k, a, args, v = make_kernels(b.variant), b.arrays, b.args, b.variant
    He, HN = flowed
    g2p = args.record(k.g2p, b.particles, [
        a.X, a.u, a.v, a.C, He if v.mixture.is_plastic else a.He, a.H, HN, b.grid_v, b.tag, b.drive, b.low, b.dx, b.n,
        args.lanes.particles, b.steps, 0, 0, 0, 0, b.cells, a.u, a.v, a.C, a.He, a.H, a.HN, a.memory,
        status,
    ])  # fmt: skip
    return Program([_p2g(b, status, He, HN, a.memory), *_grid(b, sums), g2p])


def _p2g(b: Bound, status: wp.array, He: wp.array, HN: wp.array, memory: wp.array) -> list[Command]:
    a, args = b.arrays, b.args
    return args.record(make_kernels(b.variant).p2g, b.particles, [
        a.X, a.u, a.v, a.C, a.He, a.HN, a.memory, *b.matter, b.body, b.tag, b.drive, b.walls, args.sdf, 0,
        b.low, b.dx, b.n, args.lanes.per, b.steps, 0, 0, 0, 0, b.cells, b.grid, b.pins, He, HN, memory, status,
    ])  # fmt: skip


def _grid(b: Bound, sums: Sums | None) -> Phases:
    """The passes over the nodes, and what is summed between them."""
    v, args, k, a = b.variant, b.args, make_nodes(b.variant), b.arrays
    phases = []
    if v.two_passes:
        phases.append(args.record(k.divide, b.nodes, [
            b.grid, args.lanes.copies, b.n, args.gravity, b.steps, 0, *b.planes, 0, b.active,
            b.walls, args.sdf, 0, b.dx, b.pins, b.acc, b.load, b.pin,
        ]))  # fmt: skip
    if sums is not None and sums.expected_dv is not None:
        dv = args.view(sums.expected_dv, v.vec3)
        phases.append(args.record(
            make_gather(v).add_forces, b.particles, [a.X, a.u, b.load, b.low, b.dx, b.n, 0, 0, dv]
        ))  # fmt: skip
    if v.scheme.sharpen:
        phases.append(args.record(make_sharpening(v).cells, b.nodes, [b.acc, b.n, 0, b.active, b.sigma]))
    impulse = args.view(None if sums is None else sums.nodal, v.vec3)
    if v.measures and (sums is None or sums.nodal is None):  # a kernel that measures needs a place to put it
        impulse = args.nodal("impulse", b.span.grid.nodes * args.lanes.scenes, v.vec3)
    phases.append(args.record(k.move, b.nodes, [
        b.grid, b.pins, args.lanes.copies, b.acc, b.load, b.pin, b.sigma, b.walls, args.sdf, 0, b.n, b.dx, args.gravity,
        b.steps, 0, 0, b.active, b.grid_v, impulse,
    ]))  # fmt: skip
    return phases


def backward(b: Bound, bars: Bars, needs: Needs, flowed: tuple[wp.array, wp.array]) -> Program:
    """One round backwards. The grid is computed again first, in two passes; ``bars`` go from the end of the round to
    its beginning."""
    v, args, a = b.variant, b.args, b.arrays
    k, nodes = make_adjoint(v), make_nodes_adjoint(v)
    lanes, count = args.lanes, b.span.grid.nodes * args.lanes.scenes
    He, HN = flowed
    bar = args.nodal("bar", count * lanes.copies, v.node_t, clear=b.rows)
    y, out = args.nodal("y", count, v.node_t), args.nodal("out", count, v.node_t)
    memory = args.zeros(len(a.X) if v.mixture.memory else 0, v.mixture.memory_t)
    state = [args.view(t, d) for t, d in bars.state(v)]
    x_bar, v_bar, C_bar, He_bar, H_bar, memory_bar, HN_bar = state
    at_end = [x_bar, v_bar, C_bar, He_bar, H_bar, HN_bar, memory_bar]
    at_start = [x_bar, v_bar, C_bar, He_bar, HN_bar, memory_bar]
    phases = [_p2g(b, b.status, He, HN, memory), *_grid(b, None)]
    phases.append(args.record(k.g2p_adjoint, b.particles, [
        a.X, a.u, a.v, a.C, He if v.mixture.is_plastic else a.He, a.H, HN, b.grid_v, b.tag, b.drive, b.low, b.dx, b.n,
        lanes.particles, lanes.per, b.steps, 0, 0, 0, *at_end, bar,
        args.view(bars.alpha, v.real), bars.alpha is not None,
    ]))  # fmt: skip
    rows = args.zeros((0, 0), b.walls.dtype) if bars.walls is None else args.view(bars.walls, b.walls.dtype)
    # gradients of walls are summed over nodes into one row, which two threads must not write at once
    there = b.nodes if bars.walls is None else alone(b.nodes)
    phases.append(args.record(nodes.move_adjoint, there, [
        b.acc, b.load, b.pin, b.sigma, bar, lanes.copies, b.walls, args.sdf, 0, b.n, b.dx, b.steps, 0, 0, b.active, y,
        args.view(bars.omega, v.real), rows, bars.walls is not None,
    ]))  # fmt: skip
    sigma_y = args.nodal("sigma_y", count if v.scheme.sharpen else 1, v.node_t)
    if v.scheme.sharpen:
        phases.append(args.record(nodes.cells_adjoint, b.nodes, [b.acc, y, b.n, 0, b.active, sigma_y]))
    gravity = args.view(bars.gravity, v.vec3)
    phases.append(args.record(nodes.divide_adjoint, b.nodes, [
        b.acc, b.load, b.pin, b.sigma, y, sigma_y, b.n, args.gravity, b.steps, 0, *b.planes, b.walls, args.sdf, 0, b.dx,
        0, b.active, out, gravity, bars.gravity is not None,
    ]))  # fmt: skip
    if v.mirror:  # y has been read: it takes the image
        phases.append(args.record(nodes.reflect, b.nodes, [out, b.n, *b.planes, 0, b.active, y]))
        out = y
    matter = [args.view(t, d) for t, d in bars.matter(v)]
    phases.append(args.record(k.p2g_adjoint, b.particles, [
        a.X, a.u, a.v, a.C, a.He, a.HN, a.memory, *b.matter, b.body, b.tag, b.drive, b.walls, args.sdf, 0, b.low, b.dx,
        b.n, lanes.particles, b.steps, 0, 0, 0, out, *at_start, *matter,
        args.zeros((0, 0), v.real) if bars.push is None else args.view(bars.push, v.real), *needs,
    ]))  # fmt: skip
    return Program(phases)
