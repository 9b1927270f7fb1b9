"""Selections: bits of particles; and settings that are refused."""

import math

import numpy as np
import pytest
import torch

from diffuphy.mpm import (
    Acceleration,
    Attractor,
    Drag,
    Held,
    Impulse,
    InBall,
    InBox,
    InCylinder,
    Release,
    Scene,
    Schedule,
    Vortex,
)
from diffuphy.mpm.drive import TICK, tags

X = torch.cartesian_prod(*[torch.linspace(-1, 1, 5, dtype=torch.float64)] * 3)
M = torch.ones(len(X), dtype=torch.float64)
B = (1.0, 0.0, 0.0)


def test_tags_are_the_bits_of_the_selections():
    """Bit k of a tag says whether drive k acts on the particle: box, ball, cylinder, indices, mask, all."""
    mask = X[:, 0] > 0.4
    regions = [
        (InBox(low=(-1, -1, -1), high=(0, 0, 0)), (X <= 0).all(1)),
        (InBall(center=(0.5, 0, 0), radius=0.6), (X - torch.tensor([0.5, 0, 0])).norm(dim=1) <= 0.6),
        (
            InCylinder(center=(0, 0, 0), axis=(0, 2, 0), radius=0.6, height=1.0),
            (X[:, 1].abs() <= 0.5) & (X[:, [0, 2]].norm(dim=1) <= 0.6),
        ),
        ((3, 7), torch.isin(torch.arange(125), torch.tensor([3, 7]))),
        (mask, mask),
        (np.flatnonzero(mask.numpy()), mask),
        (None, torch.ones(125, dtype=torch.bool)),
    ]
    got = tags([Acceleration(acceleration=B, where=w) for w, _ in regions], X, M, 1.0)
    assert got.dtype == torch.int32
    for k, (_, want) in enumerate(regions):
        assert torch.equal(got >> k & 1 == 1, want), k


def test_times_of_release_follow_the_bits_and_the_last_one_counts():
    """Above the bits of n drives and that of what is one piece with them: ⌈t_p/TICK⌉, the later of two planes."""
    drives = [
        Acceleration(acceleration=B),
        Release(point=(-1, 0, 0), normal=(1, 0, 0), speed=3.0, start=0.5),
        Release(point=(0, 0, 0), normal=(0, 0, 1), speed=0.7, where=InBox(low=(0, 0, 0), high=(1, 1, 1))),
    ]
    got = tags(drives, X, M, 1.0)
    first = 0.5 + (X[:, 0] + 1) / 3
    second = torch.where((X >= 0).all(1), X[:, 2] / 0.7, 0.0)
    assert torch.equal(got >> 4, (torch.maximum(first, second) / TICK).ceil().int())


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda: tags([Acceleration(acceleration=B, where=(0, 125))], X, M, 1.0), "names particle 125, there are 125"),
        (
            lambda: tags([Impulse(impulse=B, where=InBall(center=(9, 9, 9), radius=1.0))], X, M, 1.0),
            r"drives\[0\], Impulse,",
        ),
        (
            lambda: tags([Release(point=(-1, 0, 0), normal=B, speed=1e-4)], X, M, 1.0),
            "particle 100 would be released after",
        ),
        (lambda: tags([Acceleration(acceleration=B)] * 31, X, M, 1.0), "at most 30 drives, got 31"),
        (lambda: Scene(drives=(B,)), r"drives\[0\] must be one of"),
        (lambda: Acceleration(acceleration=B, where=torch.zeros(5)), "a mask or indices of shape"),
        (lambda: Acceleration(acceleration=B, where=torch.zeros(5, dtype=torch.bool)), "at least one particle"),
        (lambda: Acceleration(acceleration=B, where=(-1,)), "from 0"),
        (lambda: Acceleration(acceleration=B, where="head"), "where must be InBox"),
        (lambda: Acceleration(acceleration=B, region=(0, 1)), "region must be InBox, InBall or None"),
        (lambda: Acceleration(acceleration=(1.0, math.nan, 0.0)), "acceleration must be three finite"),
        (lambda: Acceleration(acceleration=B, start=-1.0), "films begin at 0"),
        (lambda: Acceleration(acceleration=B, start=1.0, end=1.0), "start < end"),
        (lambda: Impulse(impulse=B, duration=0.0), "duration must be positive"),
        (lambda: Attractor(center=B, strength=math.inf, radius=1.0), "strength must be finite"),
        (lambda: Attractor(center=B, strength=1.0, radius=0.0), "radius must be positive"),
        (lambda: Vortex(center=B, strength=1.0, radius=1.0, axis=(0, 0, 0)), "axis must not be zero"),
        (Drag, "resists nothing"),
        (lambda: Drag(time=-1.0), "time must be positive"),
        (lambda: Drag(quadratic=-1.0), "quadratic must be finite and not negative"),
        (lambda: Held(velocity=B, schedule=Schedule(times=(0, 1), offsets=(B, B))), "have no velocity"),
        (lambda: Release(point=B, normal=B, speed=0.0), "speed must be positive"),
        (lambda: InBox(low=(0, 0, 0), high=(1, 0, 1)), "low must be below high"),
        (lambda: InBall(center=B, radius=-1.0), "radius must be positive"),
        (lambda: InCylinder(center=B, radius=1.0, height=0.0), "height must be positive"),
    ],
)
def test_drives_that_cannot_be_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_what_is_one_piece_with_held_matter_lies_within_a_cell_of_it():
    """The bit above those of n drives: some other particle within dx that a drive holds, of the same scene; not of what
    is held without being attached."""
    line = torch.stack([torch.arange(8.0), torch.zeros(8), torch.zeros(8)], 1)
    m = torch.ones(8)
    drives = [Acceleration(acceleration=B), Held(where=(2, 3)), Held(where=(7,), attached=False)]
    assert (tags(drives, line, m, 1.1) >> 3 & 1).tolist() == [0, 1, 1, 1, 1, 0, 0, 0]
    assert (tags(drives, line, m, 0.9) >> 3 & 1).sum() == 0
    alone = [Held(where=(2,))]  # it is no neighbour of its own
    assert (tags(alone, line, m, 1.1) >> 1 & 1).tolist() == [0, 1, 0, 1, 0, 0, 0, 0]
    # a second scene at the same place, in which nothing is held
    assert (tags(alone, line.repeat(2, 1), m.repeat(2), 1.1, 2) >> 1 & 1).sum() == 2
