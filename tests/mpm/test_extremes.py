"""Bad and extreme input: every case ends in a finite result that meets its check, or in an exception that names what is
wrong (``docs/verification.md``, part D)."""

import dataclasses
import math
import re
import warnings

import pytest
import torch

from diffuphy.mpm import FrameReport, HalfSpace, Scene, Scheme, rollout, simulate
from diffuphy.types import MaterialField, SimulationDiverged
from tests.mpm.bodies import block, field

DX = 0.05
FREE = Scene(gravity=(0.0, 0.0, 0.0), dx=DX, fps=50.0, frames=2, boundaries=(), lift=None)
BOTH = pytest.mark.parametrize("dtype", [torch.float32, torch.float64])


def cube(dtype: torch.dtype, cells: int = 2, **material: float):
    x, vol = block((cells, cells, cells), DX, (0.013, 0.021, 0.337), dtype=dtype)
    return x, vol, field(len(x), dtype=dtype, **material)


def det(F: torch.Tensor) -> torch.Tensor:
    return torch.linalg.det(F.double())


@BOTH
@pytest.mark.parametrize("nu", [0.45, 0.49, 0.499, 0.4999])
def test_d4_nearly_incompressible_bodies_keep_their_volume(dtype, nu):
    """λ = E ν/((1 + ν)(1 − 2ν)): Δt shrinks like √(1 − 2ν), the volume of a body that is sheared at 0.2 c_s stays, and
    the gradient in ν is finite."""
    x, vol, f = cube(dtype, nu=nu)
    leaf = f.theta["nu"].clone().requires_grad_()
    f = dataclasses.replace(f, theta=f.theta | {"nu": leaf})
    v = torch.zeros_like(x)
    v[:, 0] = torch.sin(30.0 * (x[:, 2] - 0.387))  # divergence-free
    reports: list[FrameReport] = []
    scene = dataclasses.replace(FREE, frames=1, fps=400.0)
    out = rollout(scene, x, vol, f, velocity=v, grad=True, report=reports)
    M = 1e5 * (1 - nu) / ((1 + nu) * (1 - 2 * nu))
    assert reports[0].wave == pytest.approx(math.sqrt(M / 1000.0), rel=1e-3 if dtype == torch.float32 else 1e-9)
    total = float((det(out.F[-1]) * vol.double()).sum() / vol.double().sum())
    assert abs(total - 1) < 1e-2
    (bar,) = torch.autograd.grad(out.x[-1].square().sum(), leaf)
    assert bool(torch.isfinite(bar).all())


@pytest.mark.parametrize("nu", [0.5, 0.7, -1.0])
def test_d4_a_ratio_without_a_modulus_is_refused(nu):
    """ν = ½ has no λ, ν ≤ −1 no μ: named, with the range."""
    x, vol, f = cube(torch.float64, nu=nu)
    with pytest.raises(ValueError, match="nu"):
        rollout(FREE, x, vol, f)


@BOTH
@pytest.mark.parametrize("law", ["neo_hookean", "hencky"])
def test_d5_a_body_thrown_at_its_centre_does_not_turn_inside_out(dtype, law):
    """v = −(x − x_m)/τ with a kinetic energy of 0.4 of E V: the barrier −ln J stops it, in more substeps if
    need be."""
    x, vol = block((2, 2, 2), DX, (0.013, 0.021, 0.337), dtype=dtype)
    f = field(len(x), (law,), E=1e4, dtype=dtype)
    v = -40.0 * (x - x.mean(0))
    J = torch.stack([det(s.F) for s in simulate(dataclasses.replace(FREE, fps=400.0, frames=6), x, vol, f, velocity=v)])
    assert bool(torch.isfinite(J).all()) and float(J.min()) > 0.0
    assert float(J.min()) < 0.75  # it was squeezed


@BOTH
def test_d5_a_body_without_volume_is_refused(dtype):
    """Thrown at its centre at 6000 times its waves nothing stops it until J < 64 ε, where F = I + H is rounded to ε/2
    and its volume to 1 %, although −ln J is finite. The message has particle, substep, time, det F and the bound."""
    x, vol = block((2, 2, 2), DX, (0.013, 0.021, 0.337), dtype=dtype)
    v = -1e6 * (x - x.mean(0))
    scene = dataclasses.replace(FREE, fps=1e6 / 8, frames=4)
    words = (
        r"particle \d+ was squeezed to nothing in frame \d \(substep \d+ of \d+, t = \S+ s\): det F = (\S+), at least"
    )
    with pytest.raises(SimulationDiverged, match=words) as found:
        list(simulate(scene, x, vol, field(len(x), E=1e4, dtype=dtype), velocity=v, dt=2e-8))
    J = float(re.search(words, str(found.value))[1])
    assert 0.0 < J <= 1.001 * 64 * torch.finfo(dtype).eps  # printed with four digits
    assert "slow it down or make it stiffer" in str(found.value)


