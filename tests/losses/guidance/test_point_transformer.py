"""Point-E's network against the formula written out token by token, and the published sizes."""

import math
import sys
from pathlib import Path

import pytest
import torch

sys.path.insert(0, str(Path(__file__).parents[2]))
import tiny_models

from diffuphy.losses.guidance.point_transformer import PointTransformer

PUBLISHED = {
    "base_40m_textvec": (512, 12, 8, {"kind": "vector", "features": 768}, 40_333_836),
    "base_40m_imagevec": (512, 12, 8, {"kind": "vector", "features": 768}, 40_333_836),
    "base_40m_uncond": (512, 12, 8, {}, 39_940_108),
    "base_40m": (512, 12, 8, {"kind": "grid", "features": 1024}, 40_466_956),
    "base_300m": (1024, 24, 16, {"kind": "grid", "features": 1024}, 311_778_316),
    "base_1b": (2048, 24, 32, {"kind": "grid", "features": 1024}, 1_244_311_564),
    "upsample_40m": (512, 12, 8, {"kind": "grid", "features": 1024, "upsampler": True}, 40_470_540),
}
"""Width, blocks, heads and condition of each published file (``point_e/models/configs.py``), and their sum."""


def layer_norm(x, weight, bias):
    return (x - x.mean(-1, keepdim=True)) / (x.var(-1, keepdim=True, correction=0) + 1e-5).sqrt() * weight + bias


def gelu(x):
    return x / 2 * (1 + torch.erf(x / math.sqrt(2)))


