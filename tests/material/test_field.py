"""Fields before and after the network."""

import pytest
import torch

from diffuphy.material.field import Hypothesis, harden, prune, take, warm_start
from diffuphy.types import MaterialField


def field(w_e, w_p):
    n = len(w_e)
    names = tuple(f"e{i}" for i in range(len(w_e[0]))), tuple(f"p{i}" for i in range(len(w_p[0])))
    return MaterialField(*names, torch.tensor(w_e), torch.tensor(w_p), {"E": torch.arange(1.0, n + 1)}, torch.ones(n))


def test_warm_start_gives_each_region_its_hypothesis():
    labels = torch.tensor([0, 1, 1, 0])
    guesses = (Hypothesis("a", None, {"E": 1e5}, 900.0), Hypothesis("b", "v", {"E": 1e4}, 1100.0))
    start = warm_start(("a", "b"), ("i", "v"), labels, guesses)
    assert start.w_e.tolist() == [[1, 0], [0, 1], [0, 1], [1, 0]]
    assert start.w_p.tolist() == [[0.5, 0.5], [0, 1], [0, 1], [0.5, 0.5]]
    assert start.theta["E"].tolist() == [1e5, 1e4, 1e4, 1e5] and start.rho.tolist() == [900, 1100, 1100, 900]


def test_warm_start_names_what_is_wrong():
    one = Hypothesis("a", "i", {"E": 1e5}, 900.0)
    with pytest.raises(ValueError, match="'c' is not among"):
        warm_start(("a",), ("i",), torch.zeros(2, dtype=torch.int64), (Hypothesis("c", "i", {"E": 1.0}, 1.0),))
    with pytest.raises(ValueError, match="one hypothesis per region"):
        warm_start(("a",), ("i",), torch.tensor([0, 1]), (one,))
    with pytest.raises(ValueError, match="the same names"):
        warm_start(("a",), ("i",), torch.tensor([0, 1]), (one, Hypothesis("a", "i", {"nu": 0.3}, 900.0)))


def test_take_chooses_rows_of_everything():
    f = take(field([[1.0, 0.0], [0.2, 0.8], [0.5, 0.5]], [[1.0]] * 3), torch.tensor([2, 0]))
    assert f.w_e.tolist() == [[0.5, 0.5], [1.0, 0.0]] and f.theta["E"].tolist() == [3.0, 1.0] and len(f) == 2


def test_harden_is_one_hot_at_the_heaviest_expert_and_ties_go_to_the_first():
    f = harden(field([[0.2, 0.5, 0.3], [0.4, 0.4, 0.2], [0.2, 0.4, 0.4]], [[0.5, 0.5], [0.1, 0.9], [1.0, 0.0]]))
    assert f.w_e.tolist() == [[0, 1, 0], [1, 0, 0], [0, 1, 0]]
    assert f.w_p.tolist() == [[1, 0], [0, 1], [1, 0]]
    assert torch.equal(harden(f).w_e, f.w_e) and f.theta["E"].tolist() == [1, 2, 3]


def test_prune_drops_what_is_nowhere_heavy_and_says_so():
    """Columns whose maximum is below the threshold go; what they held is shared: w' = w / (1 − dropped)."""
    p = prune(field([[0.995, 0.005, 0.0], [0.4, 0.0, 0.6]], [[1.0], [1.0]]), 0.01)
    assert p.field.elastic == ("e0", "e2") and p.field.plastic == ("p0",) and p.dropped == ("e1",)
    torch.testing.assert_close(p.field.w_e, torch.tensor([[1.0, 0.0], [0.4, 0.6]]))
    assert p.peaks == pytest.approx({"e0": 0.995, "e1": 0.005, "e2": 0.6, "p0": 1.0})
    assert p.moved == pytest.approx(0.005)


def test_prune_of_a_hard_field_keeps_exactly_the_used_experts_unchanged():
    f = harden(field([[0.9, 0.06, 0.04], [0.1, 0.2, 0.7]], [[0.6, 0.4], [0.7, 0.3]]))
    p = prune(f)
    assert p.field.elastic == ("e0", "e2") and p.field.plastic == ("p0",) and p.moved == 0.0
    assert torch.equal(p.field.w_e, f.w_e[:, [0, 2]])


def test_prune_lets_gradients_through_and_keeps_a_needed_field_itself():
    f = field([[0.7, 0.3], [0.5, 0.5]], [[1.0], [1.0]])
    f.w_e.requires_grad_()
    assert prune(f).field.w_e is f.w_e
    f3 = field([[0.7, 0.2999, 0.0001]], [[1.0]])
    f3.w_e.requires_grad_()
    prune(f3).field.w_e[0, 0].backward()
    assert f3.w_e.grad.any()


def test_prune_refuses_a_threshold_that_could_leave_a_particle_with_nothing():
    f = field([[0.4, 0.3, 0.3]], [[0.5, 0.5]])
    with pytest.raises(ValueError, match="1/3"):
        prune(f, 0.34)
    with pytest.raises(ValueError, match="threshold"):
        prune(f, 0.0)
