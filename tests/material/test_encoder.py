"""What the network sees, and the encoder of patches."""

import pytest
import torch

from diffuphy.material.encoder import Block, Encoder, PatchEmbedding, features


def gaussians(n=7, seed=0):
    g = torch.Generator().manual_seed(seed)
    a = torch.randn(n, 3, 3, generator=g, dtype=torch.float64)
    x, colors, opacities = (torch.rand(n, *s, generator=g, dtype=torch.float64) for s in ((3,), (3,), ()))
    return x, colors, opacities, a + a.mT


def test_features_of_the_covariance_keep_its_logarithm_and_norm():
    """Upper triangle of ln Σ with √2 off the diagonal; the same points from another frame, and back."""
    x, colors, opacities, log_cov = gaussians()
    points = features(x, colors, opacities, log_cov, opacities / 2)
    torch.testing.assert_close(points.f[:, :6].norm(dim=1), log_cov.flatten(1).norm(dim=1), rtol=1e-13, atol=0)
    assert torch.equal(points.f[:, 6], opacities) and torch.equal(points.color, colors)
    assert torch.equal(points.f[:, 10], opacities / 2)
    axes, origin = torch.linalg.qr(log_cov[0])[0], x[3]
    seen = points.seen_from(origin, axes)
    torch.testing.assert_close(seen.x, (x - origin) @ axes, rtol=0, atol=0)
    back = seen.seen_from(-axes.T @ origin, axes.T)
    torch.testing.assert_close(back.x, x, rtol=0, atol=1e-14)
    torch.testing.assert_close(back.f, points.f, rtol=0, atol=1e-13)
    want = features(x, colors, opacities, axes.T @ log_cov @ axes, opacities / 2)
    torch.testing.assert_close(seen.f, want.f, rtol=0, atol=1e-13)


def test_features_refuse_a_covariance_without_extent():
    x, colors, opacities, log_cov = gaussians(2)
    log_cov[1, 0, 0] = float("-inf")
    with pytest.raises(ValueError, match="covariance 1 is not finite"):
        features(x, colors, opacities, log_cov)


def test_features_name_the_wrong_shape():
    x, colors, opacities, log_cov = gaussians()
    with pytest.raises(ValueError, match=r"opacities \(7, 1\), not \(7,\)"):
        features(x, colors, opacities[:, None], log_cov, opacities)


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