def reference(state, x, t, condition=None, coarse=None, heads=1):
    """One cloud, float64: tokens, blocks and heads one after another, from the names of the checkpoint alone."""
    w = {name: tensor.double() for name, tensor in state.items()}

    def linear(name, v):
        return v @ w[f"{name}.weight"].T + w[f"{name}.bias"]

    def norm(name, v):
        return layer_norm(v, w[f"{name}.weight"], w[f"{name}.bias"])

    def mlp(name, v):
        return linear(f"{name}.c_proj", gelu(linear(f"{name}.c_fc", v)))

    width = len(w["input_proj.weight"])
    angles = [t * 10000 ** (-j / (width // 2)) for j in range(width // 2)]
    time = mlp("time_embed", torch.tensor([[math.cos(a) for a in angles] + [math.sin(a) for a in angles]]).double())
    tokens = [time]
    if "clip_embed.weight" in w:  # a vector: before time, scaled to unit variance
        tokens = [linear("clip_embed", math.sqrt(len(condition)) * condition[None]), time]
    elif "clip_embed.1.weight" in w:  # a grid: after time
        tokens = [time, linear("clip_embed.1", norm("clip_embed.0", condition))]
    if coarse is not None:
        tokens.append(linear("cond_point_proj", coarse * w["channel_scales"] + w["channel_biases"]))
    h = norm("ln_pre", torch.cat([*tokens, linear("input_proj", x)]))
    size = width // heads
    for i in range(sum(name.endswith("ln_1.weight") for name in w)):
        block = f"backbone.resblocks.{i}"
        qkv, parts = linear(f"{block}.attn.c_qkv", norm(f"{block}.ln_1", h)), []
        for head in range(heads):
            q, k, v = qkv[:, 3 * size * head : 3 * size * (head + 1)].split(size, 1)
            parts.append(torch.softmax(q @ k.T / math.sqrt(size), 1) @ v)
        h = h + linear(f"{block}.attn.c_proj", torch.cat(parts, 1))
        h = h + mlp(f"{block}.mlp", norm(f"{block}.ln_2", h))
    return linear("output_proj", norm("ln_post", h))[-len(x) :]


def operands(kind, upsampler, g):
    condition = {"none": None, "vector": torch.randn(2, 24, generator=g), "grid": torch.randn(2, 5, 24, generator=g)}
    coarse = torch.rand(2, 7, 6, generator=g) * torch.tensor([1, 1, 1, 255, 255, 255]) if upsampler else None
    return torch.randn(2, 9, 6, generator=g), torch.tensor([3, 800]), condition[kind], coarse


@pytest.mark.parametrize(("kind", "upsampler"), [("none", False), ("vector", False), ("grid", False), ("grid", True)])
def test_network_is_the_published_formula(kind, upsampler, tmp_path):
    """Loaded from a file in the published layout and asked for two clouds at once: the reference answers for each."""
    file = tiny_models.point_e(tmp_path / "tiny.pt", kind=kind, upsampler=upsampler, width=128)
    state = torch.load(file, weights_only=True)
    network = PointTransformer.of(state)
    assert network.kind == kind and network.upsampler == upsampler
    x, t, condition, coarse = operands(kind, upsampler, torch.Generator().manual_seed(0))
    ours = network(x, t, condition, coarse)
    rows = ([None] * 2 if v is None else v.double() for v in (condition, coarse))
    theirs = torch.stack([reference(state, *row, heads=2) for row in zip(x.double(), t.tolist(), *rows, strict=True)])
    # two blocks of float32 (eps 6e-8) over sums of ≤ 512 terms of order 1; time features of t = 800 err by t · eps
    torch.testing.assert_close(ours.double(), theirs, rtol=0, atol=1e-4 * theirs.abs().max().item())


@pytest.mark.parametrize("name", PUBLISHED)
def test_published_sizes(name):
    """On the meta device: the parameters of each published network, and its heads of 64."""
    width, layers, heads, settings, count = PUBLISHED[name]
    with torch.device("meta"):
        network = PointTransformer(width, layers, heads, **settings)
    assert sum(p.numel() for p in network.parameters()) == count
    assert width // heads == 64
    loaded = PointTransformer.of(network.state_dict())
    assert len(loaded.backbone.resblocks) == layers and loaded.backbone.resblocks[0].attn.heads == heads
    assert (loaded.kind, loaded.upsampler) == (settings.get("kind", "none"), settings.get("upsampler", False))


def test_published_keys_and_shapes():
    """The names and shapes of ``base_40m.pt`` and ``upsample_40m.pt`` (``point_e/models/transformer.py``)."""
    width, layers, heads, settings, _ = PUBLISHED["upsample_40m"]
    with torch.device("meta"):
        state = PointTransformer(width, layers, heads, **settings).state_dict()
    block = {
        "attn.c_qkv.weight": (1536, 512), "attn.c_qkv.bias": (1536,),
        "attn.c_proj.weight": (512, 512), "attn.c_proj.bias": (512,),
        "mlp.c_fc.weight": (2048, 512), "mlp.c_fc.bias": (2048,),
        "mlp.c_proj.weight": (512, 2048), "mlp.c_proj.bias": (512,),
        "ln_1.weight": (512,), "ln_1.bias": (512,), "ln_2.weight": (512,), "ln_2.bias": (512,),
    }  # fmt: skip
    expected = {
        "time_embed.c_fc.weight": (2048, 512), "time_embed.c_fc.bias": (2048,),
        "time_embed.c_proj.weight": (512, 2048), "time_embed.c_proj.bias": (512,),
        "ln_pre.weight": (512,), "ln_pre.bias": (512,), "ln_post.weight": (512,), "ln_post.bias": (512,),
        "input_proj.weight": (512, 6), "input_proj.bias": (512,),
        "output_proj.weight": (12, 512), "output_proj.bias": (12,),
        "clip_embed.0.weight": (1024,), "clip_embed.0.bias": (1024,),
        "clip_embed.1.weight": (512, 1024), "clip_embed.1.bias": (512,),
        "cond_point_proj.weight": (512, 6), "cond_point_proj.bias": (512,),
        "channel_scales": (6,), "channel_biases": (6,),
    }  # fmt: skip
    expected |= {f"backbone.resblocks.{i}.{name}": shape for i in range(12) for name, shape in block.items()}
    assert {name: tuple(tensor.shape) for name, tensor in state.items()} == expected


def test_order_and_number_of_points_do_not_matter(tmp_path):
    """A permutation of the points permutes the answer; the network has no positions."""
    network = PointTransformer.of(torch.load(tiny_models.point_e(tmp_path / "tiny.pt"), weights_only=True))
    g = torch.Generator().manual_seed(1)
    x, c, order = torch.randn(1, 50, 6, generator=g), torch.randn(1, 24, generator=g), torch.randperm(50, generator=g)
    t = torch.tensor([100])
    # the same sums in another order: float32 rounding of 50 terms
    torch.testing.assert_close(network(x[:, order], t, c), network(x, t, c)[:, order], rtol=0, atol=1e-5)


def test_incomplete_or_foreign_weights_are_refused(tmp_path):
    state = torch.load(tiny_models.point_e(tmp_path / "tiny.pt"), weights_only=True)
    with pytest.raises(ValueError, match=r"no weights of Point-E.*base_40m\.pt"):
        PointTransformer.of({"conv.weight": torch.zeros(3)})
    with pytest.raises(RuntimeError, match=r"ln_post\.bias"):
        PointTransformer.of({k: v for k, v in state.items() if k != "ln_post.bias"})
    with pytest.raises(RuntimeError, match="extra"):
        PointTransformer.of({**state, "extra": torch.zeros(1)})


def test_a_condition_of_the_wrong_kind_is_refused(tmp_path):
    network = PointTransformer.of(torch.load(tiny_models.point_e(tmp_path / "tiny.pt"), weights_only=True))
    x, t = torch.zeros(1, 4, 6), torch.tensor([1])
    with pytest.raises(ValueError, match="'vector'"):
        network(x, t)
    with pytest.raises(ValueError, match="no coarse cloud"):
        network(x, t, torch.zeros(1, 24), torch.zeros(1, 4, 6))
