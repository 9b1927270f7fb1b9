"""Drives within a whole simulation: what is held moves as a rigid body, whatever its neighbours do."""

import dataclasses

import pytest
import torch

from diffuphy.mpm import Held, Impulse, InBox, Release, Scene, Scheme, rollout, simulate
from tests.mpm.bodies import block, field, rotation

DX = 0.05


@pytest.mark.parametrize("scheme", [Scheme(), Scheme.mls()], ids=["default", "mls"])
def test_what_is_held_turns_as_a_rigid_body(scheme):
    """x = c + V t + R(ω t)(x₀ − c) and F = R(ω t) of the lower half of a block that is twisted; the upper half, which
    shares nodes with it, is strained and follows."""
    x, vol = block((2, 2, 4), DX)
    held, spin, V = x[:, 2] < 2 * DX, 8.0, (0.1, 0.0, 0.0)
    drive = Held(
        where=InBox(low=(-1.0, -1.0, -1.0), high=(1.0, 1.0, 2 * DX)), center=(DX, DX, 0.0), velocity=V,
        angular_velocity=(0.0, 0.0, spin),
    )  # fmt: skip
    scene = Scene(dx=DX, fps=50.0, frames=3, boundaries=(), lift=None, drives=(drive,), scheme=scheme)
    *_, end = simulate(scene, x, vol, field(len(x)))
    t, c = 3 / 50, x.new_tensor([DX, DX, 0.0])
    R = rotation((0.0, 0.0, 1.0), spin * t)
    # chords of the arc, in exact arithmetic on the circle: about 50 substeps of rounding
    torch.testing.assert_close(
        end.x[held], c + t * x.new_tensor(V) + (x[held] - c) @ R.T, rtol=0, atol=1e-12
    )  # fmt: skip
    torch.testing.assert_close(end.F[held], R.expand(int(held.sum()), 3, 3), rtol=0, atol=1e-12)
    strain = end.F[~held].mT @ end.F[~held] - torch.eye(3, dtype=x.dtype)
    assert float(strain.abs().max()) > 1e-2
    assert float((end.x[~held] - x[~held]).norm(dim=1).min()) > 1e-3


def test_what_is_not_yet_released_does_not_deform():
    """v = 0 and F = I until the plane has passed, however the body beside it moves."""
    x, vol = block((2, 2, 4), DX)
    drive = Release(point=(0.0, 0.0, 0.0), normal=(0.0, 0.0, 1.0), speed=1.2)
    scene = Scene(dx=DX, fps=50.0, frames=3, boundaries=(), lift=None, drives=(drive,))
    *_, end = simulate(scene, x, vol, field(len(x), E=2e4))
    still = x[:, 2] > 0.06 * 1.2 + DX / 4  # half of a particle and more above the plane at the end
    assert 0 < int(still.sum()) < len(x)
    assert torch.equal(end.x[still], x[still]) and not bool(end.He[still].any())
    assert float(end.x[~still][:, 2].mean() - x[~still][:, 2].mean()) < 0


def test_the_gradient_of_an_impulse_in_density_is_that_of_the_mass_it_is_shared_by():
    """A body at rest is set in motion as a whole: Δv = (J_1 + J_2)/M, so ∂(a·v)/∂ρ_q = −a·(J_1 + J_2) V_q/M²."""
    x, vol = block((2, 2, 2), DX, (0.01, 0.02, 0.03))
    kicks = Impulse(impulse=(1e-3, 0.0, 2e-3), duration=0.01), Impulse(impulse=(0.0, 3e-3, 0.0), start=0.005)
    scene = Scene(gravity=(0.0, 0.0, 0.0), dx=DX, fps=25.0, boundaries=(), lift=None, drives=kicks, scheme=Scheme.mls())
    f = field(len(x))
    f.rho.mul_(torch.linspace(0.5, 2.0, len(x), dtype=x.dtype)).requires_grad_()
    out = rollout(scene, x, vol, f, frames=1, grad=True)
    J, a = x.new_tensor([1e-3, 3e-3, 2e-3]), x.new_tensor([0.3, -0.5, 0.7])
    M = (f.rho.detach() * vol).sum()
    (rho_bar,) = torch.autograd.grad((out.v[-1, 5] * a).sum(), f.rho)
    # rounding of a few hundred sums over 27 nodes of terms that cancel but for 1/64, the share of one particle
    torch.testing.assert_close(rho_bar, -(J @ a) * vol / M**2, rtol=1e-9, atol=0)


def test_the_gradient_in_density_of_impulses_on_parts_of_a_body_is_that_of_central_differences():
    """Two impulses on different halves of an elastic body, in different frames; a random loss, float64."""
    x, vol = block((2, 2, 2), DX, (0.01, 0.02, 0.03))
    upper = InBox(low=(-1.0, -1.0, 0.08), high=(1.0, 1.0, 1.0))
    kicks = (
        Impulse(impulse=(5e-3, 0.0, 2e-2), duration=0.01, where=upper),
        Impulse(impulse=(0.0, 1e-2, 0.0), start=0.015, where=tuple(range(0, len(x), 3))),
    )
    scene = Scene(
        gravity=(0.0, 0.0, 0.0), dx=DX, fps=100.0, boundaries=(), lift=None, drives=kicks, scheme=Scheme.mls()
    )
    g = torch.Generator().manual_seed(0)
    weights = [torch.randn(3, len(x), 3, generator=g, dtype=x.dtype) for _ in range(2)]
    delta = torch.randn(len(x), generator=g, dtype=x.dtype)

    def loss(rho: torch.Tensor, grad: bool) -> torch.Tensor:
        f = dataclasses.replace(field(len(x), E=1e4), rho=rho)
        out = rollout(scene, x, vol, f, frames=2, dt=1e-3, grad=grad)
        return sum((a * b).sum() for a, b in zip(weights, (out.x, 0.1 * out.v), strict=True))

    rho = (1000.0 * torch.linspace(0.5, 2.0, len(x), dtype=x.dtype)).requires_grad_()
    (rho_bar,) = torch.autograd.grad(loss(rho, True), rho)
    exact, at, h = float((rho_bar * delta).sum()), rho.detach(), 1e-1
    with torch.no_grad():
        near, far = (float(loss(at + k * h * delta, False) - loss(at - k * h * delta, False)) for k in (1, 2))
    # steps of 1e-4 of ρ: truncation 1e-16, rounding 1e-15 of a loss ten times its change in ρ, over 1e-4
    assert (8 * near - far) / (12 * h) == pytest.approx(exact, rel=1e-8)
