"""A constitutive law of one's own: a Hencky solid that stiffens with strain, dropped beside an ordinary one.

    ψ = μ |e|² + λ/2 (tr e)² + β μ |e|⁴,   T_i = (2μ + 4βμ |e|²) e_i + λ tr e

A law is its energy, its principal stress, the adjoint of that and the divided differences of the stress; it may lean
on another one, as here. What follows by itself: kernels for CPU and CUDA, gradients through the simulation, mixtures
with every other law, the time step.

    python examples/new_law.py
    python examples/new_law.py --particles 300

4 seconds of one core.
"""

import argparse
import dataclasses

import torch
import warp as wp

from diffuphy.material import moduli
from diffuphy.material.elastic import ELASTIC, hencky
from diffuphy.material.expert import Elastic, ElasticFunctions, Layout
from diffuphy.material.presets import field, lookup
from diffuphy.mpm import HalfSpace, Scene, rollout

BETA = 20.0
"""Stiffening β [-]: the slope of the stress is doubled at a strain of √(1/(6β)) = 9 %."""


def build(layout: Layout) -> ElasticFunctions:
    real, vec3, theta_t = layout.real, layout.vec3, layout.theta_t
    base, m, beta = hencky.build(layout), moduli.build(layout), real(BETA)

    @wp.func(module="unique")
    def energy(s: vec3, d: vec3, e: vec3, theta: theta_t) -> real:
        mu, _lam = m.lame(theta)
        n = wp.dot(e, e)
        return base.energy(s, d, e, theta) + beta * mu * n * n

    @wp.func(module="unique")
    def stress(s: vec3, d: vec3, e: vec3, theta: theta_t) -> vec3:
        mu, _lam = m.lame(theta)
        return base.stress(s, d, e, theta) + real(4.0) * beta * mu * wp.dot(e, e) * e

    @wp.func(module="unique")
    def stress_adjoint(s: vec3, d: vec3, e: vec3, theta: theta_t, T_bar: vec3):
        mu, _lam = m.lame(theta)
        n, eT = wp.dot(e, e), wp.dot(e, T_bar)
        e_bar, theta_bar = base.stress_adjoint(s, d, e, theta, T_bar)
        e_bar += real(4.0) * beta * mu * (n * T_bar + real(2.0) * eT * e)
        return e_bar, theta_bar + m.adjoint(theta, real(4.0) * beta * n * eT, real(0.0))

    @wp.func(module="unique")
    def slope(s: vec3, d: vec3, e: vec3, theta: theta_t) -> vec3:
        return (real(1.0) + real(2.0) * beta * wp.dot(e, e)) * base.slope(s, d, e, theta)

    return ElasticFunctions(energy, stress, stress_adjoint, slope)


def energy_of(e: torch.Tensor, params: dict[str, torch.Tensor]) -> torch.Tensor:
    mu, _lam = moduli.lame(params)
    return hencky.energy(e, params) + BETA * mu * (e * e).sum(-1) ** 2


def stress_of(e: torch.Tensor, params: dict[str, torch.Tensor]) -> torch.Tensor:
    mu, _lam = moduli.lame(params)
    return hencky.stress(e, params) + (4 * BETA * mu * (e * e).sum(-1))[..., None] * e


LAW = Elastic(
    name="stiffening",
    params=(moduli.E, moduli.NU),
    build=build,
    wave_speed=moduli.p_wave_speed,
    energy=energy_of,
    stress=stress_of,
)
ELASTIC.setdefault(LAW.name, LAW)


def main(particles: int = 2000) -> dict[str, float]:
    a = 0.2 / round(particles ** (1 / 3))
    line = torch.arange(a / 2, 0.2, a)
    x = torch.cartesian_prod(line, line, line)
    scene = Scene(dx=2 * a, fps=60, frames=20, velocity=(0, 0, -2), lift=0.02, boundaries=(HalfSpace(),))
    jelly, flattest = field(lookup("jelly"), len(x)), {}
    for law in ("hencky", LAW.name):
        motion = rollout(scene, x, torch.full((len(x),), a**3), dataclasses.replace(jelly, elastic=(law,)))
        height = motion.x[:, :, 2].amax(1) - motion.x[:, :, 2].amin(1)
        flattest[law] = float(height.min() / height[0])
        print(f"{law}: flattened to {flattest[law]:.0%} of its height")
    return flattest


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--particles", type=int, default=2000)
    main(**vars(parser.parse_args()))
