"""The three forms of the velocity loss, in closed form."""

import math

import pytest
import torch

from diffuphy.losses.velocity import Velocity, centroid, contact_impulse, image_velocity_loss, velocity_loss

G = (0.0, 0.0, -9.8)
DT = 1 / 30
FALL = torch.tensor(G, dtype=torch.float64) * DT


def normal(*shape, seed=0):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def free_fall(frames=5, n=4):
    """v_t = v_0 + g t, a different v_0 for each particle."""
    return normal(1, n, 3) + torch.arange(frames, dtype=torch.float64)[:, None, None] * FALL


def masses(n=4):
    return torch.linspace(0.5, 2.0, n, dtype=torch.float64)


def test_free_fall_has_no_loss_in_any_form():
    """Δv = g Δt for every particle, no stress, no wall; rounding of v ~ 3 m/s squared."""
    v, m = free_fall(), masses()
    given = {"expected_dv": FALL.expand(4, 4, 3), "impulse": torch.zeros(4, 3, dtype=torch.float64)}
    for form in ("literal", "consistent", "momentum"):
        assert velocity_loss(form, v, m, gravity=G, dt=DT, **given) < 1e-29


def test_literal_punishes_a_body_at_rest():
    """On the floor Δv = 0: L = g² Δt², though nothing is wrong with resting. This is the bias of the printed form."""
    v, m = torch.zeros(6, 3, 3, dtype=torch.float64), masses(3)
    loss = velocity_loss("literal", v, m, gravity=G, dt=DT)
    torch.testing.assert_close(loss.item(), (9.8 * DT) ** 2, rtol=1e-14, atol=0)


def test_literal_punishes_every_internal_force():
    """A falling pair that pushes itself apart with Δv = ±u each frame: L = u² although momentum is conserved."""
    u = 0.7
    t = torch.arange(4, dtype=torch.float64)[:, None]
    push = torch.stack([u * t, -u * t], 1) * torch.tensor([1.0, 0, 0], dtype=torch.float64)
    v = push + t[:, None] * FALL
    m = torch.ones(2, dtype=torch.float64)
    torch.testing.assert_close(velocity_loss("literal", v, m, gravity=G, dt=DT).item(), u * u, rtol=1e-13, atol=0)
    none = torch.zeros(3, 3, dtype=torch.float64)
    assert velocity_loss("momentum", v, m, gravity=G, dt=DT, impulse=none) < 1e-29


def test_resting_contact_is_consistent_with_its_forces():
    """Stress carries the weight, so Δv_expected = 0; the floor's impulse is M g Δt: both forms vanish at rest."""
    v, m = torch.zeros(6, 3, 3, dtype=torch.float64), masses(3)
    still = torch.zeros(5, 3, 3, dtype=torch.float64)
    floor = (-m.sum() * FALL).expand(5, 3)
    assert velocity_loss("consistent", v, m, gravity=G, dt=DT, expected_dv=still) == 0
    assert velocity_loss("momentum", v, m, gravity=G, dt=DT, impulse=floor) < 1e-30


def test_hanging_body_is_seen_by_momentum_only_if_the_wall_is_left_out():
    """Without the impulse of what holds it, r = −g Δt exactly: L = g² Δt²."""
    v, m = torch.zeros(3, 4, 3, dtype=torch.float64), masses()
    none = torch.zeros(2, 3, dtype=torch.float64)
    loss = velocity_loss("momentum", v, m, gravity=G, dt=DT, impulse=none)
    torch.testing.assert_close(loss.item(), (9.8 * DT) ** 2, rtol=1e-13, atol=0)


def test_momentum_weighs_particles_by_mass():
    """One particle of mass m_1 kicked by u: r = m_1 u / M."""
    v, m = free_fall(2), masses()
    kick = torch.tensor([0.3, -0.2, 0.1], dtype=torch.float64)
    v[1, 2] += kick
    loss = velocity_loss("momentum", v, m, gravity=G, dt=DT, impulse=torch.zeros(1, 3, dtype=torch.float64))
    torch.testing.assert_close(loss, (m[2] / m.sum() * kick).square().sum(), rtol=1e-12, atol=0)


