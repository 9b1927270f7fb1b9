"""The formulation that most published Warp codes share, for the problems of this benchmark.

    PYTHON svd_peer.py      # tasks come by standard input, see exchange.py

Kernels of ``benchmarks.peers``, written there from the published description of warp-mpm (Zong et al. 2023) and
PhysGaussian (Xie et al. 2024): gradients of the weights, an SVD for every particle, arrays of nodes apart. Added here:
the neo-Hookean law by that SVD, as those codes have it, walls at nodes, and body forces.
"""

import sys
from pathlib import Path

import numpy as np
import warp as wp

sys.path.insert(1, str(Path(__file__).resolve().parents[2]))
from exchange import Runner, Task, serve

from benchmarks.peers import clear, gather, scatter


@wp.kernel(enable_backward=False)
def stresses(F_trial: wp.array[wp.mat33], mu: float, lam: float, F: wp.array[wp.mat33], tau: wp.array[wp.mat33]):
    """τ = U diag(μ (σ² − 1) + λ ln J) Uᵀ."""
    p = wp.tid()
    U, s, _ = wp.svd3(F_trial[p])
    pressure = lam * wp.log(s[0] * s[1] * s[2])
    along = mu * (wp.cw_mul(s, s) - wp.vec3(1.0)) + wp.vec3(pressure)
    F[p] = F_trial[p]
    tau[p] = U * wp.diag(along) * wp.transpose(U)


@wp.kernel(enable_backward=False)
def push(v: wp.array[wp.vec3], b: wp.array[wp.vec3], dt: float):
    p = wp.tid()
    v[p] = v[p] + dt * b[p]


@wp.kernel(enable_backward=False)
def move(
    grid_m: wp.array3d[float], grid_mv: wp.array3d[wp.vec3], grid_v: wp.array3d[wp.vec3], walls: wp.array2d[float],
    dx: float, dt: float, gravity: wp.vec3,
):  # fmt: skip
    i, j, k = wp.tid()
    m = grid_m[i, j, k]
    if m <= 0.0:
        return
    v = grid_mv[i, j, k] / m + dt * gravity
    at = wp.vec3(float(i), float(j), float(k)) * dx
    for w in range(walls.shape[0]):
        n = wp.vec3(walls[w, 3], walls[w, 4], walls[w, 5])
        if wp.dot(at - wp.vec3(walls[w, 0], walls[w, 1], walls[w, 2]), n) <= 1.0e-3 * dx:
            across = wp.dot(v, n)
            if walls[w, 6] == 0.0:
                v = wp.vec3()
            elif walls[w, 6] == 1.0:
                v = v - across * n
            elif across < 0.0:
                along = v - across * n
                v = along * wp.max(0.0, 1.0 + walls[w, 7] * across / wp.max(wp.length(along), 1.0e-30))
    grid_v[i, j, k] = v


class Usual(Runner):
    """A task in the usual formulation."""

    def __init__(self, task: Task):
        if task.law != "neo_hookean":
            raise ValueError(f"the stand-in has the neo-Hookean law alone, got {task.law!r}")
        self.task, n = task, len(task.x)
        low = (np.floor(task.low / task.dx) - 2) * task.dx
        self.low, shape = low, np.ceil((task.high - low) / task.dx).astype(int) + 3
        eye = np.tile(np.eye(3), (n, 1, 1))
        kinds = (wp.vec3, wp.vec3, wp.mat33, wp.mat33, wp.mat33, wp.mat33)
        values = (task.x - low, task.v, task.C, eye, eye, np.zeros_like(eye))
        self.first = [a.astype(np.float32) for a in values]
        self.arrays = [wp.array(a, dtype=d, device="cpu") for a, d in zip(self.first, kinds, strict=True)]
        self.vol = wp.array(task.vol.astype(np.float32), device="cpu")
        self.m = wp.array((task.rho * task.vol).astype(np.float32), device="cpu")
        self.b = [wp.array(b.astype(np.float32), dtype=wp.vec3, device="cpu") for b in task.forces]
        walls = task.walls.copy()
        walls[:, :3] -= low
        self.walls = wp.array(walls.astype(np.float32).reshape(-1, 8), dtype=float, device="cpu")
        self.shape = tuple(int(s) for s in shape)
        self.grid_m = wp.zeros(self.shape, dtype=float, device="cpu")
        self.grid_mv, self.grid_v = (wp.zeros(self.shape, dtype=wp.vec3, device="cpu") for _ in range(2))
        self.done = 0

    def reset(self) -> None:
        for array, first in zip(self.arrays, self.first, strict=True):
            array.assign(first)
        self.done = 0

    def frame(self) -> None:
        for _ in range(self.task.per):
            self.substep()

    def substep(self) -> None:
        t, n = self.task, len(self.task.x)
        x, v, C, F, F_trial, tau = self.arrays
        nodes = [self.grid_m, self.grid_mv, self.grid_v]
        wp.launch(clear, self.shape, inputs=nodes, device="cpu")
        wp.launch(stresses, n, inputs=[F_trial, t.mu, t.lam, F, tau], device="cpu")
        if self.b:
            wp.launch(push, n, inputs=[v, self.b[self.done], t.dt], device="cpu")
        wp.launch(scatter, n, inputs=[x, v, C, tau, self.m, self.vol, t.dx, t.dt, *nodes[:2]], device="cpu")
        gravity = wp.vec3(*t.gravity)
        wp.launch(move, self.shape, inputs=[*nodes, self.walls, t.dx, t.dt, gravity], device="cpu")
        wp.launch(gather, n, inputs=[x, v, C, F, F_trial, self.grid_v, t.dx, t.dt], device="cpu")
        self.done += 1

    def positions(self) -> np.ndarray:
        return self.arrays[0].numpy().astype(np.float64) + self.low


if __name__ == "__main__":
    wp.config.quiet = True
    serve(Usual)
