"""Gradients of whole frames against central differences, exact adjoint identities, and independence of how they are
computed."""

import dataclasses
import math

import pytest
import torch

from diffuphy.mpm import (
    Attractor,
    Controls,
    Drag,
    HalfSpace,
    Held,
    InBox,
    Scene,
    Scheme,
    Sphere,
    rollout,
    simulate,
)
from diffuphy.types import MaterialField
from tests.mpm.bodies import block, field

DX = 0.1
WALLS = (
    HalfSpace(friction=0.3, velocity=(0.1, 0.0, 0.05)),
    Sphere(center=(0.35, 0.35, -0.1), radius=0.25, friction=0.2),
    HalfSpace(point=(0.12, 0.0, 0.0), normal=(1.0, 0.0, 0.2), kind="slip", start=0.002),
    HalfSpace(point=(0.0, 0.42, 0.0), normal=(0.0, -1.0, 0.0), kind="sticky", end=0.006),
)
SCENE = Scene(
    gravity=(0.0, 0.3, -9.81),
    dx=DX,
    fps=120.0,
    frames=2,
    boundaries=WALLS,
    lift=None,
    velocity=(0.2, 0.1, -1.5),
    spin=(1.0, 2.0, -1.0),
)
LAWS = {
    "elastic": (("neo_hookean",), ("identity",)),
    "grains": (("hencky",), ("drucker_prager",)),
    "mixture": (("neo_hookean", "hencky"), ("identity", "von_mises", "drucker_prager")),
}
CORNER = (
    HalfSpace(kind="slip"),
    HalfSpace(kind="slip", point=(0.15, 0.0, 0.0), normal=(1.0, 0.0, 0.0)),
    HalfSpace(kind="sticky", point=(0.0, 0.39, 0.0), normal=(0.0, -1.0, 0.0)),
)
"""Three mirrors, one of them sticky and above the body, with their edges and their corner."""
BESIDE_MIRRORS = (
    HalfSpace(kind="slip"),
    HalfSpace(kind="slip", point=(0.15, 0.0, 0.0), normal=(1.0, 0.0, 0.1)),
    HalfSpace(kind="sticky", point=(0.0, 0.39, 0.0), normal=(0.0, -1.0, 0.2)),
)
"""A mirror, and walls across it that set their nodes, and so those of its images."""
MOVING = (
    HalfSpace(friction=0.3, velocity=(0.1, 0.0, 0.05)),
    HalfSpace(point=(0.12, 0.0, 0.0), normal=(1.0, 0.0, 0.2), kind="slip", start=0.002, velocity=(0.2, 0.0, 0.1)),
)
DRIVES = (
    Attractor(center=(0.3, 0.1, 0.2), strength=5.0, radius=0.2),
    Drag(velocity=(0.5, 0.0, 0.0), time=0.1, quadratic=0.3),
    Held(
        where=InBox(low=(0.1, 0.1, 0.15), high=(0.5, 0.25, 0.5)),
        center=(0.2, 0.2, 0.2),
        angular_velocity=(0.0, 1.0, 2.0),
    ),
)
CASES = {
    "plain": dataclasses.replace(SCENE, scheme=Scheme.mls()),
    "mirrors": dataclasses.replace(SCENE, boundaries=CORNER, spin=(1.0, 8.0, -5.0)),
    "beside mirrors": dataclasses.replace(SCENE, boundaries=BESIDE_MIRRORS, spin=(1.0, 8.0, -5.0)),
    "apic": dataclasses.replace(SCENE, scheme=Scheme.apic()),
    "cubic classic": dataclasses.replace(SCENE, scheme=Scheme(order=3, force="classic")),
    "cubic mls": dataclasses.replace(SCENE, scheme=Scheme(order=3)),
    "no half kick": dataclasses.replace(SCENE, scheme=Scheme(half_kick=False)),
    "no retention": dataclasses.replace(SCENE, scheme=Scheme(retain=0.0)),
    "no sharpening": dataclasses.replace(SCENE, scheme=Scheme(sharpen=False)),
    "classic": dataclasses.replace(SCENE, scheme=Scheme(force="classic")),
    "elastic contact": dataclasses.replace(SCENE, scheme=Scheme(contact="elastic")),
    "driven apic": dataclasses.replace(SCENE, scheme=Scheme.apic(), drives=DRIVES),
}
"""Scenes of the elastic body besides ``SCENE``; the variants of the first two are compiled in seconds."""


