"""Throughput against the formulation that most published Warp codes share, in one process, taking turns.

    python -m benchmarks peers [--particles 20000 100000] [--repeat 7]

The stand-in is written here from the published description of warp-mpm (Zong et al. 2023) and PhysGaussian (Xie et al.
2024), as they run it, with nothing made slower: an SVD for every particle in a kernel of its own that branches on a
material number, forces from gradients of the weights, a dense cube of nodes of twice the length of the body in each
direction, arrays of mass, momentum and velocity apart and cleared each substep, indices by truncation. Its walls and
damping are left out. It solves the same problem: fixed corotated body, float32, the same particles, Δx and Δt. That it
does is checked: both films agree as two discretisations of one order do.
"""

import argparse
import json
import statistics
import time
from pathlib import Path

import torch
import warp as wp

from benchmarks.speed.body import N_SUB, SCHEMES, Body, body, describe
from diffuphy.mpm import Scheme

CASE = "fixed corotated"


@wp.kernel(enable_backward=False)
def clear(mass: wp.array3d[float], momentum: wp.array3d[wp.vec3], velocity: wp.array3d[wp.vec3]):
    i, j, k = wp.tid()
    mass[i, j, k] = 0.0
    momentum[i, j, k] = wp.vec3()
    velocity[i, j, k] = wp.vec3()


@wp.func
def von_mises(F: wp.mat33, U: wp.mat33, V: wp.mat33, s: wp.vec3, mu: float, strength: float) -> wp.mat33:
    """Return map in logarithmic principal stretches."""
    e = wp.vec3(wp.log(wp.max(s[0], 0.01)), wp.log(wp.max(s[1], 0.01)), wp.log(wp.max(s[2], 0.01)))
    mean = (e[0] + e[1] + e[2]) / 3.0
    d = e - wp.vec3(mean, mean, mean)
    excess = wp.length(d) - strength / (2.0 * mu)
    if excess <= 0.0:
        return F
    e = e - (excess / (wp.length(d) + 1.0e-6)) * d
    return U * wp.diag(wp.vec3(wp.exp(e[0]), wp.exp(e[1]), wp.exp(e[2]))) * wp.transpose(V)


@wp.func
def sand(F: wp.mat33, U: wp.mat33, V: wp.mat33, s: wp.vec3, mu: float, lam: float, alpha: float) -> wp.mat33:
    """Drucker–Prager return map (Klár et al. 2016)."""
    e = wp.vec3(wp.log(s[0]), wp.log(s[1]), wp.log(s[2]))
    tr = e[0] + e[1] + e[2]
    d = e - wp.vec3(tr / 3.0, tr / 3.0, tr / 3.0)
    n = wp.length(d)
    if tr >= 0.0 or n == 0.0:
        return U * wp.transpose(V)
    excess = n + (3.0 * lam + 2.0 * mu) / (2.0 * mu) * tr * alpha
    if excess <= 0.0:
        return F
    e = e - (excess / n) * d
    return U * wp.diag(wp.vec3(wp.exp(e[0]), wp.exp(e[1]), wp.exp(e[2]))) * wp.transpose(V)


@wp.func
def hencky(U: wp.mat33, V: wp.mat33, s: wp.vec3, mu: float, lam: float) -> wp.mat33:
    """Kirchhoff stress of the St. Venant–Kirchhoff law in logarithmic strain."""
    e = wp.vec3(wp.log(s[0]), wp.log(s[1]), wp.log(s[2]))
    tr = lam * (e[0] + e[1] + e[2])
    return U * wp.diag(2.0 * mu * e + wp.vec3(tr, tr, tr)) * wp.transpose(U)


@wp.kernel(enable_backward=False)
def stresses(
    material: wp.array[int], mu: wp.array[float], lam: wp.array[float], strength: wp.array[float],
    F_trial: wp.array[wp.mat33], F_out: wp.array[wp.mat33], stress: wp.array[wp.mat33],
):  # fmt: skip
    p = wp.tid()
    F = F_trial[p]
    U, s, V = wp.svd3(F)
    if material[p] == 1:
        F = von_mises(F, U, V, s, mu[p], strength[p])
        U, s, V = wp.svd3(F)
    if material[p] == 2:
        F = sand(F, U, V, s, mu[p], lam[p], strength[p])
        U, s, V = wp.svd3(F)
    J = wp.determinant(F)
    tau = wp.mat33()
    if material[p] == 0:
        R = U * wp.transpose(V)
        tau = 2.0 * mu[p] * (F - R) * wp.transpose(F) + wp.identity(n=3, dtype=float) * lam[p] * J * (J - 1.0)
    if material[p] == 1 or material[p] == 2:
        tau = hencky(U, V, s, mu[p], lam[p])
    F_out[p] = F
    stress[p] = 0.5 * (tau + wp.transpose(tau))


