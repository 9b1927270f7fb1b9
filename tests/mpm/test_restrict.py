"""The same body with fewer particles."""

import pytest
import torch

from diffuphy.material import presets
from diffuphy.mpm.restrict import restrict


def cloud(n=400, seed=0):
    """Particles of different volumes and densities anywhere in a box."""
    g = torch.Generator().manual_seed(seed)
    x = torch.rand(n, 3, generator=g, dtype=torch.float64) * torch.tensor([0.5, 0.3, 0.4])
    vol = 1e-5 * (1 + torch.rand(n, generator=g, dtype=torch.float64))
    return x, vol, 500 + 1000 * torch.rand(n, generator=g, dtype=torch.float64)


def test_mass_volume_and_centre_are_those_of_the_body():
    """Σ m_k = Σ m_p, Σ V_k = Σ V_p, Σ m_k x_k = Σ m_p x_p; sums of a few hundred numbers in float64."""
    x, vol, rho = cloud()
    r = restrict(x, vol, rho, spacing=0.02, side=0.1)
    m = rho * vol
    assert len(r) < len(x) / 2
    assert float(r.mass.sum()) == pytest.approx(float(m.sum()), rel=1e-13)
    assert float(r.vol.sum()) == pytest.approx(float(vol.sum()), rel=1e-13)
    torch.testing.assert_close(r.mass @ r.x / r.mass.sum(), m @ x / m.sum(), rtol=1e-13, atol=1e-14)


def test_every_particle_lies_in_the_cell_it_belongs_to():
    """|x_p − x_k| < side in every direction, and no two cells are one."""
    x, vol, rho = cloud()
    r = restrict(x, vol, rho, spacing=0.02, side=0.1)
    assert float((x - r.x[r.cell]).abs().max()) < 0.1 * (1 + 1e-5)
    assert len(torch.unique(r.cell)) == len(r)


def test_a_lattice_gives_full_cells_wherever_it_stands():
    """4³ cubes of 8 particles: each coarse one in the middle of its eight, of eight volumes; in float32, as films."""
    h = 0.5 / 8
    for shift in (0.0, 0.1234567, -3.3):
        a = (torch.arange(8) + 0.5) * h + shift
        x = torch.cartesian_prod(a, a, a).float()
        r = restrict(x, torch.full((512,), h**3), torch.ones(512), spacing=h, side=2 * h)
        assert len(r) == 64
        torch.testing.assert_close(r.vol, torch.full((64,), 8 * h**3, dtype=torch.float64))
        b = (torch.arange(4) + 0.5) * 2 * h + shift
        torch.testing.assert_close(r.x, torch.cartesian_prod(b, b, b).double(), rtol=0, atol=1e-6)


def test_means_of_a_rigid_motion_move_rigidly():
    """The mean of R x + t over a cell is R x̄ + t."""
    x, vol, rho = cloud()
    r = restrict(x, vol, rho, spacing=0.02, side=0.1)
    R = torch.linalg.qr(torch.randn(3, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64))[0]
    t = torch.tensor([0.3, -2.0, 1.0], dtype=torch.float64)
    torch.testing.assert_close(r(x @ R.T + t), r.x @ R.T + t, rtol=0, atol=1e-13)


def test_coarse_particles_keep_whole_laws_and_all_of_the_mass():
    """Rows stay one-hot, parameters are those of a particle of the cell, ρ_k V_k is the mass of the cell."""
    x, vol, _ = cloud()
    kinds = [presets.lookup(w) for w in ("rubber", "sand")]
    field = presets.field(kinds, (x[:, 2] > 0.2).long())
    r = restrict(x, vol, field.rho, spacing=0.02, side=0.1)
    small = r.field(field)
    assert set(small.w_p.unique().tolist()) == {0.0, 1.0}
    assert set(small.theta["E"].tolist()) <= set(field.theta["E"].tolist())
    assert torch.equal(r.cell[r.near], torch.arange(len(r)))
    torch.testing.assert_close(small.rho.double() * r.vol, r.mass, rtol=1e-6, atol=0)  # ρ is float32


def test_cells_no_larger_than_particles_are_refused():
    x, vol, rho = cloud()
    with pytest.raises(ValueError, match="side must be larger than spacing"):
        restrict(x, vol, rho, spacing=0.1, side=0.1)
