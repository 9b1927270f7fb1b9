"""MLS-MPM in Taichi as its examples have it (Hu et al. 2018, mpm88, mpm99, mpm3d), for the problems of this benchmark.

    PYTHON taichi_peer.py f32|f64      # tasks come by standard input, see exchange.py

Written here from the published 88 lines and nothing made slower: quadratic splines, affine transfer, symplectic Euler,
stress and affine momentum in one 3 × 3 matrix, a dense box of nodes cleared each substep, one thread. The stress is the
neo-Hookean one of the problem, which needs no decomposition; a liquid carries J alone. Walls set the velocity of their
nodes and of those behind.
"""

import sys

import numpy as np
import taichi as ti
from exchange import Runner, Task, serve

REAL = ti.f64 if sys.argv[1:] == ["f64"] else ti.f32
ti.init(arch=ti.cpu, default_fp=REAL, cpu_max_num_threads=1, log_level=ti.WARN, offline_cache=True)
vec3, mat3 = ti.types.vector(3, REAL), ti.types.matrix(3, 3, REAL)
Vectors, Matrices = ti.types.ndarray(vec3, 1), ti.types.ndarray(mat3, 1)
Scalars, Nodes = ti.types.ndarray(REAL, 1), ti.types.ndarray(ti.types.vector(4, REAL), 3)
Table = ti.types.ndarray(REAL, 2)


@ti.func
def weights(f):
    """Of the three nodes along each axis, a matrix with a row for each."""
    return ti.Matrix.rows([0.5 * (1.5 - f) ** 2, 0.75 - (f - 1.0) ** 2, 0.5 * (f - 0.5) ** 2])


@ti.kernel
def clear(grid: Nodes):
    for I in ti.grouped(grid):
        grid[I] = ti.Vector([0.0, 0.0, 0.0, 0.0], REAL)


@ti.kernel
def scatter(
    x: Vectors, v: Vectors, C: Matrices, F: Matrices, J: Scalars, vol: Scalars, b: Vectors, grid: Nodes,
    origin: vec3, dx: REAL, dt: REAL, rho: REAL, mu: REAL, lam: REAL, gamma: REAL, driven: ti.i32,
):  # fmt: skip
    for p in x:
        g = (x[p] - origin) / dx
        base = ti.cast(g - 0.5, ti.i32)
        f = g - ti.cast(base, REAL)
        w = weights(f)
        tau = ti.Matrix.zero(REAL, 3, 3)
        eye = ti.Matrix.identity(REAL, 3)
        if mu > 0.0:
            tau = mu * (F[p] @ F[p].transpose() - eye) + lam * ti.log(F[p].determinant()) * eye
        else:
            tau = -J[p] * lam / gamma * (J[p] ** (-gamma) - 1.0) * eye
        m = rho * vol[p]
        affine = m * C[p] - (dt * vol[p] * 4.0 / (dx * dx)) * tau
        v_p = v[p]
        if driven == 1:
            v_p += dt * b[p]
        for i, j, k in ti.static(ti.ndrange(3, 3, 3)):
            d = (ti.Vector([i, j, k], REAL) - f) * dx
            weight = w[i, 0] * w[j, 1] * w[k, 2]
            q = weight * (m * v_p + affine @ d)
            grid[base + ti.Vector([i, j, k])] += ti.Vector([q[0], q[1], q[2], weight * m], REAL)


@ti.kernel
def move(grid: Nodes, walls: Table, origin: vec3, dx: REAL, dt: REAL, gravity: vec3):
    for I in ti.grouped(grid):
        m = grid[I][3]
        if m > 0.0:
            v = ti.Vector([grid[I][0], grid[I][1], grid[I][2]], REAL) / m + dt * gravity
            at = origin + ti.cast(I, REAL) * dx
            for k in range(walls.shape[0]):
                n = ti.Vector([walls[k, 3], walls[k, 4], walls[k, 5]], REAL)
                if (at - ti.Vector([walls[k, 0], walls[k, 1], walls[k, 2]], REAL)).dot(n) <= 1e-3 * dx:
                    across = v.dot(n)
                    if walls[k, 6] == 0.0:
                        v = ti.Vector([0.0, 0.0, 0.0], REAL)
                    elif walls[k, 6] == 1.0:
                        v -= across * n
                    elif across < 0.0:
                        along = v - across * n
                        v = along * ti.max(0.0, 1.0 + walls[k, 7] * across / ti.max(along.norm(), 1e-30))
            grid[I] = ti.Vector([v[0], v[1], v[2], m], REAL)