@wp.func
def splines(f: wp.vec3):
    """Columns: weights of the three nodes along an axis, and their derivatives per cell."""
    a, b, c = wp.vec3(1.5) - f, f - wp.vec3(1.0), f - wp.vec3(0.5)
    w = wp.matrix_from_cols(0.5 * wp.cw_mul(a, a), wp.vec3(0.75) - wp.cw_mul(b, b), 0.5 * wp.cw_mul(c, c))
    return w, wp.matrix_from_cols(f - wp.vec3(1.5), -2.0 * (f - wp.vec3(1.0)), f - wp.vec3(0.5))


@wp.func
def slope(w: wp.mat33, dw: wp.mat33, i: int, j: int, k: int, idx: float) -> wp.vec3:
    return idx * wp.vec3(dw[0, i] * w[1, j] * w[2, k], w[0, i] * dw[1, j] * w[2, k], w[0, i] * w[1, j] * dw[2, k])


@wp.kernel(enable_backward=False)
def scatter(
    x: wp.array[wp.vec3], v: wp.array[wp.vec3], C: wp.array[wp.mat33], stress: wp.array[wp.mat33],
    mass: wp.array[float], vol: wp.array[float], dx: float, dt: float,
    grid_m: wp.array3d[float], grid_mv: wp.array3d[wp.vec3],
):  # fmt: skip
    p = wp.tid()
    idx = 1.0 / dx
    g = x[p] * idx
    bx, by, bz = wp.int(g[0] - 0.5), wp.int(g[1] - 0.5), wp.int(g[2] - 0.5)
    f = g - wp.vec3(wp.float(bx), wp.float(by), wp.float(bz))
    w, dw = splines(f)
    for i in range(0, 3):
        for j in range(0, 3):
            for k in range(0, 3):
                d = (wp.vec3(wp.float(i), wp.float(j), wp.float(k)) - f) * dx
                weight = w[0, i] * w[1, j] * w[2, k]
                force = -vol[p] * stress[p] * slope(w, dw, i, j, k, idx)
                wp.atomic_add(grid_mv, bx + i, by + j, bz + k, weight * mass[p] * (v[p] + C[p] * d) + dt * force)
                wp.atomic_add(grid_m, bx + i, by + j, bz + k, weight * mass[p])


@wp.kernel(enable_backward=False)
def normalise(
    grid_m: wp.array3d[float], grid_mv: wp.array3d[wp.vec3], grid_v: wp.array3d[wp.vec3], dt: float, gravity: wp.vec3
):
    i, j, k = wp.tid()
    if grid_m[i, j, k] > 1.0e-15:
        grid_v[i, j, k] = grid_mv[i, j, k] / grid_m[i, j, k] + dt * gravity


@wp.kernel(enable_backward=False)
def gather(
    x: wp.array[wp.vec3], v: wp.array[wp.vec3], C: wp.array[wp.mat33], F: wp.array[wp.mat33],
    F_trial: wp.array[wp.mat33], grid_v: wp.array3d[wp.vec3], dx: float, dt: float,
):  # fmt: skip
    p = wp.tid()
    idx = 1.0 / dx
    g = x[p] * idx
    bx, by, bz = wp.int(g[0] - 0.5), wp.int(g[1] - 0.5), wp.int(g[2] - 0.5)
    f = g - wp.vec3(wp.float(bx), wp.float(by), wp.float(bz))
    w, dw = splines(f)
    v_p, C_p, L = wp.vec3(), wp.mat33(), wp.mat33()
    for i in range(0, 3):
        for j in range(0, 3):
            for k in range(0, 3):
                d = wp.vec3(wp.float(i), wp.float(j), wp.float(k)) - f
                weight = w[0, i] * w[1, j] * w[2, k]
                v_i = grid_v[bx + i, by + j, bz + k]
                v_p += weight * v_i
                C_p += (4.0 * idx * weight) * wp.outer(v_i, d)
                L += wp.outer(v_i, slope(w, dw, i, j, k, idx))
    v[p] = v_p
    x[p] = x[p] + dt * v_p
    C[p] = C_p
    F_trial[p] = (wp.identity(n=3, dtype=float) + L * dt) * F[p]