def problem(laws: str):
    """A few particles in four walls, with uneven material, and the tensors to differentiate in."""
    torch.manual_seed(1)
    x, vol = block((2, 2, 2), DX, (0.17, 0.16, 0.013))
    x = x + 0.01 * torch.rand_like(x)
    f = field(len(x), *LAWS[laws], E=2e4, yield_stress=300.0, cohesion=0.002)
    uneven = lambda t: t * (1 + 0.2 * torch.rand_like(t))  # noqa: E731
    inputs = {"x": x, "velocity": 0.2 * torch.randn_like(x), "rho": uneven(f.rho)} | {
        k: uneven(f.theta[k]) for k in ("E", "nu")
    }
    if laws != "elastic":
        inputs |= {k: uneven(f.theta[k]) for k in ("friction_angle", "cohesion")}
    if laws == "mixture":
        inputs["yield_stress"] = uneven(f.theta["yield_stress"])
        inputs |= {k: torch.softmax(torch.randn_like(w), 1) for k, w in (("w_e", f.w_e), ("w_p", f.w_p))}
    return inputs, vol, f


def run(inputs: dict[str, torch.Tensor], vol: torch.Tensor, f: MaterialField, scene: Scene = SCENE, **options):
    theta = f.theta | {k: v for k, v in inputs.items() if k in f.theta}
    weights = {k: inputs[k] for k in ("w_e", "w_p") if k in inputs}
    f = dataclasses.replace(f, theta=theta, rho=inputs["rho"], **weights)
    controls = Controls(*(inputs.get(k) for k in ("gravity", "wall friction", "wall velocity")))
    return rollout(
        scene, inputs["x"], vol, f, velocity=inputs["velocity"], dt=1e-3, controls=controls, **options
    )  # fmt: skip


def loss(out, seed: int = 0) -> torch.Tensor:
    """A random linear functional of every frame."""
    g = torch.Generator().manual_seed(seed)
    return sum(
        (torch.randn(t.shape, generator=g, dtype=torch.float64).to(t.dtype) * t).sum()
        for t in (out.x, 0.3 * out.v, 0.3 * out.F)
    )


def gradients(inputs, vol, f, **options) -> dict[str, torch.Tensor]:
    leaves = {k: t.clone().requires_grad_() for k, t in inputs.items()}
    out = loss(run(leaves, vol, f, grad=True, **options))
    return dict(zip(leaves, torch.autograd.grad(out, list(leaves.values())), strict=True))


def check_by_differences(inputs, vol, f, **options) -> None:
    """⟨∇L, δ⟩ = (L(θ + hδ) − L(θ − hδ)) / 2h for every input."""
    exact = gradients(inputs, vol, f, **options)
    for name, value in inputs.items():
        g = torch.Generator().manual_seed(7)
        delta = torch.randn(value.shape, generator=g, dtype=value.dtype) * value.abs().mean()
        if name in ("w_e", "w_p"):  # along the simplex
            delta -= delta.mean(1, keepdim=True)
        expected = float((exact[name] * delta).sum())
        scale = float((exact[name] * delta).abs().sum())  # of the terms: their sum may cancel by chance
        assert scale > 0, name
        errors = []
        for h in (1e-3, 1e-4, 1e-5, 1e-6, 1e-7):
            up, down = (float(loss(run(inputs | {name: value + s * h * delta}, vol, f, **options))) for s in (1, -1))
            errors.append(abs((up - down) / (2 * h) - expected) / scale)
        # truncation h² and rounding ε L/h balance near h = 1e-5 … 1e-6: 1e-10 L, some digits lost where L ≫ h ∇L
        assert min(errors) < 1e-7, f"{name}: {errors}"


@pytest.mark.parametrize("laws", list(LAWS))
def test_gradients_are_those_of_central_differences(laws):
    """Through contact, friction and flow: two frames, float64."""
    check_by_differences(*problem(laws))


@pytest.mark.parametrize(
    "case", [pytest.param(c, marks=() if c in ("plain", "mirrors") else pytest.mark.slow) for c in CASES]
)
def test_gradients_of_every_scheme_are_those_of_central_differences(case):
    """Each part of the scheme has its own adjoint: forces, splines, kicks, retention with the material in its time
    constant, sharpening with the mass in its weights, mirrors with their images."""
    check_by_differences(*problem("elastic"), scene=CASES[case])


@pytest.mark.parametrize("moving", [False, pytest.param(True, marks=pytest.mark.slow)], ids=["driven", "moving walls"])
def test_gradients_reach_gravity_walls_branches_and_drives(moving):
    """A Hencky body that flows and relaxes beside a Maxwell branch, pulled by fields and partly held: gravity, the
    parameters of the branch and an acceleration of every particle; with friction and velocity of moving walls."""
    inputs, vol, f = problem("grains")
    theta = f.theta | {k: torch.full_like(f.rho, v) for k, v in (
        ("E_N", 1e4), ("relaxation_time", 5e-3), ("bulk_relaxation", 0.3)
    )}  # fmt: skip
    f = dataclasses.replace(f, theta=theta, branches=("maxwell",))
    inputs |= {k: theta[k].clone() for k in ("E_N", "relaxation_time", "bulk_relaxation")}
    inputs["gravity"] = inputs["x"].new_tensor(SCENE.gravity)
    scene = dataclasses.replace(SCENE, boundaries=(), drives=DRIVES)
    if moving:
        scene = dataclasses.replace(SCENE, boundaries=MOVING)
        inputs["wall friction"] = inputs["x"].new_tensor([w.friction for w in MOVING])
        inputs["wall velocity"] = inputs["x"].new_tensor([w.velocity for w in MOVING])
    swing = torch.sin(20 * inputs["x"])
    check_by_differences(inputs, vol, f, scene=scene, body=lambda t: math.cos(300 * t) * swing)


