"""Sums over the substeps of a frame: what they are, what they add up to, and that nobody pays who does not ask."""

import dataclasses

import numpy as np
import pytest
import torch
import warp as wp

from diffuphy.losses.velocity import velocity_loss
from diffuphy.material.reference import kirchhoff, return_map
from diffuphy.mpm import FrameReport, HalfSpace, Scene, Scheme, Sphere, rollout, simulate
from diffuphy.mpm.engine import program
from diffuphy.mpm.engine.launch import Arguments
from tests.mpm.bodies import block, field, rotation
from tests.mpm.lattice import nodes_of, sharpened

DX = 0.05
G = (0.4, -0.2, -9.81)
FREE = Scene(gravity=G, dx=DX, fps=50.0, frames=4, boundaries=(), lift=None, velocity=(0.3, 0.1, -1.5))
BOTH = ("expected_dv", "impulse")
FLOOR = (0.0, 0.0, 0.2)
WALLS = {
    "sticky": (HalfSpace(kind="sticky", point=FLOOR),),
    "slip": (HalfSpace(kind="slip", point=FLOOR, normal=(0.2, 0.0, 1.0)),),
    "separate": (HalfSpace(point=FLOOR),),
    "rough": (HalfSpace(friction=0.4, point=FLOOR),),
    "moving": (
        HalfSpace(friction=0.4, point=FLOOR),
        Sphere(center=(0.0, -0.1, 0.35), radius=0.1, velocity=(0.0, 1.0, 0.0), start=0.01, end=0.05),
    ),
}


def brick():
    """A brick off the grid lines, turned, a hand above z = 0.2 m, and a motion that strains it."""
    x, vol = block((3, 2, 4), DX)
    x = (x - x.mean(0)) @ rotation((1.0, 2.0, 0.3), 0.7).T + x.new_tensor([0.013, 0.021, 0.337])
    return x, vol, 0.3 * torch.sin(9.0 * x)


def gathered(scene, f=None, names=BOTH, **options):
    """Trajectory, masses and the two stacked sums of a rollout of the brick."""
    x, vol, kick = brick()
    f = field(len(x)) if f is None else f
    reports: list[FrameReport] = []
    out = rollout(scene, x, vol, f, **({"velocity": kick} | options), report=reports, gather=names)
    sums = [[getattr(r, name) for r in reports] for name in BOTH]
    return out, f.rho.detach() * vol, *(torch.stack(s) if s[0] is not None else None for s in sums), reports


def sums(x, v, C, tau, m, vol):
    """At the nodes of particles x: indices (N, 27) and weights, mass, velocity before the step, acceleration by
    stress; f_i = −Σ_p V_p (4/Δx²) τ_p w_ip (x_i − x_p)."""
    nodes, w, r = nodes_of(x, DX)
    nodes = nodes - nodes.reshape(-1, 3).min(0)
    size = nodes.reshape(-1, 3).max(0) + 1
    flat = np.ravel_multi_index(nodes.reshape(-1, 3).T, size).reshape(w.shape)
    mass, force, momentum = np.zeros(size.prod()), np.zeros((size.prod(), 3)), np.zeros((size.prod(), 3))
    np.add.at(mass, flat, w * m)
    np.add.at(force, flat, -(4 / DX**2) * vol[:, None, None] * w[..., None] * np.einsum("pab,pib->pia", tau, r))
    np.add.at(momentum, flat, (w * m)[..., None] * (v[:, None] + np.einsum("pab,pib->pia", C, r)))
    per = 1 / np.where(mass > 0, mass, 1)[:, None]
    return flat, w, mass.reshape(size), momentum * per, force * per