@BOTH
@pytest.mark.parametrize(
    ("length", "mass", "time"), [(2**-10, 1, 1), (2**7, 1, 1), (1, 2**20, 1), (1, 1, 2**-6), (2**-10, 2**-20, 2**4)]
)
def test_d7_a_change_of_units_by_powers_of_two_changes_no_bit(dtype, length, mass, time):
    """[E] = M/(L T²), [ρ] = M/L³, [g] = L/T²: no number of the code has a hidden unit."""
    x, vol, f = cube(dtype)
    v = 0.3 * torch.sin(9.0 * x)

    def film(L: float, M: float, T: float):
        scaled = dataclasses.replace(
            f,
            theta=f.theta | {"E": f.theta["E"] * (M / (L * T * T))},
            rho=f.rho * (M / L**3),
        )  # fmt: skip
        wall = HalfSpace(point=(0.0, 0.0, 0.33 * L), friction=0.3)
        scene = dataclasses.replace(
            FREE, dx=DX * L, fps=64.0 / T, gravity=(0.0, 0.0, -8.0 * L / T**2), boundaries=(wall,)
        )  # fmt: skip
        return rollout(scene, x * L, vol * L**3, scaled, velocity=v * (L / T))

    one, other = film(1.0, 1.0, 1.0), film(length, mass, time)
    assert torch.equal(other.x, one.x * length) and torch.equal(other.v, one.v * (length / time))
    assert torch.equal(other.F, one.F)


@BOTH
@pytest.mark.parametrize("size", [1e-3, 100.0])
@pytest.mark.parametrize("mass", [1e-12, 1e12])
def test_d7_small_and_large_worlds_are_similar(dtype, size, mass):
    """Bodies of 1 mm and of 100 m, of 1e-12 and 1e12 kg, with E = ρ c², g = c²/L of one kind: x/L and F the same to
    rounding (some 60 substeps of sums over 27 nodes)."""
    films = []
    for L, m in ((0.1, 1.0), (size, mass)):
        x, vol = block((2, 2, 2), L / 2, (0.13 * L, 0.21 * L, 3.37 * L), dtype=dtype)
        rho = m / float(vol.sum())
        f = field(len(x), E=rho * (10.0 * L) ** 2, rho=rho, dtype=dtype)
        scene = dataclasses.replace(FREE, dx=L / 2, gravity=(0.0, 0.0, -L * 10.0))
        films.append((rollout(scene, x, vol, f, velocity=0.3 * L * torch.sin(9.0 * x / L)), L))
    (a, L), (b, l) = films
    eps = torch.finfo(dtype).eps
    torch.testing.assert_close(b.x / l, a.x / L, rtol=0, atol=300 * eps * 4.0)
    torch.testing.assert_close(b.F, a.F, rtol=0, atol=3000 * eps)


def _cubes(dtype: torch.dtype, light: float):
    """A cube that hits another, ``light`` times as dense, head on at 2 m/s."""
    x, vol = block((2, 2, 2), DX, (0.0, 0.0, 0.0), dtype=dtype)
    n = len(x)
    x = torch.cat([x, x + x.new_tensor([3.5 * DX, 0.0, 0.0])])
    f = field(2 * n, E=1e5, dtype=dtype)
    f = dataclasses.replace(f, rho=torch.cat([f.rho[:n], f.rho[n:] * light]))
    f = dataclasses.replace(f, theta=f.theta | {"E": torch.cat([f.theta["E"][:n], f.theta["E"][n:] * light])})
    v = torch.zeros_like(x)
    v[:n, 0] = 2.0
    return x, torch.cat([vol, vol]), f, v, n


@BOTH
def test_d7b_a_light_body_that_is_hit_keeps_the_momentum_and_gains_at_most_twice_the_speed(dtype):
    """1 : 1000 in density: Σ m v stays to rounding; an elastic shock from a heavy body gives at most 2 v."""
    x, vol, f, v, n = _cubes(dtype, 1e-3)
    out = rollout(dataclasses.replace(FREE, frames=3), x, vol, f, velocity=v)
    m = (f.rho * vol).double()
    P = (m[:, None] * out.v.double()).sum(1)
    tolerance = 1e-10 if dtype == torch.float64 else 1e-5  # ε times some 1e3 substeps · √N
    assert float((P[-1] - P[0]).norm() / P[0].norm()) < tolerance
    mean = out.v[:, n:].mean(1)
    assert float(mean[-1, 0]) > 1.0 and float(mean.norm(dim=1).max()) < 2 * 2.0
    assert bool(torch.isfinite(out.F).all())


