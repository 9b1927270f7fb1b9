"""Scenes in one launch are the scenes alone."""

import dataclasses

import pytest
import torch

from diffuphy.mpm import HalfSpace, Impulse, Scene, rollout, rollout_batch, simulate
from diffuphy.types import MaterialField
from tests.mpm.bodies import block, field

SCENE = Scene(
    dx=0.05, fps=60.0, frames=2, velocity=(0.5, 0.2, -2.0), spin=(1.0, 2.0, 0.0), lift=0.01,
    boundaries=(HalfSpace(friction=0.3),),
)  # fmt: skip
X, VOL = block((3, 2, 2), 0.05, (0.013, 0.021, 0.0))
STIFFEST = 2e5


def materials(*moduli: float) -> list[MaterialField]:
    return [field(len(X), E=E) for E in moduli]


@pytest.mark.parametrize("threads", [1, 2])
def test_scenes_of_a_batch_are_the_scenes_alone_to_the_last_bit(threads):
    """Same Δt, same block of nodes: a scene whose fastest wave sets the step of all is the one that runs alone with it.
    Without retention and elastic contact, which go by the fastest wave of all, so is every other."""
    scene = dataclasses.replace(SCENE, scheme=dataclasses.replace(SCENE.scheme, retain=0.0, contact="rigid"), frames=1)
    dt = 2e-4
    films = rollout_batch(scene, X, VOL, materials(5e4, STIFFEST, 1e5), dt=dt, threads=threads)
    for film, f in zip(films, materials(5e4, STIFFEST, 1e5), strict=True):
        alone = rollout(scene, X, VOL, f, dt=dt)
        assert all(torch.equal(getattr(film, k), getattr(alone, k)) for k in ("x", "v", "F"))
    assert not torch.equal(films[0].x, films[1].x)


def test_gradients_of_a_batch_are_those_of_the_scenes():
    """∂/∂E_k of Σ_k L_k is ∂L_k/∂E_k, and that in a shared x is the sum: to rounding, as L_k weighs its terms alike."""
    scene = dataclasses.replace(SCENE, scheme=dataclasses.replace(SCENE.scheme, retain=0.0, contact="rigid"), frames=1)

    def leaf(E: float) -> MaterialField:
        f = field(len(X))
        return dataclasses.replace(f, theta=f.theta | {"E": torch.full_like(f.rho, E).requires_grad_()})

    def loss(film) -> torch.Tensor:
        return film.x[-1].square().sum() + film.F[-1].square().sum()

    fields, x = [leaf(5e4), leaf(STIFFEST)], X.clone().requires_grad_()
    films = rollout_batch(scene, x, VOL, fields, dt=2e-4, grad=True)
    together = torch.autograd.grad(sum(loss(film) for film in films), [x, *(f.theta["E"] for f in fields)])
    x_bar = torch.zeros_like(X)
    for k, E in enumerate((5e4, STIFFEST)):
        f, x = leaf(E), X.clone().requires_grad_()
        x_k, E_k = torch.autograd.grad(loss(rollout(scene, x, VOL, f, dt=2e-4, grad=True)), [x, f.theta["E"]])
        assert torch.equal(E_k, together[1 + k])
        x_bar += x_k
    # the lift that puts the lowest particle on the floor is held fixed in both: no other term is shared
    torch.testing.assert_close(together[0], x_bar, rtol=0, atol=1e-13 * float(x_bar.abs().max()))


def test_the_step_of_a_batch_is_that_of_its_stiffest_scene():
    reports, alone = [], []
    rollout_batch(SCENE, X, VOL, materials(5e4, STIFFEST), report=reports)
    rollout(SCENE, X, VOL, materials(STIFFEST)[0], report=alone)
    assert reports[0].dt == alone[0].dt and reports[0].wave == alone[0].wave


def test_options_of_one_scene_reach_all():
    """A velocity and a body acceleration given for N particles act in each scene alike."""
    push = 0.1 * torch.sin(30.0 * X)
    films = rollout_batch(
        SCENE, X, VOL, materials(1e5, 1e5), velocity=push, body=lambda t: 50.0 * t * torch.cos(30.0 * X)
    )  # fmt: skip
    assert torch.equal(films[0].x, films[1].x) and torch.equal(films[0].v, films[1].v)
    (start,) = simulate(SCENE, X, VOL, materials(1e5)[0], velocity=push, frames=0)
    assert torch.equal(films[1].v[0], start.v)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"fields": []}, "at least one"),
        ({"fields": [field(len(X)), field(len(X), ("hencky",))]}, r"fields\[1\] has the laws"),
        ({"gather": ("impulse",)}, "takes no gather"),
        ({"state": object()}, "takes no state"),
        (
            {"scene": dataclasses.replace(SCENE, drives=(Impulse(impulse=(0, 0, 1)),))},
            "Impulse",
        ),
    ],
)
def test_what_has_no_meaning_for_a_batch_is_refused(change, message):
    given = {"scene": SCENE, "fields": materials(1e5, 1e5)} | change
    with pytest.raises(ValueError, match=message):
        rollout_batch(given.pop("scene"), X, VOL, given.pop("fields"), **given)
