"""What the network sees, and the encoder of patches."""

import pytest
import torch

from diffuphy.material.encoder import Block, Encoder, PatchEmbedding, features


def gaussians(n=7, seed=0):
    g = torch.Generator().manual_seed(seed)
    a = torch.randn(n, 3, 3, generator=g, dtype=torch.float64)
    cov = a @ a.mT + 0.1 * torch.eye(3, dtype=torch.float64)
    x, colors, opacities = (torch.rand(n, *s, generator=g, dtype=torch.float64) for s in ((3,), (3,), ()))
    return x, colors, opacities, cov


def test_features_of_the_covariance_are_its_logarithm():
    """Upper triangle of ln Σ with √2 off the diagonal: the exponential gives Σ back, the norm is that of ln Σ."""
    x, colors, opacities, cov = gaussians()
    points = features(x, colors, opacities, cov)
    log_cov = torch.zeros(7, 3, 3, dtype=torch.float64)
    row, col = torch.triu_indices(3, 3)
    log_cov[:, row, col] = points.f[:, :6] / torch.where(row == col, 1, 2).double().sqrt()
    log_cov = log_cov + log_cov.triu(1).mT
    # eigh and matrix_exp in float64, condition of Σ up to ~100
    torch.testing.assert_close(torch.linalg.matrix_exp(log_cov), cov, rtol=1e-11, atol=1e-12)
    torch.testing.assert_close(points.f[:, :6].norm(dim=1), log_cov.flatten(1).norm(dim=1), rtol=1e-13, atol=0)
    assert torch.equal(points.f[:, 6], opacities) and torch.equal(points.f[:, 7:], colors)


def test_features_shift_only_the_diagonal_when_the_unit_changes():
    """ln(s² Σ) = ln Σ + 2 ln s · I."""
    x, colors, opacities, cov = gaussians()
    shift = features(x, colors, opacities, 100.0 * cov).f - features(x, colors, opacities, cov).f
    want = torch.zeros(10, dtype=torch.float64)
    want[[0, 3, 5]] = torch.tensor(100.0, dtype=torch.float64).log()
    torch.testing.assert_close(shift, want.expand_as(shift), rtol=0, atol=1e-12)


def test_features_of_a_disc_are_finite():
    """One zero extent is a disc, whose thickness stops at √1e-6 of its size; no extent at all is refused."""
    x, colors, opacities, _ = gaussians(1)
    disc = torch.diag(torch.tensor([1.0, 1.0, 0.0], dtype=torch.float64))[None]
    f = features(x, colors, opacities, disc).f
    torch.testing.assert_close(f[0, 5], torch.tensor(1e-6 * 2.0, dtype=torch.float64).log())
    with pytest.raises(ValueError, match="covariance 0 has trace"):
        features(x, colors, opacities, 0 * disc)


def test_features_name_the_wrong_shape():
    x, colors, opacities, cov = gaussians()
    with pytest.raises(ValueError, match=r"opacities \(7, 1\), not \(7,\)"):
        features(x, colors, opacities[:, None], cov)


def test_patch_embedding_does_not_depend_on_the_order_within_a_patch():
    """A PointNet is a function of the set; a reshape in place of a transpose would mix features with points."""
    embed = PatchEmbedding(13, 8).double()
    groups = torch.randn(4, 6, 13, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    order = torch.tensor([3, 0, 5, 1, 4, 2])
    torch.testing.assert_close(embed(groups[:, order]), embed(groups), rtol=1e-12, atol=1e-14)


def test_patch_embedding_of_one_patch_ignores_the_others():
    embed = PatchEmbedding(13, 8).double()
    groups = torch.randn(4, 6, 13, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(embed(groups[2:3]), embed(groups)[2:3], rtol=1e-12, atol=1e-14)


def test_block_is_the_pre_norm_transformer_of_torch():
    """Same weights, same answer as ``nn.MultiheadAttention`` in a pre-norm residual block."""
    block = Block(12, 3).double()
    reference = torch.nn.MultiheadAttention(12, 3, bias=True, batch_first=True, dtype=torch.float64)
    with torch.no_grad():
        reference.in_proj_weight.copy_(block.qkv.weight)
        reference.in_proj_bias.zero_()
        reference.out_proj.weight.copy_(block.out.weight)
        reference.out_proj.bias.copy_(block.out.bias)
    x = torch.randn(5, 12, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    y = block.norm_attention(x)
    want = x + reference(y, y, y, need_weights=False)[0]
    want = want + block.mlp(block.norm_mlp(want))
    torch.testing.assert_close(block(x), want, rtol=1e-12, atol=1e-13)


def test_encoder_gives_every_token_context():
    """With attention, one patch changes the tokens of the others; at depth 0 it does not."""
    g = torch.Generator().manual_seed(0)
    groups, centres = torch.randn(4, 6, 13, generator=g), torch.randn(4, 3, generator=g)
    other = groups.clone()
    other[0] += 1.0
    for depth in (0, 2):
        encoder = Encoder(13, 8, depth, 2)
        same = torch.equal(encoder(groups, centres)[1:], encoder(other, centres)[1:])
        assert same == (depth == 0)