@pytest.mark.parametrize("offset", [1e3, 1e4])
def test_d7c_far_from_the_origin_float32_loses_what_positions_lose_and_no_more(offset):
    """x is stored to ε|x|: displacements are sums of their own, and nodes count from the block. The motion of the far
    body is that of one whose particles were moved by ε|x|/2: relative error ε|x|/(2Δx) of the weights."""
    x, vol, f = cube(torch.float32)
    kick = 0.3 * torch.sin(9.0 * x)
    shift = torch.tensor([offset, 0.0, 0.0])
    near, far = (rollout(FREE, x + s, vol, f, velocity=kick) for s in (0.0 * shift, shift))
    change = float((far.v[-1] - near.v[-1]).norm() / near.v[-1].norm())
    assert bool(torch.isfinite(far.F).all())
    assert change < 8 * 2.0**-24 * offset / DX  # eight: stress is a difference of weights


@BOTH
def test_d8_negative_places_are_places_like_others(dtype):
    """A body moved by −7 Δx, across the origin, does the same: ⌊x⌋, not the part before the point."""
    x, vol, f = cube(dtype)
    x = x - x.new_tensor([0.013 + 0.3 * DX, 0.021 + 0.3 * DX, 0.337 + 0.3 * DX])
    kick = 0.3 * torch.sin(9.0 * x)
    here, there = (rollout(FREE, x + s * DX, vol, f, velocity=kick) for s in (0, 7))
    eps = torch.finfo(dtype).eps
    torch.testing.assert_close(here.v, there.v, rtol=0, atol=2000 * eps)
    assert float((here.v[-1] - kick).norm()) > 1e-3  # it did something


@BOTH
def test_d9_one_particle_and_two_in_one_place_fly_freely(dtype):
    """A particle alone follows v = v0 + g t; two in one place move as one."""
    g, v0 = (0.0, 0.0, -9.81), (0.3, -0.2, 0.5)
    scene = dataclasses.replace(FREE, gravity=g, velocity=v0)
    eps = torch.finfo(dtype).eps
    for copies in (1, 2):
        x = torch.tensor([[0.113, -0.021, 0.337]], dtype=dtype).repeat(copies, 1)
        out = rollout(scene, x, torch.full((copies,), (DX / 2) ** 3, dtype=dtype), field(copies, dtype=dtype))
        T = scene.frames / scene.fps
        expected = x[0] + T * x.new_tensor(v0) + 0.5 * T * T * x.new_tensor(g)
        # kick–drift–kick is exact for a constant force; 30 substeps of sums of 27 weights
        torch.testing.assert_close(out.x[-1], expected.expand_as(x), rtol=0, atol=200 * eps)
        assert torch.equal(out.x[-1, 0], out.x[-1, -1])


def test_d9_no_particles_are_refused():
    with pytest.raises(ValueError, match="N > 0"):
        rollout(FREE, torch.zeros(0, 3), torch.zeros(0), field(0, dtype=torch.float32))


@BOTH
def test_d10_nodes_with_next_to_no_mass_move_no_faster_than_particles(dtype):
    """A particle at the very edge of a cell gives a node ε²/2 of its mass; with masses near the smallest number the
    product is denormal or 0. Velocities stay those of the particles."""
    edge = (0.5 - float(torch.finfo(dtype).eps)) * DX
    x = torch.tensor([[edge, edge, edge], [edge + DX, edge, edge]], dtype=dtype)
    tiny = float(torch.finfo(dtype).tiny) * 1e6
    vol = torch.full((2,), 1e-3, dtype=dtype)
    f = field(2, E=tiny * 1e5, rho=tiny * 1e3, dtype=dtype)
    out = rollout(dataclasses.replace(FREE, velocity=(1.0, 0.5, -0.3)), x, vol, f)
    assert bool(torch.isfinite(out.v).all())
    torch.testing.assert_close(out.v[-1], out.v[0], rtol=0, atol=3000 * torch.finfo(dtype).eps)


