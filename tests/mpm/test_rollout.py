"""Laws that a rollout must keep, and what it refuses."""

import dataclasses
import itertools
import math
from concurrent.futures import ThreadPoolExecutor

import pytest
import torch
import warp as wp

from diffuphy.material import make_mixture
from diffuphy.mpm import FrameReport, HalfSpace, Scene, Scheme, rollout, simulate
from diffuphy.mpm.diagnostics import diagnose
from diffuphy.mpm.state import make_matter
from diffuphy.types import SimulationDiverged
from tests.mpm.bodies import block, field, rotation

DX = 0.05
FREE = Scene(gravity=(0.0, 0.0, 0.0), dx=DX, fps=50.0, frames=4, boundaries=(), lift=None)
NEO = ("neo_hookean",)


def brick(scene: Scene, **material: float):
    """A brick off the grid lines, turned about two axes, in ``scene``."""
    x, vol = block((3, 2, 4), DX)
    x = (x - x.mean(0)) @ rotation((1.0, 2.0, 0.3), 0.7).T + x.new_tensor([0.013, 0.021, 0.337])
    return scene, x, vol, field(len(x), **material)


@pytest.mark.parametrize("scheme", [Scheme(), Scheme.mls()], ids=["default", "mls"])
def test_free_flight_is_exact(scheme):
    """x = x0 + v0 t + g t²/2 with half a kick at both ends of a frame, else x0 + n Δt v0 + Δt² g n(n+1)/2 for n
    substeps; and F = I. Whatever the grid: the transfer reproduces affine fields."""
    g, v0 = (0.0, -9.81, 0.5), (0.3, 1.1, -0.2)
    reports: list[FrameReport] = []
    scene, x, vol, f = brick(dataclasses.replace(FREE, gravity=g, velocity=v0, scheme=scheme))
    out = rollout(scene, x, vol, f, report=reports)
    expected, v = x, x.new_tensor(v0)
    for r in reports:
        n, dt = r.n_sub, r.dt
        late = 0.0 if scheme.half_kick else 0.5 * n * dt * dt  # of the whole first kick
        expected = expected + n * dt * v + (0.5 * (n * dt) ** 2 + late) * x.new_tensor(g)
        v = v + n * dt * x.new_tensor(g)
    # sums of 27 weights, each rounded, over about 40 substeps: 40 · 27 · 1.1e-16 · 1 m
    torch.testing.assert_close(out.x[-1], expected, rtol=0, atol=1e-12)
    torch.testing.assert_close(out.v[-1], v.expand_as(x), rtol=0, atol=1e-12)
    torch.testing.assert_close(out.F[-1], torch.eye(3, dtype=x.dtype).expand(len(x), 3, 3), rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("plastic", "scheme"),
    [(("identity",), Scheme()), (("identity",), Scheme.mls()), (("von_mises",), Scheme())],
    ids=["elastic", "elastic-mls", "plastic"],
)
def test_mass_momentum_and_angular_momentum_are_conserved(plastic, scheme):
    """Σ m, Σ m v and Σ m (x × v + D ε:C) change by nothing but rounding while a brick spins, vibrates and flows."""
    elastic = NEO if plastic == ("identity",) else ("hencky",)
    scene, x, vol, _ = brick(
        dataclasses.replace(FREE, velocity=(0.11, -0.07, 0.05), spin=(2.0, -1.0, 3.0), scheme=scheme)
    )
    f = field(len(x), elastic, plastic, yield_stress=50.0)
    kick = 0.3 * torch.sin(9.0 * x)  # so that there is stress
    mixture = make_mixture(elastic, plastic, wp.float64)
    matter = make_matter(f, vol, mixture.params, torch.float64)
    first, *_, last = (diagnose(mixture, s, matter, DX) for s in simulate(scene, x, vol, f, velocity=kick))
    assert last.mass == first.mass
    scale = float(first.angular_momentum.norm())
    # 4 frames of about 25 substeps; rounding of sums over 192 particles, relative to the largest term
    torch.testing.assert_close(last.momentum, first.momentum, rtol=0, atol=1e-11 * float(first.momentum.norm()))
    torch.testing.assert_close(last.angular_momentum, first.angular_momentum, rtol=0, atol=1e-11 * scale)
    if plastic == ("identity",):
        assert first.elastic < 1e-20 < last.elastic  # it did deform: nothing above is trivial
        energy = [d.kinetic + d.elastic for d in (first, last)]
        assert 0.5 * energy[0] < energy[1] <= energy[0] * (1 + 1e-3)  # the transfer damps and must not drive