@pytest.mark.parametrize("scheme", [Scheme(), Scheme.mls()], ids=["default", "mls"])
@pytest.mark.parametrize(
    ("elastic", "plastic"), [("neo_hookean", "identity"), ("hencky", "von_mises"), ("hencky", "viscoplastic")]
)
def test_one_substep_is_what_numpy_sums_up(elastic, plastic, scheme):
    """expected_dv = Σ k (Σ_i w_ip f_i/m_i + g) over the kicks k: Δt, or Δt/2 before and after the drift. What it
    leaves of the velocity change is the filter (1 − α)(Σ_i w_ip v⁰_i − v_p) + Σ_i w_ip (S a)_i/m_i, with v⁰_i the
    velocity that particles alone bring to a node and α = 1 − Δt c/Δx, in the last kick 1."""
    x, vol, v = brick()
    f = field(len(x), (elastic,), (plastic,), yield_stress=50.0)
    scene = dataclasses.replace(FREE, fps=20000.0, frames=1, velocity=(0.0, 0.0, 0.0), scheme=scheme)
    *_, state = simulate(scene, x, vol, f, frames=0, velocity=v)
    seed = torch.Generator().manual_seed(0)
    state.He.copy_(0.1 * torch.randn(state.He.shape, dtype=x.dtype, generator=seed))
    state.C.copy_(20.0 * torch.randn(state.C.shape, dtype=x.dtype, generator=seed))
    reports: list[FrameReport] = []
    _, end = simulate(scene, x, vol, f, state=state, report=reports, gather=BOTH)
    (report,) = reports
    assert report.n_sub == 1
    dt, m = report.dt, (f.rho * vol)[0].item()
    params = {name: values[0].item() for name, values in f.theta.items()}
    kicks = [(state, dt, dt, 0.0)]
    if scheme.half_kick:
        kicks = [(state, dt / 2, dt, 1.0 - dt * report.wave / DX), (end, dt / 2, 0.0, 1.0)]
    expected, filtered = np.zeros((len(x), 3)), np.zeros((len(x), 3))
    for s, kick, drift, alpha in kicks:
        F = s.He + torch.eye(3, dtype=x.dtype)
        if plastic != "identity":
            F = return_map(F, plastic, params, drift)
        tau = kirchhoff(F, elastic, params).numpy()
        flat, w, mass, v0, a = sums(s.x.numpy(), s.v.numpy(), s.C.numpy(), tau, m, vol.numpy())
        mean = lambda values: (w[..., None] * values[flat]).sum(1)  # noqa: B023, E731
        expected += kick * (mean(a) + np.array(G))
        filtered += (1 - alpha) * (mean(v0) - s.v.numpy())
        if scheme.sharpen:
            per = 1 / np.where(mass > 0, mass, 1)[..., None]
            filtered += mean((per * sharpened(mass, kick * a.reshape(*mass.shape, 3), 0.2)).reshape(-1, 3))
    # q − q⁰ of about 1 m/s, nodes of a few weights: 1e-16 times a condition of some hundreds
    assert float(np.abs(expected - dt * np.array(G)).max()) > 1e-3
    torch.testing.assert_close(report.expected_dv, torch.from_numpy(expected), rtol=0, atol=1e-12)
    torch.testing.assert_close(
        end.v - state.v - report.expected_dv, torch.from_numpy(filtered), rtol=0, atol=1e-12
    )  # fmt: skip


@pytest.mark.parametrize("walls", [(), WALLS["rough"]])
def test_internal_forces_cancel(walls):
    """Σ m expected_dv = M g T in every frame, whatever the stress and the walls."""
    scene = dataclasses.replace(FREE, boundaries=walls, frames=6)
    _, m, expected, _, _ = gathered(scene)
    weight = m.sum() * expected.new_tensor(G) / scene.fps
    assert float((expected - expected.new_tensor(G) / scene.fps).abs().max()) > 0.05  # there are forces
    # about 25 substeps, each rounding momenta of about M · 2 m/s to 1.1e-16: 1e-14 M, with room for their sums
    torch.testing.assert_close((m[:, None] * expected).sum(1), weight.expand(6, 3), rtol=0, atol=1e-12 * float(m.sum()))


@pytest.mark.parametrize("how", [{}, {"grad": True}, {"grad": True, "keep": True}])
@pytest.mark.parametrize("wall", WALLS)
def test_gravity_and_walls_explain_the_momentum(wall, how):
    """Σ m Δv − M g T − J = 0 for every kind of wall, still and moving, with and without a graph."""
    scene = dataclasses.replace(FREE, boundaries=WALLS[wall], frames=6)
    f = field(len(brick()[0]))
    f.theta["E"].requires_grad_(bool(how))
    out, m, expected, impulse, _ = gathered(scene, f, **how)
    asked = (m[:, None] * (out.v[1:] - out.v[:-1])).sum(1).detach() - m.sum() * out.v.new_tensor(G) / scene.fps
    scale = float(m.sum() * out.v.detach().norm(dim=-1).max())
    assert float(impulse.norm(dim=1).max()) > 0.05 * scale  # it did hit
    torch.testing.assert_close(impulse, asked, rtol=0, atol=1e-12 * scale)  # rounding of sums, as above
    assert out.v.requires_grad is bool(how) and not expected.requires_grad and not impulse.requires_grad
    loss = velocity_loss("momentum", out.v, m, gravity=G, dt=1 / scene.fps, impulse=impulse)
    assert float(loss.detach()) < (1e-12 * scale / float(m.sum())) ** 2


def test_free_fall_without_stress_is_gravity_alone():
    """A cloud that moves as one: expected_dv = g T, and no wall means an impulse of exactly zero."""
    out, _, expected, impulse, _ = gathered(FREE, velocity=None)
    # strain and stress are rounding: E Δt/(ρ Δx) · 1e-16 · 25 substeps < 1e-14 m/s
    torch.testing.assert_close(expected, (out.v.new_tensor(G) / FREE.fps).expand_as(expected), rtol=0, atol=1e-12)
    torch.testing.assert_close(out.v[1:] - out.v[:-1], expected, rtol=0, atol=1e-12)
    assert not bool(impulse.any())


