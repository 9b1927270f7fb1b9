"""Colours and silhouettes of pictures one can count."""

import math

import pytest
import torch

from diffuphy.metrics import picture


def square(at, side=4, size=16):
    """Coverage of a moving square, one position a frame."""
    cover = torch.zeros(len(at), size, size)
    for frame, (y, x) in zip(cover, at, strict=True):
        frame[y : y + side, x : x + side] = 1
    return cover


def test_saturation_is_that_of_the_object():
    """Pure red has 1, (1, .5, .5) has .5, grey and black have 0; the green background does not count."""
    colors = torch.tensor([[1.0, 0, 0], [1, 0.5, 0.5], [0.3, 0.3, 0.3], [0, 0, 0]])
    rgb = torch.tensor([0.0, 1, 0]).expand(4, 16, 16, 3).clone()
    cover = square([(2, 2)] * 4)
    rgb[cover > 0.5] = colors.repeat_interleave(16, 0)
    assert picture.saturation(rgb, cover).tolist() == pytest.approx([1.0, 0.5, 0.0, 0.0])


def test_no_object_has_no_saturation():
    assert math.isnan(float(picture.saturation(torch.rand(1, 16, 16, 3), torch.zeros(1, 16, 16))))


def test_silhouette_of_a_moving_square():
    """4 × 4 of 16 × 16; a step of one pixel leaves 12 of 20 in common; the middle moves by 1/16."""
    cover = square([(2, 2), (3, 2), (3, 10)])
    assert picture.area(cover).tolist() == [1 / 16] * 3
    assert picture.overlap(cover).tolist() == pytest.approx([12 / 20, 0.0])
    assert picture.middle(cover).tolist() == [[0.25, 0.25], [0.25, 0.3125], [0.75, 0.3125]]