def _spoil(what: str, x, vol, f: MaterialField):
    """Row 37 of one input made impossible."""
    values = {"x": math.nan, "vol": 0.0, "rho": -1.0, "E": -1e5, "nu": math.nan, "w_e": math.inf, "yield_stress": -1.0,
              "friction_angle": 90.0, "velocity": math.nan}  # fmt: skip
    target = {"x": x, "vol": vol, "rho": f.rho, "w_e": f.w_e}.get(what)
    (f.theta[what] if target is None else target)[37] = values[what]


@pytest.mark.parametrize("what", ["x", "vol", "rho", "E", "nu", "w_e", "yield_stress", "friction_angle"])
def test_d11_bad_rows_are_named(what):
    """With the parameter, the first bad particle, and the range where there is one."""
    x, vol, _ = cube(torch.float64)
    f = field(len(x), ("hencky",), ("von_mises", "drucker_prager"))
    _spoil(what, x, vol, f)
    with pytest.raises(ValueError, match=rf"{what}.*particle 37"):
        rollout(FREE, x, vol, f)


def test_d11_a_parameter_that_no_law_reads_may_be_anything():
    x, vol, f = cube(torch.float64)
    f.theta["yield_stress"][37] = -1.0
    rollout(dataclasses.replace(FREE, fps=2000.0), x, vol, f, frames=1)


def test_d11_a_velocity_that_is_not_a_number_is_named():
    x, vol, f = cube(torch.float64)
    v = torch.zeros_like(x)
    v[37, 1] = math.nan
    with pytest.raises(ValueError, match="velocity of particle 37"):
        rollout(FREE, x, vol, f, velocity=v)


def test_d11_a_wall_with_negative_friction_is_refused():
    with pytest.raises(ValueError, match="friction"):
        HalfSpace(friction=-0.1)


@BOTH
def test_d12_rest_stays_at_rest_for_1000_substeps(dtype):
    """g = 0, v = 0, F = I: every bit of the state is as before."""
    x, vol, f = cube(dtype)
    reports: list[FrameReport] = []
    *_, end = simulate(dataclasses.replace(FREE, fps=2.0), x, vol, f, frames=2, dt=9e-4, report=reports)
    assert sum(r.n_sub for r in reports) > 1000
    assert torch.equal(end.x, x) and not any(bool(t.any()) for t in (end.v, end.C, end.He))


@BOTH
def test_d13_a_body_that_hits_a_wall_near_its_speed_of_sound_stays_right_side_out(dtype):
    """v = 0.9 c: J > 0, energy does not grow, and it comes back slower than it came."""
    x, vol, f = cube(dtype, E=1e4)
    c = math.sqrt(1e4 * 0.7 / (1.3 * 0.4) / 1000.0)
    wall = HalfSpace(point=(0.0, 0.0, 0.32), kind="separate", friction=0.0)
    scene = dataclasses.replace(FREE, boundaries=(wall,), velocity=(0.0, 0.0, -0.9 * c), fps=200.0, frames=12)
    reports: list[FrameReport] = []
    states = list(simulate(scene, x, vol, f, report=reports, diagnose=True))
    assert min(float(det(s.F).min()) for s in states) > 0.0
    first = 0.5 * float((f.rho * vol).sum()) * (0.9 * c) ** 2
    energy = [r.balance.end.kinetic + r.balance.end.elastic for r in reports]  # type: ignore[union-attr]
    # the scheme conserves to second order in Δt; a percent at CFL 0.4 through a shock
    assert max(energy) < 1.01 * first
    assert float(states[-1].v[:, 2].mean()) < 0.9 * c
    assert all(r.balance.courant < 1.0 for r in reports)  # type: ignore[union-attr]


@BOTH
def test_d13_two_bodies_head_on_near_their_speed_of_sound(dtype):
    """Relative speed 0.9 c: finite, J > 0, momentum as before."""
    x, vol, f, _, n = _cubes(dtype, 1.0)
    c = math.sqrt(1e5 * 0.7 / (1.3 * 0.4) / 1000.0)
    v = torch.zeros_like(x)
    v[:n, 0], v[n:, 0] = 0.45 * c, -0.45 * c
    out = rollout(dataclasses.replace(FREE, fps=400.0, frames=4), x, vol, f, velocity=v)
    assert float(det(out.F).min()) > 0.0
    assert float(det(out.F).min()) < 0.95  # they met
    P = (f.rho * vol)[:, None].double() * out.v[-1].double()
    assert float(P.sum(0).norm()) < (1e-10 if dtype == torch.float64 else 1e-4) * float(P.norm(dim=1).sum())