@ti.kernel
def gather(
    x: Vectors, v: Vectors, C: Matrices, F: Matrices, J: Scalars, grid: Nodes, origin: vec3, dx: REAL, dt: REAL,
    solid: ti.i32,
):  # fmt: skip
    for p in x:
        g = (x[p] - origin) / dx
        base = ti.cast(g - 0.5, ti.i32)
        f = g - ti.cast(base, REAL)
        w = weights(f)
        v_p, B = ti.Vector.zero(REAL, 3), ti.Matrix.zero(REAL, 3, 3)
        for i, j, k in ti.static(ti.ndrange(3, 3, 3)):
            q = grid[base + ti.Vector([i, j, k])]
            v_i = ti.Vector([q[0], q[1], q[2]], REAL)
            weight = w[i, 0] * w[j, 1] * w[k, 2]
            v_p += weight * v_i
            B += 4.0 / dx * weight * v_i.outer_product(ti.Vector([i, j, k], REAL) - f)
        v[p], C[p] = v_p, B
        x[p] += dt * v_p
        if solid == 1:
            F[p] += dt * B @ F[p]
        else:
            J[p] *= 1.0 + dt * B.trace()


class Taichi(Runner):
    """A task in Taichi."""

    def __init__(self, task: Task):
        self.task, real = task, np.float64 if REAL == ti.f64 else np.float32
        n, t = len(task.x), task
        self.start = [a.astype(real) for a in (t.x, t.v, t.C, np.tile(np.eye(3), (n, 1, 1)), np.ones(n))]
        self.x, self.v = (ti.ndarray(vec3, n) for _ in range(2))
        self.C, self.F = (ti.ndarray(mat3, n) for _ in range(2))
        self.J, self.vol = (ti.ndarray(REAL, n) for _ in range(2))
        self.vol.from_numpy(t.vol.astype(real))
        self.b = [ti.ndarray(vec3, n) for _ in range(max(1, len(t.forces)))]
        for a, row in zip(self.b, t.forces, strict=False):
            a.from_numpy(row.astype(real))
        low = np.floor(t.low / t.dx) - 2
        shape = (np.ceil(t.high / t.dx) + 3 - low).astype(int)
        self.grid = ti.ndarray(ti.types.vector(4, REAL), tuple(int(s) for s in shape))
        self.walls = ti.ndarray(REAL, (max(1, len(t.walls)), 8))
        nowhere = np.array([[0.0, 0.0, -1e9, 0.0, 0.0, 1.0, 1.0, 0.0]])  # a kernel needs one row
        self.walls.from_numpy((t.walls if len(t.walls) else nowhere).astype(real))
        self.origin, self.gravity = vec3(*(low * t.dx)), vec3(*t.gravity)
        self.done = 0

    def reset(self) -> None:
        for array, first in zip((self.x, self.v, self.C, self.F, self.J), self.start, strict=True):
            array.from_numpy(first)
        self.done = 0

    def frame(self) -> None:
        t = self.task
        state = (self.x, self.v, self.C, self.F, self.J)
        driven, solid = int(len(t.forces) > 0), int(t.mu > 0)
        for _ in range(t.per):
            b = self.b[self.done if driven else 0]
            clear(self.grid)
            scatter(*state, self.vol, b, self.grid, self.origin, t.dx, t.dt, t.rho, t.mu, t.lam, t.gamma, driven)
            move(self.grid, self.walls, self.origin, t.dx, t.dt, self.gravity)
            gather(*state, self.grid, self.origin, t.dx, t.dt, solid)
            self.done += 1

    def positions(self) -> np.ndarray:
        return self.x.to_numpy()


if __name__ == "__main__":
    serve(Taichi)
