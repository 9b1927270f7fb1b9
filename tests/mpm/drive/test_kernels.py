"""Drives on free particles: totals, decays and rigid motions in closed form, and adjoints."""

import math
from functools import lru_cache

import numpy as np
import pytest
import torch
import warp as wp

from diffuphy.mpm import (
    Acceleration,
    Attractor,
    Drag,
    Grid,
    Held,
    Impulse,
    InBall,
    InBox,
    Release,
    Schedule,
    Vortex,
)
from diffuphy.mpm.boundary.motion import rotation_matrix
from diffuphy.mpm.drive import TICK, drive_rows, drive_signature, make_drives, speed_bound, tags

GRID = Grid(0.5, (-2, -4, 0), (8, 8, 8))
LOW = np.array([-1.0, -2.0, 0.0])
"""Its lowest node."""


@lru_cache
def _kernels(signature, real):
    d = make_drives(signature, real)
    accelerate, accelerate_adjoint, hold, hold_adjoint = d.accelerate, d.accelerate_adjoint, d.hold, d.hold_adjoint
    drive_t, vec3, mat33 = d.drive_t, wp.types.vector(3, real), wp.types.matrix((3, 3), real)

    @wp.kernel(module="unique", enable_backward=False)
    def drift(
        tag: wp.array[wp.int32], row: wp.array2d[drive_t], dts: wp.array[real], low: vec3,
        x: wp.array2d[vec3], v: wp.array2d[vec3], C: wp.array2d[mat33],
    ):  # fmt: skip
        """Free flight: state s + 1 from state s."""
        p = wp.tid()
        for s in range(dts.shape[0]):
            r = x[s, p] - low
            v_p, C_p = hold(r, v[s, p], C[s, p], tag[p], row, s)
            v_p += dts[s] * accelerate(r, v_p, tag[p], row, s)
            v_p, C_p = hold(r, v_p, C_p, tag[p], row, s)
            x[s + 1, p] = x[s, p] + dts[s] * v_p
            v[s + 1, p] = v_p
            C[s + 1, p] = C_p

    @wp.kernel(module="unique", enable_backward=False)
    def adjoints(
        tag: wp.array[wp.int32], row: wp.array2d[drive_t], low: vec3,
        x: wp.array[vec3], v: wp.array[vec3], C: wp.array[mat33], v_bar: wp.array[vec3], C_bar: wp.array[mat33],
        b: wp.array[vec3], held_v: wp.array[vec3], held_C: wp.array[mat33],
        r_b: wp.array[vec3], v_b: wp.array[vec3], r_h: wp.array[vec3], v_h: wp.array[vec3], C_h: wp.array[mat33],
    ):  # fmt: skip
        p = wp.tid()
        r = x[p] - low
        b[p] = accelerate(r, v[p], tag[p], row, 0)
        a0, a1 = accelerate_adjoint(r, v[p], tag[p], row, 0, v_bar[p])
        r_b[p] = a0
        v_b[p] = a1
        c0, c1 = hold(r, v[p], C[p], tag[p], row, 0)
        held_v[p] = c0
        held_C[p] = c1
        h0, h1, h2 = hold_adjoint(r, v[p], C[p], tag[p], row, 0, v_bar[p], C_bar[p])
        r_h[p] = h0
        v_h[p] = h1
        C_h[p] = h2

    return drift, adjoints, drive_t, vec3, mat33


def fly(drives, x, v, starts, dts, *, m=None, C=None, tag=None, real=wp.float64):
    """x, v, C of free particles before and after each substep, shape (steps + 1, N, …)."""
    drift, _, drive_t, vec3, mat33 = _kernels(drive_signature(drives), real)
    dts = np.broadcast_to(dts, starts.shape)
    m = torch.ones(len(x), dtype=torch.float64) if m is None else m
    tag = tags(drives, torch.as_tensor(x), m, 1.0) if tag is None else tag
    states = []
    for first, shape, dtype in ((x, (3,), vec3), (v, (3,), vec3), (C, (3, 3), mat33)):
        a = np.zeros((len(starts) + 1, len(x), *shape))
        a[0] = 0.0 if first is None else first
        states.append(wp.array(a, dtype=dtype, device="cpu"))
    row = drive_rows(drives, GRID, starts, dts, m, tag)
    inputs = [
        wp.array(tag.numpy(), dtype=wp.int32, device="cpu"),
        wp.array(row, dtype=drive_t, device="cpu"),
        wp.array(dts, dtype=real, device="cpu"),
        vec3(*LOW),
        *states,
    ]
    wp.launch(drift, dim=len(x), inputs=inputs, device="cpu")
    return tuple(a.numpy() for a in states)