def test_consistent_is_the_mean_square_of_what_the_forces_do_not_explain():
    v, m, expected = normal(5, 4, 3), masses(), normal(4, 4, 3, seed=1)
    want = sum(((v[t + 1, i] - v[t, i] - expected[t, i]) ** 2).sum() for t in range(4) for i in range(4)) / 16
    loss = velocity_loss("consistent", v, m, gravity=G, dt=DT, expected_dv=expected)
    torch.testing.assert_close(loss, want, rtol=1e-13, atol=0)


@pytest.mark.parametrize("form", ["literal", "consistent", "momentum"])
def test_velocity_loss_has_its_exact_gradient(form):
    v, m = normal(4, 3, 3).requires_grad_(), masses(3)
    given = {"expected_dv": normal(3, 3, 3, seed=1), "impulse": normal(3, 3, seed=2)}
    assert torch.autograd.gradcheck(lambda v: velocity_loss(form, v, m, gravity=G, dt=DT, **given), (v,))


def asking(*impulses):
    """Velocities of two masses for which R = Σ m Δv − M g Δt is each of the given impulses in turn."""
    m = torch.tensor([0.5, 1.5], dtype=torch.float64)
    steps = torch.tensor(impulses, dtype=torch.float64) / m.sum() + FALL
    v = torch.cat([torch.zeros(1, 3, dtype=torch.float64), steps.cumsum(0)])
    return v[:, None].expand(-1, 2, -1), m


@pytest.mark.parametrize("mu", [0.0, 0.5, math.inf])
def test_contact_impulse_is_the_projection_on_the_cone_of_coulomb(mu):
    """J ∈ cone, (R − J)·J = 0, and (R − J)·k ≤ 0 for every k in the cone (Moreau)."""
    asked = 3 * normal(200, 3)
    v, m = asking(*asked.tolist())
    J = contact_impulse(v, m, torch.ones(200, dtype=torch.bool), gravity=G, dt=DT, friction=mu)
    slack = 1e-12  # rounding of sums of numbers ~ 10, and of v ~ 40 after 200 steps
    assert (J[:, 2] >= -slack).all()
    if math.isfinite(mu):
        assert (J[:, :2].norm(dim=1) <= mu * J[:, 2] + slack).all()
    assert ((asked - J) * J).sum(1).abs().max() < 100 * slack
    angle = torch.linspace(0, 2 * math.pi, 60, dtype=torch.float64)
    out, up = (1.0, 0.0) if math.isinf(mu) else (mu, 1.0)
    edge = torch.stack([out * angle.cos(), out * angle.sin(), torch.full_like(angle, up)], 1)
    assert ((asked - J) @ edge.T / edge.norm(dim=1)).max() < slack


def test_contact_explains_a_bounce_but_no_push_in_mid_air_and_no_pull():
    """Bounce, drop, the same push without touch, and glue: r = 0, 0, J/M, J/M, with M = 2 kg."""
    v, m = asking((0.3, 0.0, 4.0), (0.0, 0.0, 0.0), (0.0, 0.0, 4.0), (0.0, 0.0, -4.0))
    touching = torch.tensor([True, False, False, True])
    J = contact_impulse(v, m, touching, gravity=G, dt=DT, friction=0.5)
    torch.testing.assert_close(J[0], torch.tensor([0.3, 0.0, 4.0], dtype=torch.float64))
    loss = velocity_loss("momentum", v, m, gravity=G, dt=DT, impulse=J)
    torch.testing.assert_close(loss.item(), 2 * (4.0 / 2.0) ** 2 / 4, rtol=1e-12, atol=0)


def test_contact_residual_has_its_exact_gradient_though_the_impulse_is_constant():
    """d/dR |R − P(R)|² = 2 (R − P(R)) for the projection on a convex set."""
    v, m = asking((3.0, 0.0, 4.0), (1.0, 2.0, -1.0), (0.1, 0.0, 2.0))
    touching = torch.tensor([True, True, True])

    def loss(v):
        J = contact_impulse(v, m, touching, gravity=G, dt=DT, friction=0.5)
        return velocity_loss("momentum", v, m, gravity=G, dt=DT, impulse=J)

    v = v.clone().requires_grad_()
    (grad,) = torch.autograd.grad(loss(v), v)
    direction = normal(*v.shape)
    h = 1e-6  # quadratic between kinks: the central difference is exact up to rounding 1e-16 / h
    difference = (loss(v + h * direction) - loss(v - h * direction)) / (2 * h)
    torch.testing.assert_close((grad * direction).sum(), difference.detach(), rtol=1e-7, atol=1e-9)