def test_d16_a_block_with_more_nodes_than_indices_is_refused():
    """Two particles a kilometre apart on a grid of 1 cm: with the number of cells and what to change."""
    x = torch.tensor([[0.0, 0.0, 0.0], [1e3, 1e3, 1e3]], dtype=torch.float64)
    with pytest.raises(ValueError, match=r"grid cells of 0.01 m, more than .* enlarge dx"):
        rollout(dataclasses.replace(FREE, dx=0.01), x, torch.full((2,), 1e-6, dtype=torch.float64), field(2))


@BOTH
@pytest.mark.parametrize("shape", ["sheet", "line", "holes"])
def test_d17_thin_and_broken_bodies_stay_finite(dtype, shape):
    """A sheet one particle thick, a line, a cloud with holes, shaken."""
    x, vol = block((3, 3, 3), DX, (0.013, 0.021, 0.337), dtype=dtype)
    keep = {
        "sheet": x[:, 2] == x[0, 2],
        "line": (x[:, 2] == x[0, 2]) & (x[:, 1] == x[0, 1]),
        "holes": torch.arange(len(x)) % 3 == 0,
    }[shape]
    x, vol = x[keep], vol[keep]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        out = rollout(FREE, x, vol, field(len(x), dtype=dtype), velocity=0.3 * torch.sin(9.0 * x))
    assert bool(torch.isfinite(out.F).all()) and float(det(out.F).min()) > 0.0
    assert float(out.v.norm(dim=2).max()) < 2 * 0.3 * math.sqrt(3.0)


@BOTH
@pytest.mark.slow
def test_d15_a_long_flight_keeps_mass_momentum_and_time(dtype):
    """1e5 substeps in free flight: Σ m v stays to √S rounding errors, and time is summed in double."""
    x, vol, f = cube(dtype)
    scene = dataclasses.replace(FREE, velocity=(1e-3, 0.0, 0.0), fps=1.0, frames=90)
    *_, end = simulate(scene, x, vol, f, velocity=1e-3 * torch.sin(9.0 * x), dt=9e-4)
    assert end.time == pytest.approx(90.0, rel=1e-12)
    m = (f.rho * vol).double()
    start = m[:, None] * (1e-3 * torch.sin(9.0 * x) + x.new_tensor((1e-3, 0.0, 0.0))).double()
    drift = float(((m[:, None] * end.v.double()) - start).sum(0).norm() / start.sum(0).norm())
    assert drift < (1e-9 if dtype == torch.float64 else 1e-2)


def test_d_a_message_never_hides_a_number():
    """What diverges is an exception of its own kind, so that a caller can tell it from bad input."""
    assert issubclass(SimulationDiverged, RuntimeError) and not issubclass(SimulationDiverged, ValueError)


def test_d7c_float32_is_refused_where_it_does_not_tell_places_apart():
    """2⁻²⁴ |x| > Δx/64: two hundred kilometres away cells of 5 cm are 3 roundings wide. Below that, and in float64,
    it runs; a body that flies there is stopped when it would arrive."""
    limit = 2.0**18 * DX
    for dtype, place, fine in (
        (torch.float32, 0.9 * limit, True),
        (torch.float32, 1.1 * limit, False),
        (torch.float64, 1.1 * limit, True),
    ):
        x, vol, f = cube(dtype)
        there = x + x.new_tensor([place, 0.0, 0.0])
        if fine:
            assert bool(torch.isfinite(rollout(FREE, there, vol, f).x).all())
            continue
        with pytest.raises(ValueError, match=r"float32 rounds places to .* m from the origin.*use float64"):
            rollout(FREE, there, vol, f)
    x, vol, f = cube(torch.float32)
    fast = dataclasses.replace(FREE, frames=6, velocity=(20.0, 0.0, 0.0))  # 0.4 m a frame
    with pytest.raises(SimulationDiverged, match=r"float32 rounds places .* by t = 0\.\d+ s"):
        rollout(fast, x + x.new_tensor([limit - 1.5, 0.0, 0.0]), vol, f)


@pytest.mark.parametrize(
    ("cells", "contact", "said"), [(2, "elastic", True), (3, "elastic", False), (2, "rigid", False)]
)
def test_a_body_too_thin_for_elastic_walls_is_said_to_be(cells, contact, said, caplog):
    """Bodies of one and two cells do not come to rest on an elastic floor; of three they do."""
    x, vol = block((cells, 4, 4), 0.1)
    scene = Scene(dx=0.1, boundaries=(HalfSpace(),), scheme=Scheme(contact=contact), frames=1)
    with caplog.at_level("WARNING", logger="diffuphy"):
        next(simulate(scene, x, vol, field(len(x))))
    assert any("2.0 cells thick along x" in r.message for r in caplog.records) == said
