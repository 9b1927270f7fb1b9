"""Elastic contact: what matter that just touches a wall looks like, the law of one node, its adjoint, and bounces."""

import dataclasses
import math

import numpy as np
import pytest
import torch
import warp as wp

from diffuphy.mpm import HalfSpace, Scene, Scheme, Sphere, simulate
from diffuphy.mpm.boundary import DAMPING, can_be_elastic, container, rows
from diffuphy.mpm.boundary.kernels_elastic import make_filled
from diffuphy.mpm.boundary.layout import FRICTION, HARD
from diffuphy.mpm.substep.spline import make_spline
from tests.mpm.bodies import block, field
from tests.mpm.walls import HERE, elastic_contact

FLOOR = HalfSpace(friction=0.4, velocity=(0.1, 0.0, 0.0))
OMEGA, KICK = 50.0, 4e-3


@pytest.mark.parametrize("order", [2, 3])
def test_matter_that_touches_has_the_mean_distance_of_a_filled_half_space(order):
    """X(φ_i) = ∫_{z>0} w(z − φ_i) z dz / ∫_{z>0} w(z − φ_i) dz, by quadrature of the spline itself."""
    filled, weights = make_filled(wp.float64, order), make_spline(wp.float64, order).weights
    phi = np.linspace(-0.5 * (order + 1) + 1e-3, 0.5, 41)
    z = (np.arange(40000) + 0.5) * 1e-4
    half = 0.5 * (order - 1)

    @wp.kernel(module="unique")
    def evaluate(
        phi: wp.array[wp.float64], X: wp.array[wp.float64], f: wp.array[wp.float64], w: wp.array2d[wp.float64]
    ):
        p = wp.tid()
        X[p] = filled(phi[p])
        w_p = weights(f[p])
        for k in range(wp.static(order + 1)):
            w[p, k] = w_p[k]

    f = half + (np.arange(len(phi)) + 0.5) / len(phi)
    out, w = wp.zeros(len(phi), dtype=wp.float64), wp.zeros((len(phi), order + 1), dtype=wp.float64)
    wp.launch(
        evaluate,
        len(phi),
        inputs=[wp.array(phi, dtype=wp.float64), out, wp.array(f, dtype=wp.float64), w],
        device="cpu",
    )
    y = (f[:, None] - np.arange(order + 1)).ravel()  # the spline as a function of distance, from its own values
    order_of = np.argsort(y)
    spline = lambda a: np.interp(a, y[order_of], w.numpy().ravel()[order_of], left=0.0, right=0.0)  # noqa: E731
    for value, place in zip(out.numpy(), phi, strict=True):
        weight = spline(z - place)
        # linear interpolation of 120 points errs by 1e-4 of the weight, which a thin tail divides by itself
        if weight.sum() * 1e-4 > 1e-2:
            assert value == pytest.approx(float((weight * z).sum() / weight.sum()), abs=2e-3)


def nodes(n: int, seed: int = 0):
    """Random nodes about a floor at z = 2 of a block with Δx = 1, and matter that lies too deep for most of them."""
    rng = np.random.default_rng(seed)
    r = np.column_stack([rng.uniform(0, 3, (n, 2)), rng.uniform(2 - 1.9, 2.6, n)])
    e = np.column_stack([rng.uniform(-0.2, 0.6, n), *(np.full(n, a) for a in (KICK * OMEGA**2, 0.6 * KICK * OMEGA, 1))])
    return rng.normal(size=(n, 3)), r, e


def test_the_law_of_a_node():
    """u_n ← u_n + p, u_t ← u_t max(0, 1 − μ p/|u_t|), p = r max(k ω² (X − x̄) Δx − 2 ζ k ω u_n, 0) and deep nodes
    at least −u_n."""
    wall = dataclasses.replace(FLOOR, point=(0.0, 0.0, 2.0))
    v, r, e = nodes(400)
    row = rows([wall], HERE, np.zeros(1), elastic=True)
    o, *_ = elastic_contact([wall], v, r, e, np.zeros(len(v), int), row)
    d = r[:, 2] - 2.0 - 1e-3  # SLACK
    s = -d
    M = np.where(s < 0.5, 0.5 - 0.75 * s + s**3 / 3, np.maximum(1.5 - s, 0) ** 3 / 6)
    Q = np.where(s < 0.5, 13 / 64 - 0.5 * s + 0.375 * s**2 - s**4 / 12, np.maximum(1.5 - s, 0) ** 4 / 24)
    gap = np.where(s < 1.5, Q / np.maximum(M, 1e-300), 0.0) - e[:, 0]
    ramp = np.clip(1 - d / 0.5, 0, 1)
    u = v - np.array(wall.velocity)
    push = np.where((gap > 0) & (d < 0.5), ramp * (e[:, 1] * gap - e[:, 2] * u[:, 2]), 0.0)
    push = np.maximum(np.where(d <= -HARD, np.maximum(push, -u[:, 2]), push), 0.0)
    length = np.hypot(u[:, 0], u[:, 1])
    slide = np.where(push > 0, np.maximum(0, 1 - 0.4 * push / length), 1.0)
    expected = np.column_stack([u[:, 0] * slide, u[:, 1] * slide, u[:, 2] + push]) + np.array(wall.velocity)
    assert 0.2 < (push > 0).mean() < 0.9 and (slide == 0).any()
    np.testing.assert_allclose(o, expected, atol=1e-12)


