"""Weights of the encoder from a file."""

import dataclasses

import pytest
import torch
from safetensors.torch import save_file

from diffuphy.artifact import describe
from diffuphy.material.encoder import Encoder, features
from diffuphy.material.expert import Param
from diffuphy.material.field import Hypothesis, warm_start
from diffuphy.material.net import MaterialNet, Net

SMALL = Net(groups=6, group_size=4, width=16, depth=1, heads=2)


def build(net: Net) -> MaterialNet:
    """A network for a cloud of 24 points."""
    g = torch.Generator().manual_seed(0)
    x, colors = torch.rand(24, 3, generator=g), torch.rand(24, 3, generator=g)
    points = features(x, colors, torch.ones(24), torch.diag_embed(torch.full((24, 3), -9.0)))
    guess = Hypothesis("neo_hookean", "identity", {"E": 1e5, "nu": 0.3}, 1000.0)
    start = warm_start(("neo_hookean",), ("identity",), torch.zeros(24, dtype=torch.long), (guess,))
    return net.build(points, start, [Param("E", "Pa", 1e3, 1e7, True, 1e5)])


def weights(net: Net = SMALL, value: float = 0.25) -> dict[str, torch.Tensor]:
    """An encoder of one number, which half precision holds exactly."""
    encoder = Encoder(14, net.width, net.depth, net.heads)
    return {name: torch.full_like(tensor, value).half() for name, tensor in encoder.state_dict().items()}


def test_the_encoder_is_the_files_and_everything_else_is_the_seeds(tmp_path):
    """Encoder = file bit by bit, in the network's own precision; decoder as without it."""
    save_file(weights(), tmp_path / "e.safetensors")
    drawn, given = build(SMALL), build(dataclasses.replace(SMALL, pretrained=str(tmp_path / "e.safetensors")))
    for tensor in given.encoder.state_dict().values():
        assert tensor.dtype == torch.float32 and bool((tensor == 0.25).all())
    for name, tensor in drawn.decoder.state_dict().items():
        assert torch.equal(tensor, given.decoder.state_dict()[name])


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda w: w.pop("norm.bias"), "norm.bias is missing in the file"),
        (lambda w: w.update(more=torch.zeros(1)), "missing in the encoder"),
        (lambda w: w.update(weights(dataclasses.replace(SMALL, width=32))), r"\(64,\) in the file and \(32,\)"),
    ],
    ids=["too few", "too many", "another width"],
)
def test_a_file_that_does_not_fit_is_refused_in_one_line(tmp_path, change, says):
    state = weights()
    change(state)
    save_file(state, tmp_path / "e.safetensors")
    with pytest.raises(ValueError, match=says) as refused:
        build(dataclasses.replace(SMALL, pretrained=str(tmp_path / "e.safetensors")))
    assert "\n" not in str(refused.value)


def test_a_broken_or_missing_file_is_refused(tmp_path):
    file = tmp_path / "e.safetensors"
    with pytest.raises(ValueError, match="is no file"):
        Net(pretrained=str(file))
    file.write_bytes(b"no tensors")
    with pytest.raises(ValueError, match="is not a file of safetensors"):
        build(dataclasses.replace(SMALL, pretrained=str(file)))


def test_the_recipe_has_the_files_content_and_not_its_place(tmp_path):
    """The same weights elsewhere are the same settings; other weights at the same place are not."""
    a, b = (tmp_path / name for name in ("a.safetensors", "b.safetensors"))
    save_file(weights(), a)
    save_file(weights(), b)
    said = [describe(dataclasses.replace(SMALL, pretrained=str(f))) for f in (a, b)]
    assert said[0] == said[1] != describe(SMALL)
    save_file(weights(value=0.5), b)
    assert describe(dataclasses.replace(SMALL, pretrained=str(b))) != said[0]