def test_rest_stays_at_rest_to_the_last_bit():
    """v = 0, F = I, g = 0: nothing moves, in either precision."""
    for dtype in (torch.float32, torch.float64):
        x, vol = block((2, 2, 2), DX, (0.113, 0.027, 0.3), dtype=dtype)
        out = rollout(FREE, x, vol, field(len(x), dtype=dtype))
        assert torch.equal(out.x[-1], x) and not bool(out.v[-1].any())


def test_a_quarter_turn_of_everything_turns_the_answer():
    """Rotating particles, gravity and walls by 90° about a grid axis, or permuting axes, rotates the trajectory."""
    scene = dataclasses.replace(
        FREE, gravity=(1.0, 0.0, -9.81), frames=6, boundaries=(HalfSpace(friction=0.4, point=(0.0, 0.0, 0.2)),)
    )
    _, x, vol, f = brick(scene)
    here = rollout(scene, x, vol, f)
    R = x.new_tensor([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # z → x
    turn = lambda a: tuple((R @ x.new_tensor(a)).tolist())  # noqa: E731
    wall = HalfSpace(friction=0.4, point=turn((0.0, 0.0, 0.2)), normal=turn((0.0, 0.0, 1.0)))
    there = rollout(dataclasses.replace(scene, gravity=turn(scene.gravity), boundaries=(wall,)), x @ R.T, vol, f)
    # another order of the same sums; contact does not amplify it in so short a time
    torch.testing.assert_close(there.x, here.x @ R.T, rtol=0, atol=1e-11)
    torch.testing.assert_close(there.F, R @ here.F @ R.T, rtol=0, atol=1e-9)


def bar_period_error(n: int, scheme: Scheme) -> float:
    """Relative error of the first period of a free bar of n cells with v = v̂ cos(π X/L); T = 2 L/c with c² = E/ρ at
    ν = 0."""
    L, E, rho = 1.0, 1e5, 1000.0
    c, dx = math.sqrt(E / rho), L / n
    x, vol = block((n, 2, 2), dx)
    v = torch.zeros_like(x)
    v[:, 0] = 1e-3 * c * torch.cos(math.pi * x[:, 0] / L)
    frames = 60
    scene = Scene(
        gravity=(0.0, 0.0, 0.0), dx=dx, fps=frames / (0.8 * 2 * L / c), boundaries=(), lift=None, frames=frames,
        scheme=scheme,
    )  # fmt: skip
    mode = torch.cos(math.pi * x[:, 0] / L)
    q = [
        float((s.v[:, 0] * mode).sum())
        for s in simulate(scene, x, vol, field(len(x), E=E, nu=0.0, rho=rho), velocity=v)
    ]
    roots = [i + a / (a - b) for i, (a, b) in enumerate(itertools.pairwise(q)) if a > 0 >= b or a < 0 <= b]
    period = 2 * (roots[1] - roots[0]) / scene.fps
    return abs(period / (2 * L / c) - 1)


def test_the_period_of_a_bar_converges_with_order_two():
    """Error of T about 1.0 (Δx/L)² for plain MLS: its kinetic energy carries m D |C|²/2, D = Δx²/4, so T grows by
    (π²/8)(Δx/L)². Sharpening takes 0.20 of the 0.217 Δx² that this makes in
    the equation of motion of a mode; what is left, and what free faces add, is below a ninth."""
    coarse, fine = (bar_period_error(n, Scheme.mls()) for n in (8, 16))
    assert 0.7 < coarse * 8**2 < 2.0 and 0.7 < fine * 16**2 < 2.0
    assert 1.7 < math.log2(coarse / fine) < 2.3
    assert bar_period_error(8, Scheme()) < coarse / 9 and bar_period_error(16, Scheme()) < fine / 9


def test_a_rollout_can_be_cut_anywhere():
    """2 + 3 frames are the 5 frames, to the last bit."""
    scene = dataclasses.replace(
        FREE, gravity=(0.0, 0.0, -9.81), boundaries=(HalfSpace(point=(0.0, 0.0, 0.2), friction=0.3),)
    )
    _, x, vol, f = brick(scene)
    whole = list(simulate(scene, x, vol, f, frames=5))
    *_, middle = simulate(scene, x, vol, f, frames=2)
    *_, end = simulate(scene, x, vol, f, frames=3, state=middle)
    assert all(
        torch.equal(a, b)
        for a, b in ((end.x, whole[-1].x), (end.v, whole[-1].v), (end.He, whole[-1].He), (end.C, whole[-1].C))
    )
    assert end.time == whole[-1].time


def test_substeps_follow_stiffness():
    """n_sub = ⌈T (c + V)/(cfl Δx)⌉ at rest: 100 times the modulus takes 10 times the substeps."""
    counts = []
    for E in (1e4, 1e6):
        reports: list[FrameReport] = []
        scene, x, vol, f = brick(FREE, E=E)
        rollout(scene, x, vol, f, frames=1, report=reports)
        (r,) = reports
        c = math.sqrt(E * 0.7 / (1.3 * 0.4) / 1000.0)  # √((λ + 2μ)/ρ), ν = 0.3
        assert r.n_sub == math.ceil(c / (0.4 * DX * 50.0)) and r.wave == pytest.approx(c, rel=1e-12)
        counts.append(r.n_sub)
    assert counts[1] == pytest.approx(10 * counts[0], abs=10)


def test_an_unstable_time_step_is_refused_with_the_one_that_would_do():
    scene, x, vol, f = brick(FREE)
    with pytest.raises(ValueError, match=r"dt = 0.01 s is unstable.*use at most") as refused:
        rollout(scene, x, vol, f, frames=1, dt=0.01)
    limit = float(str(refused.value).split("use at most ")[1].split(" s")[0])
    rollout(scene, x, vol, f, frames=1, dt=0.99 * limit)


def test_divergence_names_the_particle_and_the_remedy():
    """A soft body pulled at its own centre harder than any substep follows."""
    scene, x, vol, f = brick(FREE, E=10.0)
    said = r"particle \d+ .* frame \d+ .* x = .* CFL = .*; shorter substeps did not help: .*lower cfl"
    with pytest.raises(SimulationDiverged, match=said):
        rollout(scene, x, vol, f, body=lambda t: -1e6 * (x - x.mean(0)))


def test_a_state_inside_out_is_refused():
    scene, x, vol, f = brick(FREE)
    *_, state = simulate(scene, x, vol, f, frames=0)
    state.He[37] = torch.diag(x.new_tensor([0.0, 0.0, -1.5]))
    with pytest.raises(ValueError, match="det F of particle 37"):
        rollout(scene, x, vol, f, state=state)


def test_particles_may_leave_the_block_of_nodes():
    """A bar pulled apart by stored stretch moves faster than its speed at the start of the frame lets one guess: the
    frame is run again."""
    scene, x, vol, f = brick(dataclasses.replace(FREE, fps=24.0), E=1e6)
    *_, state = simulate(scene, x, vol, f, frames=0)
    squeezed = dataclasses.replace(state, He=state.He - 0.45 * torch.eye(3, dtype=x.dtype))
    reports: list[FrameReport] = []
    *_, end = simulate(scene, x, vol, f, frames=1, state=squeezed, report=reports)
    assert reports[0].reruns > 0
    moved = float((end.x - state.x).norm(dim=1).max())
    assert moved > 3 * DX and bool(torch.isfinite(end.x).all())


@pytest.mark.parametrize("change", ["x", "vol", "rho", "E", "rows", "dtype"])
def test_bad_input_is_named(change):
    scene, x, vol, f = brick(FREE)
    if change == "x":
        x[37, 1] = math.nan
    elif change == "vol":
        vol[37] = 0.0
    elif change == "rho":
        f.rho[37] = -1.0
    elif change == "E":
        f.theta["E"][37] = math.inf
    elif change == "rows":
        f = dataclasses.replace(f, rho=f.rho[:-1])
    else:
        x = x.half()
    with pytest.raises(
        ValueError,
        match="rho must have shape"
        if change == "rows"
        else "float32 or float64"
        if change == "dtype"
        else f"{change}.*37",
    ):
        rollout(scene, x, vol, f)


def test_float32_keeps_the_increments_that_its_positions_round_away():
    """A slow stiff bar in float32 follows float64: displacements and H are summed, not x and F."""
    x, vol = block((8, 2, 2), DX)
    v = torch.zeros_like(x)
    v[:, 0] = 1e-4 * torch.cos(math.pi * x[:, 0] / (8 * DX))  # v/c = 1e-5, increments of x below 1e-9 m at x near 0.4 m
    scene = dataclasses.replace(FREE, fps=200.0, frames=3)
    moved = []
    for dtype in (torch.float64, torch.float32):
        *_, end = simulate(scene, x.to(dtype), vol.to(dtype), field(len(x), dtype=dtype), velocity=v.to(dtype), dt=2e-5)
        moved.append(end.He[:, 0, 0].double())
    # 750 additions into H, each rounded relative to H: far below the 3 % that F = I + H in float32 would lose per
    # addition
    torch.testing.assert_close(moved[1], moved[0], rtol=0, atol=2e-2 * float(moved[0].abs().max()))


def test_rate_gates_make_a_blend_independent_of_the_time_step():
    """Half von Mises, half identity: halving Δt changes the deformation by a third, with gates over 8 ms by 1 %."""
    scene, x, vol, _ = brick(dataclasses.replace(FREE, fps=25.0, frames=3))
    f = field(len(x), ("hencky",), ("identity", "von_mises"), yield_stress=20.0)
    kick = 0.5 * torch.sin(9.0 * x)

    def change(dt_ref: float | None) -> float:
        coarse, fine = (rollout(scene, x, vol, f, velocity=kick, dt=dt, dt_ref=dt_ref).F[-1] for dt in (8e-4, 4e-4))
        return float((fine - coarse).norm() / (fine - torch.eye(3, dtype=x.dtype)).norm())

    assert change(None) > 0.1 and change(8e-3) < 0.03  # the gated flow is a rate: what is left is of order Δt/dt_ref


def test_one_solver_a_thread_gives_the_same_bits():
    """Rollouts in two threads at once: solvers share compiled kernels and nothing else."""
    scene, x, vol, f = brick(dataclasses.replace(FREE, spin=(1.0, 2.0, 0.0)))
    alone = [rollout(scene, x * s, vol, f).x for s in (1.0, 1.1)]
    with ThreadPoolExecutor(2) as pool:
        together = list(pool.map(lambda s: rollout(scene, x * s, vol, f).x, (1.0, 1.1)))
    assert all(torch.equal(a, b) for a, b in zip(alone, together, strict=True))


def test_waves_are_evaluated_once_a_frame(monkeypatch):
    """Those at the end of a frame are those at the beginning of the next: T + 1 evaluations of T frames, also with
    gradients, and another when a state is changed in place."""
    from diffuphy.mpm.engine import clock

    count, waves = [], clock.waves
    monkeypatch.setattr(clock, "waves", lambda *a: (count.append(1), waves(*a))[1])
    x, vol = block((1, 1, 1), 0.1, (0.013, 0.021, 0.337))
    scene = Scene(dx=0.1, fps=100.0, frames=3, boundaries=(), lift=None)
    for grad in (False, True):
        count.clear()
        rollout(scene, x.clone().requires_grad_(grad), vol, field(len(x)), grad=grad)
        assert len(count) == 4
    count.clear()
    for state in simulate(scene, x, vol, field(len(x))):
        state.He.add_(1e-3)
    assert len(count) > 4