@pytest.mark.parametrize("laws", list(LAWS))
def test_gradients_do_not_depend_on_segments_and_repeat_to_the_last_bit(laws):
    """Replaying 1, 3, 17 or all 41 rounds at a time gives the same bits; as do none and a second run."""
    inputs, vol, f = problem(laws)
    scene = dataclasses.replace(SCENE, fps=25.0, frames=1)
    first = gradients(inputs, vol, f, scene=scene)
    for how in ({}, {"segment": 1}, {"segment": 3}, {"segment": 17}, {"keep": True}):
        again = gradients(inputs, vol, f, scene=scene, **how)
        assert all(torch.equal(first[k], again[k]) for k in first)


def test_only_what_requires_a_gradient_gets_one():
    inputs, vol, f = problem("mixture")
    everything = gradients(inputs, vol, f)
    for name in ("E", "w_p", "rho", "velocity"):
        leaf = inputs[name].clone().requires_grad_()
        (alone,) = torch.autograd.grad(loss(run(inputs | {name: leaf}, vol, f, grad=True)), [leaf])
        assert torch.equal(alone, everything[name])
    assert not run({k: t.requires_grad_() for k, t in inputs.items()}, vol, f, grad=False).x.requires_grad


def test_momentum_is_adjoint_to_velocity_and_to_nothing_else():
    """P = Σ m v: ∂(P·a)/∂v0_p = m_p a; ∂P/∂E = ∂P/∂x0 = 0, over 100 substeps of a vibrating body in flight (exact,
    no differences)."""
    x, vol = block((2, 2, 2), DX, (0.113, 0.021, 0.337))
    scene = Scene(dx=DX, fps=40.0, frames=4, boundaries=(), lift=None)
    f = field(len(x))
    f.theta["E"].requires_grad_()
    v = torch.sin(20 * x).requires_grad_()
    x.requires_grad_()
    a = torch.tensor([0.3, -0.2, 0.9], dtype=x.dtype)
    out = rollout(scene, x, vol, f, velocity=v, dt=1e-3, grad=True)
    P = ((f.rho * vol)[:, None] * out.v[-1] * a).sum()
    v_bar, x_bar, E_bar = torch.autograd.grad(P, [v, x, f.theta["E"]])
    m = f.rho * vol
    torch.testing.assert_close(v_bar, m[:, None] * a, rtol=1e-11, atol=0)  # 100 substeps of sums over 27 nodes
    forces = float((f.theta["E"].detach() * vol).sum()) / DX  # the terms that cancel
    assert float(x_bar.abs().max()) < 1e-11 * forces
    assert float((E_bar * f.theta["E"].detach()).abs().max()) < 1e-11 * float(m.sum())


def test_angular_momentum_is_adjoint_to_velocity():
    """L = Σ m (x × v + D ε:C) about the origin without gravity: ∂(L·a)/∂v0_p = m_p a × x0_p."""
    x, vol = block((2, 2, 2), DX, (0.113, 0.021, 0.337))
    scene = Scene(gravity=(0.0, 0.0, 0.0), dx=DX, fps=40.0, frames=2, boundaries=(), lift=None)
    f, v = field(len(x)), torch.sin(20 * x).requires_grad_()
    a = torch.tensor([0.3, -0.2, 0.9], dtype=x.dtype)
    m = f.rho * vol
    *_, end = simulate(scene, x, vol, f, velocity=v, dt=1e-3, grad=True)
    C = end.C
    spin = torch.stack([C[:, 2, 1] - C[:, 1, 2], C[:, 0, 2] - C[:, 2, 0], C[:, 1, 0] - C[:, 0, 1]], 1)
    L = (m[:, None] * (torch.linalg.cross(end.x, end.v) + DX**2 / 4 * spin) * a).sum()
    (v_bar,) = torch.autograd.grad(L, [v])
    torch.testing.assert_close(
        v_bar, m[:, None] * torch.linalg.cross(a.expand_as(x), x), rtol=1e-10, atol=1e-12 * float(m.max())
    )


def test_float32_gradients_agree_with_float64():
    """Before contact to 1e-3 after 17 substeps: F = I + H rounds strains of 1e-2 to 1e-5 of themselves, and some
    digits cancel."""
    inputs, vol, f = problem("elastic")
    free = dataclasses.replace(SCENE, boundaries=())
    double = gradients(inputs, vol, f, scene=free)
    single = gradients(
        {k: t.float() for k, t in inputs.items()}, vol.float(), field(len(vol), E=2e4, dtype=torch.float32), scene=free
    )
    for k, g in double.items():
        assert float((single[k].double() - g).norm() / g.norm()) < 1e-3, k