def uneven(end: float, steps: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Substeps of uneven length from 0 to ``end``."""
    dts = np.random.default_rng(seed).uniform(0.5, 1.5, steps)
    dts *= end / dts.sum()
    return np.cumsum(dts) - dts, dts


def cloud(n: int = 40) -> tuple[np.ndarray, np.ndarray, torch.Tensor]:
    """Positions in ±1 m, velocities, masses."""
    rng = np.random.default_rng(5)
    return rng.uniform(-1, 1, (n, 3)), rng.normal(size=(n, 3)), torch.tensor(rng.uniform(0.1, 2.0, n))


HIT = Impulse(impulse=(3.0, -1.0, 0.5), start=0.123, duration=0.2, where=InBox(low=(-1, -1, -1), high=(0.2, 1, 1)))


@pytest.mark.parametrize("steps", [1, 3, 17, 400])
def test_an_impulse_has_its_total_whatever_the_substeps(steps):
    """Σ m Δv = J over uneven substeps that cut its ends, in two frames, shared by mass among the selected alone."""
    x, v, m = cloud()
    starts, dts = uneven(0.7, 2 * steps)
    tag = tags((HIT,), torch.tensor(x), m, 1.0)
    x1, v1, _ = (a[-1] for a in fly((HIT,), x, v, starts[:steps], dts[:steps], m=m, tag=tag))
    v2 = fly((HIT,), x1, v1, starts[steps:], dts[steps:], m=m, tag=tag)[1][-1]
    total = (m.numpy()[:, None] * (v2 - v)).sum(0)
    # rounding of 40 momenta of size 2 in each of 800 substeps, and of the edge of the frames, 1e-16/duration
    np.testing.assert_allclose(total, HIT.impulse, rtol=0, atol=1e-12)
    chosen = x[:, 0] <= 0.2
    assert np.array_equal(v2[~chosen], v[~chosen])
    share = np.outer(np.ones(int(chosen.sum())), HIT.impulse) / m.numpy()[chosen].sum()
    np.testing.assert_allclose(v2[chosen] - v[chosen], share, rtol=0, atol=1e-12)


def test_an_acceleration_acts_for_its_time_in_its_region():
    """Δv = b (end − start) to rounding, where the particle is inside; one that never enters keeps its velocity."""
    b = (1.0, 2.0, -3.0)
    push = Acceleration(acceleration=b, start=0.1234, end=0.5678, region=InBox(low=(-9, -9, 0), high=(9, 9, 9)))
    ball = Acceleration(acceleration=b, region=InBall(center=(0.0, 0.0, 5.0), radius=1.0))
    x = np.array([[0.0, 0.0, 5.5], [0.0, 0.0, -0.1], [0.0, 0.0, 6.5]])
    v = np.zeros((3, 3))
    v_push = fly((push,), x, v, *uneven(0.7, 50))[1][-1]
    np.testing.assert_allclose(v_push[[0, 2]], np.outer([1, 1], np.asarray(b) * (0.5678 - 0.1234)), rtol=1e-13)
    assert not v_push[1].any()
    v_ball = fly((ball,), x, v, np.zeros(1), 1e-3)[1][-1]
    np.testing.assert_allclose(v_ball, np.outer([1, 0, 0], b) * 1e-3, rtol=1e-14)


def test_fields_follow_their_formulas():
    """Attractor −(A/s) d (1 + |d|²/s²)^(−(p+1)/2), vortex (A/s) a × d (1 + |d⊥|²/s²)^(−(p+1)/2); two add up."""
    x, v, _ = cloud()
    pull = Attractor(center=(0.3, 0.1, -0.2), strength=2.0, radius=0.4, falloff=1.5)
    swirl = Vortex(center=(-0.2, 0.0, 0.5), axis=(1.0, 2.0, 2.0), strength=-1.5, radius=0.3, falloff=0.5)
    dv = (fly((pull, swirl), x, v, np.zeros(1), 1e-2)[1][-1] - v) / 1e-2
    d, e, a = x - pull.center, x - swirl.center, np.array([1.0, 2.0, 2.0]) / 3
    perp = e - (e @ a)[:, None] * a
    want = -2.0 / 0.4 * d * (1 + (d * d).sum(1, keepdims=True) / 0.16) ** -1.25
    want += -1.5 / 0.3 * np.cross(a, e) * (1 + (perp * perp).sum(1, keepdims=True) / 0.09) ** -0.75
    np.testing.assert_allclose(dv, want, rtol=0, atol=1e-12)


@pytest.mark.parametrize("steps", [1, 100])
@pytest.mark.parametrize("tau, q", [(0.2, 0.0), (math.inf, 0.7), (0.2, 0.7)])
def test_drag_decays_as_its_differential_equation_whatever_the_substeps(steps, tau, q):
    """du/dt = −u/τ − q |u| u:  |u| = u₀ E/(1 + q u₀ τ (1 − E)), E = exp(−t/τ); direction kept. Also for t ≫ τ."""
    x, v, _ = cloud()
    wind = np.array([0.5, -1.0, 0.2])
    drag = Drag(velocity=tuple(wind), time=tau, quadratic=q, start=0.1, end=3.1)
    got = fly((drag,), x, v, *uneven(4.0, steps))[1][-1] - wind
    u, E = v - wind, math.exp(-3.0 / tau)
    kappa = 3.0 if tau == math.inf else tau * (1 - E)
    want = u * E / (1 + q * kappa * np.linalg.norm(u, axis=1, keepdims=True))
    # one substep loses its digits where u decays from 1 to 1e-7: rounding of v, 1e-16 a substep
    np.testing.assert_allclose(got, want, rtol=1e-13, atol=1e-15 * steps)


TURN = Schedule(
    times=(0.0, 0.5, 1.0),
    offsets=((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.0)),
    rotations=((0.0, 0.0, 0.0), (0.3, 1.0, 0.0), (2.0, 0.0, 7.0)),
)


@pytest.mark.parametrize(
    "held",
    [
        Held(center=(0.1, 0.2, 0.3), velocity=(0.5, 0.0, -0.2), angular_velocity=(1.0, -2.0, 8.0)),
        Held(center=(0.1, 0.2, 0.3), schedule=TURN),
    ],
    ids=["constant", "schedule"],
)
def test_held_particles_move_as_a_rigid_body_exactly(held):
    """x = c(t) + R(t) (x₀ − c₀) and F = Π (1 + Δt C) = R(t), whatever else accelerates them; 300 uneven substeps."""
    x, v, _ = cloud()
    starts, dts = uneven(1.0, 300)
    xs, _, Cs = fly((held, Acceleration(acceleration=(0.0, 0.0, -9.8))), x, v, starts, dts)
    turn = (2.0, 0.0, 7.0) if held.schedule else (1.0, -2.0, 8.0)
    shift = (1.0, 1.0, 0.0) if held.schedule else held.velocity
    R, c = rotation_matrix(np.asarray(turn)), np.asarray(held.center)
    # 300 roundings of coordinates of size 3, and of 1 + Δt C
    np.testing.assert_allclose(xs[-1], c + shift + (x - c) @ R.T, rtol=0, atol=1e-13 * 3)
    F = np.eye(3)
    for C, dt in zip(Cs[1:, 0], dts, strict=True):
        F = F + dt * C @ F
    np.testing.assert_allclose(F, R, rtol=0, atol=1e-13 * 3)


def test_a_held_translation_is_the_prescribed_velocity_bit_for_bit():
    """v = V and C = 0 from start to end, to the substep; free before and after."""
    held = Held(velocity=(0.1, 0.2, -0.3), start=0.2, end=0.5)
    x, v, _ = cloud()
    starts = 1e-2 * np.arange(100)
    _, vs, Cs = fly((held,), x, v, starts, 1e-2)
    on = (starts >= 0.2) & (starts < 0.5)
    assert on.sum() == 30
    assert (vs[1:][on] == np.array(held.velocity)).all() and not Cs[1:][on].any()
    assert np.array_equal(vs[np.argmax(on)], v) and (vs[-1] == np.array(held.velocity)).all()


def test_release_lets_each_particle_go_when_the_plane_is_there():
    """t_p = start + n·(x₀ − point)/speed, to a TICK and a substep; then it falls from rest, even ahead of the plane."""
    gate = Release(
        point=(0.0, 0.0, -0.5),
        normal=(0.0, 0.0, -2.0),
        speed=0.25,
        start=0.1,
        where=InBox(low=(-1, -1, -1), high=(1, 1, 0.5)),
    )
    x, v, _ = cloud()
    dt, n = 1e-3, 4000
    starts = dt * np.arange(n)
    xs, vs, _ = fly((gate, Acceleration(acceleration=(0.0, 0.0, -9.8))), x, v, starts, dt)
    chosen = x[:, 2] <= 0.5
    free = 0.1 + np.maximum(0, -(x[:, 2] + 0.5)) / 0.25
    for p in np.flatnonzero(chosen):
        first = int(np.argmax((xs[1:, p] != x[p]).any(1)))
        assert free[p] <= starts[first] < free[p] + TICK + dt * (1 + 1e-9)
        assert not vs[1 : first + 1, p].any()
        np.testing.assert_allclose(vs[-1, p, 2], -9.8 * dt * (n - first), rtol=1e-11)
    assert (vs[1, ~chosen] - v[~chosen])[:, 2] == pytest.approx(-9.8 * dt, rel=1e-10)
    single = fly((gate, Acceleration(acceleration=(0.0, 0.0, -9.8))), x, v, starts, dt, real=wp.float32)[1]
    # the row of a substep within rounding of a TICK may differ
    assert (np.abs((single != 0).any(2).sum(0) - (vs != 0).any(2).sum(0)) <= 1).all()


ALL = (
    HIT,
    Acceleration(acceleration=(1.0, 0.0, 2.0), region=InBall(center=(0.0, 0.0, 0.0), radius=1.1)),
    Attractor(center=(0.3, 0.1, -0.2), strength=2.0, radius=0.4, falloff=1.5, where=(0, 3, 5, 6, 7, 30, 31, 32)),
    Held(center=(0.1, 0.2, 0.3), velocity=(0.5, 0.0, -0.2), angular_velocity=(1.0, -2.0, 8.0), where=(1, 2, 3, 9, 11)),
    Vortex(
        center=(-0.2, 0.0, 0.5),
        strength=-1.5,
        radius=0.3,
        falloff=0.5,
        region=InBox(low=(-2, -2, -2), high=(0.9, 0.9, 0.9)),
    ),
    Drag(velocity=(0.5, -1.0, 0.2), time=0.05, quadratic=3.0),
    Release(point=(0.0, 0.0, 0.0), normal=(0.0, 0.0, 1.0), speed=0.1, where=InBall(center=(0.5, 0.5, 0.5), radius=0.7)),
)


def evaluate(x, v, C, v_bar, C_bar, tag, row):
    _, adjoints, drive_t, vec3, mat33 = _kernels(drive_signature(ALL), wp.float64)
    out = [wp.zeros(len(x), dtype=t, device="cpu") for t in (vec3, vec3, mat33, vec3, vec3, vec3, vec3, mat33)]
    given = ((x, vec3), (v, vec3), (C, mat33), (v_bar, vec3), (C_bar, mat33))
    inputs = [
        wp.array(tag.numpy(), dtype=wp.int32, device="cpu"),
        wp.array(row, dtype=drive_t, device="cpu"),
        vec3(*LOW),
        *(wp.array(a, dtype=t, device="cpu") for a, t in given),
        *out,
    ]
    wp.launch(adjoints, dim=len(x), inputs=inputs, device="cpu")
    return [a.numpy() for a in out]


def test_adjoints_are_those_of_accelerations_and_holds():
    """All seven drives at once, each particle its own few: r̄·δr + v̄·δv + C̄:δC against central differences of 1e-5."""
    rng = np.random.default_rng(8)
    x, v, m = cloud()
    C, v_bar, C_bar = rng.normal(size=(40, 3, 3)), rng.normal(size=(40, 3)), rng.normal(size=(40, 3, 3))
    dx, dv, dC = rng.normal(size=x.shape), rng.normal(size=v.shape), rng.normal(size=C.shape)
    tag = tags(ALL, torch.tensor(x), m, 1.0)
    row = drive_rows(ALL, GRID, np.array([0.2]), 1e-2, m, tag)
    *_, r_b, v_b, r_h, v_h, C_h = evaluate(x, v, C, v_bar, C_bar, tag, row)
    h = 1e-5
    ends = [evaluate(x + a * dx, v + a * dv, C + a * dC, v_bar, C_bar, tag, row)[:3] for a in (h, -h)]
    rates = [(up - down) / (2 * h) for up, down in zip(*ends, strict=True)]
    # accelerations of size 10 and third derivatives up to 1e3: h² 1e3/6, and rounding 1e-15/h
    want = (v_bar * rates[0]).sum(1)
    np.testing.assert_allclose((r_b * dx).sum(1) + (v_b * dv).sum(1), want, rtol=1e-8, atol=2e-8)
    want = (v_bar * rates[1]).sum(1) + (C_bar * rates[2]).sum((1, 2))
    np.testing.assert_allclose(
        (r_h * dx).sum(1) + (v_h * dv).sum(1) + (C_h * dC).sum((1, 2)), want, rtol=1e-8, atol=2e-8
    )
    held, waiting = (v_h == 0).all(1), (tag.numpy() >> 7) * TICK > 0.2
    assert 5 <= held.sum() < 35 and waiting.sum() >= 3 and held[waiting].all()


@pytest.mark.parametrize("k", [*range(6), None], ids=lambda k: "all" if k is None else type(ALL[k]).__name__)
def test_the_speed_bound_holds_and_is_not_wasteful(k):
    """max |v(t)| ≤ max |v(0)| + bound; from rest each drive alone reaches a fifth of it somewhere in the box."""
    some = [d for d in ALL if not isinstance(d, Release)]
    drives = tuple(some if k is None else some[k : k + 1])
    m = torch.full((40,), 0.1, dtype=torch.float64)
    x, v, _ = cloud()
    tag = tags(drives, torch.tensor(x), m, 1.0)
    for v0 in (v, np.zeros_like(v)):
        xs, vs, _ = fly(drives, x, v0, 1e-3 * np.arange(300), 1e-3, m=m, tag=tag)
        bound = speed_bound(drives, m, tag, xs.min((0, 1)), xs.max((0, 1)), 0.0, 0.3)
        fastest = np.linalg.norm(vs, axis=2).max()
        assert fastest <= np.linalg.norm(v0, axis=1).max() + bound * (1 + 1e-12)
    assert k is None or fastest > 0.2 * bound


def test_absent_drives_leave_no_code():
    """What only accelerates holds with the function of no drives, and the other way round; that one is the identity."""
    none, pushes, holds = (make_drives(drive_signature(d), wp.float64) for d in ((), ALL[:2], (ALL[3],)))
    assert pushes.hold is none.hold and pushes.hold_adjoint is none.hold_adjoint and not pushes.holds
    assert holds.accelerate is none.accelerate and holds.accelerate_adjoint is none.accelerate_adjoint
    assert not holds.accelerates and pushes.accelerates and holds.holds and not none.accelerates and not none.holds
    x, v, _ = cloud()
    xs, vs, _ = fly((), x, v, np.zeros(1), 0.5)
    assert np.array_equal(vs[1], v) and np.array_equal(xs[1], x + 0.5 * v)


def test_drives_compile_for_cuda(tmp_path):
    """All kinds, forward and backward, to PTX; it needs no device."""
    kernel = _kernels(drive_signature(ALL), wp.float32)[1]
    wp.compile_aot_module(kernel.module, arch=80, module_dir=tmp_path, use_ptx=True)
    assert len(list(tmp_path.glob("*.ptx"))) == 1
