"""Masked pre-training of the encoder."""

import dataclasses
import math

import pytest
import torch

from benchmarks.pretrain import HELD_OUT, Masked, Pretraining, bodies, page, pairs, shuffled
from diffuphy.material.net import Net
from diffuphy.workspace import Workspace


@pytest.fixture(scope="module")
def seen():
    return bodies(["jelly"], 2, 0)


def test_the_loss_does_not_see_the_order_of_points_in_a_patch(seen):
    """A patch is a set: Chamfer distance, mean and spread; exact but for the order of sums in float32."""
    groups, centres = seen
    model, order = Masked(Net(), 0), shuffled(2, 64, torch.Generator().manual_seed(0))
    other = groups[:, :, torch.randperm(32, generator=torch.Generator().manual_seed(1))]
    torch.testing.assert_close(model(other, centres, order), model(groups, centres, order), rtol=1e-5, atol=0)


def test_what_is_hidden_is_not_shown(seen):
    """What is said depends on the patches that are shown, and on the places of those that are not."""
    groups, centres = seen
    model, order = Masked(Net(), 0), shuffled(2, 64, torch.Generator().manual_seed(0))
    hidden = torch.zeros(2, 64, dtype=torch.bool).scatter_(1, order[:, : model.hidden], True)[..., None, None]
    with torch.no_grad():
        said = model.told(groups, centres, order)
        assert torch.equal(said, model.told(torch.where(hidden, 7.0, groups), centres, order))
        assert not torch.equal(said, model.told(torch.where(hidden, groups, 7.0), centres, order))


class Kill(Workspace):
    """Saves after every step, and ends the run after the second."""

    def due(self):
        return True

    def save(self, state):
        super().save(state)
        if state["step"] == 2:
            raise KeyboardInterrupt


def test_training_lowers_the_loss_and_goes_on_to_the_same_bits(seen, tmp_path):
    """Ten steps; killed after two and continued, the same weights."""
    settings = Pretraining(steps=10, batch=2)
    whole = settings(seen, Workspace(progress=False))
    with pytest.raises(KeyboardInterrupt):
        settings(seen, Kill(tmp_path, progress=False))
    again = settings(seen, Workspace(tmp_path, progress=False))
    for name, value in whole.state_dict().items():
        assert torch.equal(value, again.state_dict()[name]), name
    order = shuffled(2, 64, torch.Generator().manual_seed(3))
    with torch.no_grad():
        losses = [float(m(*seen, order).mean()) for m in (Masked(Net(), 0), whole)]
    assert losses[1] < losses[0]


def test_the_page_pairs_the_fits_of_one_seed():
    """mean of ln(with / without) over pairs ± standard deviation / √n."""
    row = {"scanned": False, "error": 1.0, "seconds": 1.0, "object": HELD_OUT[0]}
    rows = [row | {"seed": s, "pretrained": p, "loss": math.exp(s * p)} for s in (1, 3) for p in (True, False)]
    torch.testing.assert_close(pairs(rows, "loss"), torch.tensor([1.0, 3.0], dtype=torch.float64))
    known = {"bodies": 1, "seconds": 1.0, "bytes": 1, "seen": [1.0, 0.5], "held out": [1.0, 0.5]}
    text = page({"machine": "m", "train": known, "steps": 1, "rows": rows})
    assert "| no | burger (held out) | 2 |" in text and "| +2.00 ± 1.00 |" in text


def test_the_rate_warms_up_and_ends_near_zero():
    """lr · min(1, (s + 1)/w) · ½ (1 + cos π s/S)."""
    settings = Pretraining(steps=100, lr=1.0)
    assert settings.rate(0) == pytest.approx(0.25) and settings.rate(50) == pytest.approx(0.5, abs=1e-6)
    assert settings.rate(99) < 1e-3 and dataclasses.replace(settings, lr=2.0).rate(50) == pytest.approx(1.0, abs=1e-6)