def test_a_frame_run_again_is_counted_once():
    """The block of nodes was too small: what the run in vain summed up is gone."""
    x, vol, _ = brick()
    scene = dataclasses.replace(FREE, fps=20.0, frames=1, velocity=(0.0, 0.0, 0.0), boundaries=WALLS["rough"])
    f = field(len(x), E=1e6)
    *_, state = simulate(scene, x, vol, f, frames=0)
    state = dataclasses.replace(state, He=state.He - 0.45 * torch.eye(3, dtype=x.dtype))
    reports: list[FrameReport] = []
    _, end = simulate(scene, x, vol, f, state=state, report=reports, gather=BOTH)
    (r,) = reports
    m = f.rho * vol
    weight = m.sum() * x.new_tensor(G) / scene.fps
    scale = float((m[:, None] * end.v).norm(dim=1).sum())
    assert r.reruns > 0
    # 93 substeps instead of 25, and stress of a body squeezed to half: momenta that cancel are larger
    torch.testing.assert_close((m[:, None] * r.expected_dv).sum(0), weight, rtol=0, atol=1e-11 * scale)
    torch.testing.assert_close((m[:, None] * end.v).sum(0) - weight, r.impulse, rtol=0, atol=1e-11 * scale)


@pytest.mark.parametrize(
    ("scheme", "names", "launches"),
    [
        (Scheme.mls(), (), 3), (Scheme.mls(), ("impulse",), 3), (Scheme.mls(), ("expected_dv",), 5),
        (Scheme.mls(), BOTH, 5),
        (Scheme(), (), 5), (Scheme(), ("impulse",), 5), (Scheme(), ("expected_dv",), 6), (Scheme(), BOTH, 6),
    ],
    ids=lambda v: "-".join(v) if isinstance(v, tuple) else "default" if v == Scheme() else "mls",
)  # fmt: skip
def test_only_who_asks_pays(scheme, names, launches, monkeypatch):
    """Three launches a substep, five with sharpening, whose nodes read their neighbours. The forces take one more, and
    the second pass over the nodes of the plain scheme; the impulse none. Nothing else is made or allocated, least of
    all for a backward pass."""
    count, buffers = [], []
    launch, nodal = wp.Launch.launch, Arguments.nodal
    monkeypatch.setattr(wp.Launch, "launch", lambda self, *a, **k: (count.append(1), launch(self, *a, **k))[1])

    def noted(self, name, rows, *rest, **more):
        buffers.extend([name] if rows > 1 else [])
        return nodal(self, name, rows, *rest, **more)

    monkeypatch.setattr(Arguments, "nodal", noted)
    monkeypatch.setattr(program, "make_adjoint", None)
    monkeypatch.setattr(program, "make_nodes_adjoint", None)
    if "expected_dv" not in names:
        monkeypatch.setattr(program, "make_gather", None)
    scene = dataclasses.replace(FREE, boundaries=WALLS["rough"], scheme=scheme)
    *_, reports = gathered(scene, names=names)
    assert len(count) == launches * sum(r.n_sub + scheme.half_kick for r in reports)
    twice = scheme.sharpen or "expected_dv" in names
    assert set(buffers) == {"grid", "grid_v"} | ({"acc"} if twice else set()) | ({"sigma"} if scheme.sharpen else set())
    for name in BOTH:
        assert all((getattr(r, name) is None) == (name not in names) for r in reports)


@pytest.mark.parametrize("keep", [False, True])
def test_gathering_changes_neither_the_film_nor_its_gradient(keep):
    """The same bits with and without, forward and backward."""
    scene = dataclasses.replace(FREE, boundaries=WALLS["moving"], frames=3)
    results = []
    for names in ((), BOTH):
        f = field(len(brick()[0]), ("hencky",), ("von_mises",), yield_stress=200.0)
        f.theta["E"].requires_grad_()
        out, *_ = gathered(scene, f, names, grad=True, keep=keep)
        (out.x[-1] ** 2).sum().backward()
        results.append((out.x.detach(), out.v.detach(), out.F.detach(), f.theta["E"].grad))
    assert all(torch.equal(a, b) for a, b in zip(*results, strict=True))
    assert bool(results[0][3].any())


def test_sums_repeat_to_the_last_bit():
    scene = dataclasses.replace(FREE, boundaries=WALLS["moving"])
    (*_, dv, J, _), (*_, dv2, J2, _) = gathered(scene), gathered(scene)
    assert torch.equal(dv, dv2) and torch.equal(J, J2)


@pytest.mark.parametrize("names", ["impulse", ("impulse", "heat")])
def test_an_unknown_sum_is_refused(names):
    with pytest.raises(ValueError, match=r"gather must be a tuple of names out of .*expected_dv.*got '(impulse|heat)'"):
        gathered(FREE, names=names)


def test_sums_need_a_report():
    x, vol, _ = brick()
    with pytest.raises(ValueError, match="give a list as report"):
        rollout(FREE, x, vol, field(len(x)), gather=("impulse",))