def test_its_adjoint_is_that_of_central_differences():
    """In v, x̄, k ω², 2 ζ k ω and μ, floor and ball together; nodes within 1e-3 of a kink are left out."""
    walls = [
        dataclasses.replace(FLOOR, point=(0.0, 0.0, 2.0)),
        Sphere(center=(1.5, 1.5, 3.2), radius=1.0, friction=0.2, velocity=(0.0, 0.2, 0.0)),
    ]
    v, r, e = nodes(300, 1)
    at, row = np.zeros(len(v), int), rows(walls, HERE, np.zeros(1), elastic=True)
    o_bar = np.random.default_rng(2).normal(size=v.shape)
    _, v_bar, e_bar, row_bar = elastic_contact(walls, v, r, e, at, row, o_bar)
    value = lambda v, e, row: (elastic_contact(walls, v, r, e, at, row)[0] * o_bar).sum(1)  # noqa: E731
    h, clean, checks = 1e-6, np.ones(len(v), bool), []
    for kind, base, bar, steps in (("v", v, v_bar, (h,) * 3), ("e", e, e_bar, (h, h, h, 0.0))):
        for k, step in enumerate(steps):
            if step == 0.0:
                continue
            sides = []
            for sign in (1, -1, 2, -2):
                moved = base.copy()
                moved[:, k] += sign * step
                sides.append(value(moved, e, row) if kind == "v" else value(v, moved, row))
            one, two = (sides[0] - sides[1]) / (2 * step), (sides[2] - sides[3]) / (4 * step)
            clean &= np.abs(one - two) < 1e-5 * (1 + np.abs(one))  # no kink between
            checks.append((one, bar[:, k]))
    assert clean.mean() > 0.95 and float(np.abs(e_bar).max()) > 0.1
    for measured, exact in checks:
        np.testing.assert_allclose(measured[clean], exact[clean], rtol=1e-6, atol=1e-6)  # ε |o|/h = 2e-10
    for b in range(2):
        up, down = row.copy(), row.copy()
        up[0, b, FRICTION] += h
        down[0, b, FRICTION] -= h
        measured = (value(v, e, up) - value(v, e, down)).sum() / (2 * h)
        assert row_bar[0, b, FRICTION] == pytest.approx(measured, rel=1e-5)


def test_walls_whose_planes_meet_are_rigid():
    """A node knows its matter's distance from the nearest wall only."""
    floor, plate = HalfSpace(), HalfSpace(point=(0.0, 0.0, 1.0), normal=(0.0, 0.0, -1.0))
    assert can_be_elastic((floor, plate, Sphere())) and not can_be_elastic(container((0, 0, 0), (1, 1, 1)))


def bounce(scheme: Scheme, cfl: float = 0.4):
    """Speed after over speed before, approach over that of Hertz, and lowest particle [Δx] of a ball of four cells'
    radius, E = 1 MPa, at 1 m/s."""
    R, n, E = 0.1, 4, 1e6
    dx = R / n
    x, vol = block((2 * n, 2 * n, 2 * n), dx, (-R, -R, 0.0))
    inside = (x - x.new_tensor([0.0, 0.0, R])).norm(dim=1) < R
    x, vol = x[inside], vol[inside]
    scene = Scene(
        gravity=(0.0, 0.0, 0.0), dx=dx, fps=500.0, frames=40, boundaries=(HalfSpace(),), lift=2 * dx,
        velocity=(0.0, 0.0, -1.0), scheme=scheme, cfl=cfl,
    )  # fmt: skip
    states = list(simulate(scene, x, vol, field(len(x), E=E, nu=0.3)))
    m, star = 4 / 3 * math.pi * R**3 * 1000.0, E / (1 - 0.3**2)
    hertz = (15 * m / (16 * math.sqrt(R) * star)) ** 0.4
    height = torch.stack([s.x[:, 2].mean() for s in states])
    low = torch.stack([s.x[:, 2].min() for s in states])
    return float(states[-1].v[:, 2].mean()), (R - float(height.min())) / hertz, float(low.min()) / dx


def test_a_ball_touches_the_floor_before_it_turns():
    """Hertz: the centre comes d_max nearer than R and the lowest matter reaches the floor, where a rigid plane of nodes
    turns the ball most of a cell above it."""
    e, approach, low = bounce(Scheme(contact="elastic"))
    _, above, high = bounce(Scheme())
    assert 0.85 < e < 1.0 and DAMPING > 0.0
    assert 0.8 < approach < 1.3 and abs(low) < 0.25  # half the spacing of particles
    assert above < -0.8 and high > 0.7
