"""Timings of what is neither simulation nor picture: the material network, the rays of the embedded prior, and labels
that are looked for."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import torch

from benchmarks.speed.body import material, now
from benchmarks.speed.prices import Row
from benchmarks.speed.simulation import best
from diffuphy.cost.learning import flops
from diffuphy.material import ELASTIC
from diffuphy.material.encoder import N_FEATURES, Points
from diffuphy.material.labelled import of_particles
from diffuphy.material.net import Net
from diffuphy.render import orbit
from diffuphy.text2gs.shapes import Library
from diffuphy.types import Look, Particles

OBJECTS = ("ball", "snowman", "duck", "mug", "burger", "pancakes")
"""Objects of few and of many primitives."""


def network(particles: int, net: Net, repeat: int, device: str) -> dict[str, Any]:
    """Milliseconds of a step of the material network, forward and backward."""
    g = torch.Generator().manual_seed(0)
    points = Points(
        torch.rand(particles, 3, generator=g).to(device), torch.rand(particles, N_FEATURES, generator=g).to(device)
    )
    laws = ("neo_hookean", "hencky"), ("identity", "von_mises"), ()
    start = material(laws, particles, torch.float32).to(device)
    E = dataclasses.replace(next(p for p in ELASTIC["hencky"].params if p.name == "E"), lo=1e3, hi=1e7)
    model = net.build(points, start, [E])

    def step() -> float:
        begin = now(device)
        field = model()
        (field.w_e.square().sum() + field.w_p.square().sum() + field.theta["E"].log().sum()).backward()
        return now(device) - begin

    return {"particles": particles, "groups": net.groups, "width": net.width, "depth": net.depth,
            "ms": 1e3 * best(step, repeat), "flop": flops(net, particles, 4)}  # fmt: skip


def networks(repeat: int, device: str, quick: bool) -> list[dict[str, Any]]:
    """Several sizes."""
    small, usual = Net(groups=16, group_size=16, width=32, depth=1), Net()
    sizes = [(300, small), (1500, usual)]
    return [network(n, net, repeat, device) for n, net in (sizes if quick else [*sizes, (4000, usual), (1500, small)])]


def rays(repeat: int, device: str, size: int = 96) -> list[dict[str, Any]]:
    """Milliseconds of a reference picture of the embedded prior."""
    found = []
    for name in OBJECTS:
        library, camera = Library(variants=1), orbit([30.0], 20.0, 3.4, width=size, height=size).to(device)
        shape = library.object(Look(name, f"a {name}"))

        def trace(shape: Any = shape, camera: Any = camera) -> float:
            begin = now(device)
            shape.render(camera, 2)
            return now(device) - begin

        found.append(
            {"object": name, "size": size, "rays": 4 * size**2, "crowd": shape.crowd, "ms": 1e3 * best(trace, repeat)}
        )
    return found


def labels(repeat: int, device: str, sizes: Sequence[int] = (4_000, 16_000)) -> list[Row]:
    """Timed work of finding, for each particle inside, the nearest one of known label; half of them are inside."""
    found = []
    for n in sizes:
        g = torch.Generator().manual_seed(0)
        index = torch.arange(n)
        carried = torch.where(index % 2 == 0, index // 2, -1)
        x = torch.rand(n, 3, generator=g)
        particles = Particles(x, torch.ones(n), carried, 1.0, (0.0, 0.0, 0.0), n ** (-1 / 3)).to(device)
        known = (torch.arange(n // 2) % 2).to(device)

        def look(particles: Particles = particles, known: torch.Tensor = known) -> float:
            begin = now(device)
            of_particles(known, particles)
            return now(device) - begin

        found.append(({"label.pair": n**2 / 4}, best(look, repeat)))
    return found


def rows(nets: list[dict[str, Any]], traced: list[dict[str, Any]]) -> tuple[list[Row], list[Row]]:
    """The same as timed work: of a training step, and of references."""
    return (
        [({"train": 1.0, "train.flop": r["flop"]}, 1e-3 * r["ms"]) for r in nets],
        [({"ray": float(r["rays"]), "ray.primitive": r["rays"] * r["crowd"]}, 1e-3 * r["ms"]) for r in traced],
    )