def test_velocity_component_weighs_and_says_what_it_needs():
    v, m = torch.zeros(3, 4, 3, dtype=torch.float64), masses()
    loss = Velocity("literal", 0.2)(v, m, gravity=G, dt=DT)
    torch.testing.assert_close(loss.item(), 0.2 * (9.8 * DT) ** 2, rtol=1e-13, atol=0)
    assert [Velocity(f, 0.2).needs for f in ("literal", "consistent", "momentum")] == [None, "expected_dv", "impulse"]
    assert Velocity("consistent").needs is None  # weight 0: nothing is gathered


def test_velocity_names_what_is_wrong():
    v, m = free_fall(), masses()
    with pytest.raises(ValueError, match=r"needs expected_dv \(4, 4, 3\) from the simulator, got nothing"):
        velocity_loss("consistent", v, m, gravity=G, dt=DT)
    with pytest.raises(ValueError, match=r"needs impulse \(4, 3\) from the simulator, got \(5, 3\)"):
        velocity_loss("momentum", v, m, gravity=G, dt=DT, impulse=torch.zeros(5, 3))
    with pytest.raises(ValueError, match="whole trajectory"):
        velocity_loss("literal", v[:1], m, gravity=G, dt=DT)
    with pytest.raises(ValueError, match="one mass per particle"):
        velocity_loss("literal", v, m[:2], gravity=G, dt=DT)
    with pytest.raises(ValueError, match="positive time"):
        velocity_loss("literal", v, m, gravity=G, dt=0.0)
    with pytest.raises(ValueError, match="'newton'"):
        Velocity("newton")
    with pytest.raises(ValueError, match="≥ 0"):
        Velocity(weight=-1.0)


def picture(at, size=24, width=2.0):
    """A grey spot of Gaussian profile on white, centred at a column and row."""
    q = torch.arange(size, dtype=torch.float64) + 0.5
    spot = torch.exp(-((q[:, None] - at[1]) ** 2 + (q - at[0]) ** 2) / (2 * width**2))
    return 1 - 0.7 * spot[..., None].expand(-1, -1, 3)


def test_the_centroid_of_a_spot_is_its_centre():
    """Sums over the pixels of a Gaussian of 2 px are integrals to exp(−2π²σ²) ~ 1e-34 and tails e^(−25)."""
    white = torch.ones(3, dtype=torch.float64)
    for at in ((12.0, 12.0), (11.3, 13.1)):
        found = centroid(picture(at), white)
        torch.testing.assert_close(found, torch.tensor(at, dtype=torch.float64), rtol=0, atol=1e-8)
    with pytest.raises(ValueError, match="all background"):
        centroid(torch.ones(8, 8, 3), torch.ones(3))


def test_image_velocity_is_that_of_the_centroid_in_metres():
    """One falls at 3 px a frame, the other rests: pixel · 3 px / Δt = 0.9 m/s; the same velocity elsewhere is none."""
    t = torch.arange(4, dtype=torch.float64)[:, None]
    falls = t * torch.tensor([0.0, 3.0], dtype=torch.float64)
    loss = image_velocity_loss(falls, torch.zeros_like(falls), pixel=0.01, dt=1 / 30)
    torch.testing.assert_close(loss.item(), 0.81, rtol=1e-12, atol=0)
    assert image_velocity_loss(falls, falls + 5.0, pixel=0.01, dt=1 / 30) < 1e-24
    with pytest.raises(ValueError, match="T ≥ 2"):
        image_velocity_loss(falls, falls[:2], pixel=0.01, dt=1 / 30)


def test_image_velocity_has_its_exact_gradient():
    """From pixels to the loss, by central differences in float64."""
    white, target = torch.ones(3, dtype=torch.float64), normal(3, 2)
    clip = torch.stack([picture((4.0 + k, 5.0), 9) for k in range(3)]).requires_grad_()

    def loss(clip):
        return image_velocity_loss(torch.stack([centroid(p, white) for p in clip]), target, pixel=0.01, dt=0.1)

    assert torch.autograd.gradcheck(loss, (clip,))
