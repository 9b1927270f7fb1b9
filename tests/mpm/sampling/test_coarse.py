"""Coarse copies of a body: every one of its particles one of the body's, volumes kept, kinds apart."""

import math

import pytest
import torch

from diffuphy.mpm.sampling.coarse import coarsen
from diffuphy.types import Particles


def ball(h=0.045):
    """A ball of radius ½ on a jittered lattice."""
    k = torch.arange(-0.5 + h / 2, 0.5, h)
    x = torch.cartesian_prod(k, k, k)
    x = x[x.norm(dim=1) < 0.5]
    x = x + 0.5 * h * (torch.rand(x.shape, generator=torch.Generator().manual_seed(0)) - 0.5)
    return Particles(x, torch.full((len(x),), h**3), torch.arange(len(x)), 0.5, (0.0, 0.0, 0.0), h)


def test_coarse_particles_are_fine_ones_with_all_the_volume():
    """Σ V is kept, every coarse particle is one of the fine, the centre of volume moves by less than a coarse cell's
    noise."""
    p = ball()
    coarse, kept = coarsen(p, n=800, seed=3)
    assert 500 < len(coarse) <= 800
    assert torch.equal(coarse.x, p.x[kept]) and torch.equal(coarse.gaussian, p.gaussian[kept])
    assert float(coarse.vol.double().sum()) == pytest.approx(float(p.vol.double().sum()), rel=1e-6)
    middle = [(q.vol[:, None] * q.x).sum(0) / q.vol.sum() for q in (p, coarse)]
    assert float((middle[1] - middle[0]).norm()) < coarse.spacing / math.sqrt(len(coarse)) * 3
    again, same = coarsen(p, n=800, seed=3)
    assert torch.equal(kept, same) and torch.equal(again.vol, coarse.vol)
    for wrong in (dict(), dict(n=0), dict(spacing=-1.0), dict(n=10, spacing=0.1)):
        with pytest.raises(ValueError):
            coarsen(p, **wrong)


def test_kinds_keep_their_volume_and_do_not_mix():
    """Σ V of each kind is kept to rounding, whatever the lattice; a layer thinner than a cell too. A group of less than
    half a cell is left only where none beside it is larger: in a layer of a third of a cell. One kind alone changes
    nothing."""
    p = ball()
    kind = torch.bucketize(p.x[:, 2].contiguous(), torch.tensor([-0.1, 0.02, 0.06]))
    for seed in range(3):
        coarse, kept = coarsen(p, n=300, seed=seed, kind=kind)
        assert 150 < len(coarse) <= 300 and torch.equal(coarse.x, p.x[kept])
        assert 0.04 < coarse.spacing  # the layer from 0.02 to 0.06
        want = torch.zeros(4, dtype=torch.float64).index_add_(0, kind, p.vol.double())
        got = torch.zeros(4, dtype=torch.float64).index_add_(0, kind[kept], coarse.vol.double())
        torch.testing.assert_close(got, want, rtol=1e-6, atol=0)  # each volume rounded to float32
        coarse, kept = coarsen(p, spacing=0.12, seed=seed, kind=kind)
        small, k = coarse.vol < 0.5 * 0.12**3, kind[kept]
        alike = k[small][:, None] == k[~small]
        # centres are 1.5 cells apart, and the particles that are kept 0.04 from them: half a diagonal of the fine cells
        assert bool((torch.cdist(coarse.x[small], coarse.x[~small])[alike] > 1.5 * 0.12 - 2 * 0.04).all())
        assert int((kind[kept] == 2).sum()) > 0.5 * math.pi * (0.5 / 0.12) ** 2  # cells in a cross-section: 55
    alone, same = coarsen(p, n=300, seed=1, kind=torch.full((len(p),), 7))
    plain, kept = coarsen(p, n=300, seed=1)
    assert torch.equal(same, kept) and torch.equal(alone.vol, plain.vol)