class Peer:
    """The stand-in on the particles of a body."""

    def __init__(self, b: Body):
        n, grid, s, m = b.particles, b.span.grid, b.state, b.matter
        size = s.x.amax(0) - s.x.amin(0)
        self.nodes = int(2 * float(size.max()) / grid.dx) + 1  # a cube of twice the body
        centre = 0.5 * (s.x.amax(0) + s.x.amin(0))
        self.shift = torch.round(0.5 * self.nodes - centre / grid.dx) * grid.dx
        E, nu = m.theta[:, 0], m.theta[:, 1]
        floats = [E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu)), torch.full_like(E, 1e3)]
        self.law = [wp.from_torch(torch.zeros(n, dtype=torch.int32)), *(wp.from_torch(t) for t in floats)]
        self.x, self.v = (wp.from_torch((t + o).contiguous(), dtype=wp.vec3) for t, o in ((s.x, self.shift), (s.v, 0)))
        self.C = wp.from_torch(s.C.clone(), dtype=wp.mat33)
        self.F, self.F_trial, self.stress = (
            wp.from_torch(s.F.clone().contiguous(), dtype=wp.mat33) for _ in range(3)
        )  # fmt: skip
        self.moving = (self.x, self.v, self.C, self.F, self.F_trial)
        self.first = [wp.clone(a) for a in self.moving]
        self.m, self.vol = wp.from_torch(m.m), wp.from_torch(m.vol)
        shape = (self.nodes,) * 3
        self.grid_m = wp.zeros(shape, dtype=float, device="cpu")
        self.grid_mv, self.grid_v = (wp.zeros(shape, dtype=wp.vec3, device="cpu") for _ in range(2))
        self.dx, self.dt, self.gravity = grid.dx, b.span.dt, wp.vec3(*b.solver.gravity)

    def forward(self) -> float:
        """Processor time of ``N_SUB`` substeps from the beginning [s]."""
        for array, first in zip(self.moving, self.first, strict=True):
            array.assign(first)
        begin = time.process_time()
        for _ in range(N_SUB):
            self.substep()
        return time.process_time() - begin

    def substep(self) -> None:
        """Five launches."""
        n, cube = len(self.x), (self.nodes,) * 3
        wp.launch(clear, cube, inputs=[self.grid_m, self.grid_mv, self.grid_v], device="cpu")
        wp.launch(stresses, n, inputs=[*self.law, self.F_trial, self.F, self.stress], device="cpu")
        wp.launch(
            scatter, n, inputs=[
                self.x, self.v, self.C, self.stress, self.m, self.vol, self.dx, self.dt, self.grid_m, self.grid_mv,
            ], device="cpu",
        )  # fmt: skip
        wp.launch(
            normalise, cube, inputs=[self.grid_m, self.grid_mv, self.grid_v, self.dt, self.gravity], device="cpu"
        )  # fmt: skip
        wp.launch(
            gather, n, inputs=[self.x, self.v, self.C, self.F, self.F_trial, self.grid_v, self.dx, self.dt],
            device="cpu",
        )  # fmt: skip


def agreement(n: int) -> float:
    """Largest distance between the stand-in and plain APIC after ``N_SUB`` substeps, relative to the longest way of a
    particle."""
    b = body(CASE, Scheme.apic(), n, torch.float32, grad=False)
    peer = Peer(b)
    peer.forward()
    end, *_ = b.solver.advance(b.state, b.matter, b.span)
    x = wp.to_torch(peer.x) - peer.shift
    return float((x - end.x).norm(dim=1).max() / (end.x - b.state.x).norm(dim=1).max())


def measure(n: int, repeat: int) -> dict[str, float | int]:
    """Throughput of both, and the median of the ratios of neighbours in time."""
    ours = {name: body(CASE, s, n, torch.float32, grad=False) for name, s in SCHEMES.items()}
    peer = Peer(ours["mls"])
    times: dict[str, list[float]] = {"peer": [], **{name: [] for name in ours}}
    for turn in range(repeat + 1):
        for name, b in (("peer", peer), *ours.items()):
            t = b.forward()
            times[name] += [t] if turn else []  # the first turn compiles
    row: dict[str, float | int] = {"particles": n, "agreement": agreement(n)}
    for name, t in times.items():
        row[f"{name}_M_per_s"] = round(n * N_SUB / min(t) / 1e6, 2)
    for name in ours:
        row[f"{name}_over_peer"] = round(
            statistics.median(a / b for a, b in zip(times["peer"], times[name], strict=True)), 2
        )
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--particles", type=int, nargs="+", default=[1000, 20000, 100000])
    parser.add_argument("--repeat", type=int, default=9)
    parser.add_argument("--out", type=Path, default=Path(__file__).resolve().parents[1] / "docs" / "benchmarks")
    options = parser.parse_args()
    torch.set_num_threads(1)
    wp.init()
    rows = []
    for n in options.particles:
        rows.append(measure(n, options.repeat))
        print(json.dumps(rows[-1]), flush=True)
    machine = describe()
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "peers.json").write_text(json.dumps({"machine": machine, "rows": rows}, indent=1))
    (options.out / "peers.md").write_text(page(machine, rows))


def page(machine: str, rows: list[dict]) -> str:
    """The rows as a page."""
    text = f"# Against the usual formulation\n\n{machine}; fixed corotated, float32, process time. Throughput: best of "
    text += "several [M particle-substeps/s]; ratios: median of neighbours in time.\n\n"
    text += "| particles | usual | default scheme | plain MLS | default / usual | MLS / usual |\n"
    text += "|---|---|---|---|---|---|\n"
    for r in rows:
        text += f"| {r['particles']} | {r['peer_M_per_s']} | {r['default_M_per_s']} | {r['mls_M_per_s']} "
        text += f"| {r['default_over_peer']} | {r['mls_over_peer']} |\n"
    return text


if __name__ == "__main__":
    main()
