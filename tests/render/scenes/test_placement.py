"""Gaussians and cameras moved together."""

import dataclasses

import torch

from diffuphy.render import orbit, render_gaussians
from diffuphy.render.scenes.placement import Placement
from diffuphy.types import Gaussians


def test_pictures_do_not_see_a_similarity() -> None:
    """render(P g, P camera) = render(g, camera): centres, orientations, sizes, and colours of degree 3."""
    r = torch.Generator().manual_seed(0)
    shapes = ((40, 3), (40, 4), (40, 3), (40,), (40, 16, 3))
    means, quats, scales, logits, sh = (torch.randn(*s, generator=r) for s in shapes)
    g = Gaussians(0.3 * means, quats, scales - 3, logits, 0.2 * sh)
    camera = orbit([20.0], [10.0], 3.0, width=32, height=32)
    turn = Placement.turns([("x", 30.0), ("y", -50.0), ("z", 110.0)])
    place = dataclasses.replace(turn, scale=2.5, shift=torch.tensor([0.3, -1.0, 0.7], dtype=torch.float64))
    there, here = render_gaussians(place(g), place.camera(camera)).rgb, render_gaussians(g, camera).rgb
    assert here.amax() > 0.3
    # colours of about 1, rounded at 1e-6 by the fit of the coefficients; edges of the cut-off shift by rounding
    torch.testing.assert_close(there, here, rtol=1e-4, atol=5e-4)


def test_a_placement_that_does_nothing_keeps_every_bit() -> None:
    r = torch.Generator().manual_seed(0)
    g = Gaussians(*(torch.randn(*s, generator=r) for s in ((5, 3), (5, 4), (5, 3), (5,), (5, 9, 3))))
    same = Placement.turns(())(g)
    assert all(torch.equal(getattr(same, f.name), getattr(g, f.name)) for f in dataclasses.fields(g))
