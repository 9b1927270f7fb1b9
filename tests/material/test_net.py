"""The material network as a whole."""

import time

import pytest
import torch

from diffuphy.material.encoder import Points, features
from diffuphy.material.expert import Param
from diffuphy.material.field import Hypothesis, warm_start
from diffuphy.material.net import Net
from diffuphy.workspace import Workspace

E = Param("E", "Pa", 1e3, 1e7, True, 1e5)
NU = Param("nu", "-", 0.0, 0.49, False, 0.3)
ELASTIC, PLASTIC = ("fixed_corotated", "neo_hookean"), ("identity", "drucker_prager", "von_mises", "fluid")
SMALL = Net(groups=12, group_size=8, width=16, heads=2)


def burger(n=150, seed=0, dtype=torch.float32):
    """A disc-like cloud, brown in the middle layer: points and the region of each."""
    g = torch.Generator().manual_seed(seed)
    x = torch.rand(n, 3, generator=g, dtype=dtype) * torch.tensor([0.3, 0.3, 0.2], dtype=dtype)
    patty = ((x[:, 2] > 0.07) & (x[:, 2] < 0.13)).long()
    colors = torch.tensor([[0.9, 0.65, 0.3], [0.4, 0.18, 0.1]], dtype=dtype)[patty]
    log_cov = torch.diag_embed((1e-4 * (0.5 + torch.rand(n, 3, generator=g, dtype=dtype))).log())
    return features(x, colors, torch.rand(n, generator=g, dtype=dtype), log_cov), patty


def guess(labels, dtype=torch.float32):
    bun = Hypothesis("neo_hookean", "identity", {"E": 2e5, "nu": 0.3}, 900.0)
    meat = Hypothesis("fixed_corotated", "von_mises", {"E": 4e4, "nu": 0.4}, 1100.0)
    start = warm_start(ELASTIC, PLASTIC, labels, (bun, meat))
    return type(start)(
        start.elastic, start.plastic, start.w_e.to(dtype), start.w_p.to(dtype),
        {k: v.to(dtype) for k, v in start.theta.items()}, start.rho.to(dtype),
    )  # fmt: skip


def trained(net, seed=1, scale=0.3):
    """The network after some training: a head that is no longer zero."""
    with torch.no_grad():
        g = torch.Generator().manual_seed(seed)
        for p in net.decoder.head[-1].parameters():
            p.copy_(scale * torch.randn(p.shape, generator=g, dtype=p.dtype))
    return net


def rows(field):
    return torch.cat([field.w_e, field.w_p, *(field.theta[k][:, None].log() for k in ("E", "nu"))], 1)


def test_net_begins_at_its_start_exactly():
    """The head is zero: θ and ρ are the start's bit by bit, w = gate(b w_0)."""
    points, labels = burger()
    start = guess(labels)
    field = SMALL.build(points, start, (E, NU))()
    for name in ("E", "nu"):
        assert torch.equal(field.theta[name], start.theta[name])
    assert torch.equal(field.rho, start.rho)
    assert torch.equal(field.w_e, torch.softmax(SMALL.bias * start.w_e, 1))
    assert torch.equal(field.w_p.argmax(1), start.w_p.argmax(1))


def test_net_answers_do_not_depend_on_the_order_of_the_points():
    """f(P x) = P f(x), for the particles it is built with; float64, so only summation order differs."""
    points, labels = burger(dtype=torch.float64)
    order = torch.randperm(len(points), generator=torch.Generator().manual_seed(5))
    shuffled = Points(points.x[order], points.f[order])
    a = trained(SMALL.build(points, guess(labels, torch.float64), (E, NU)))()
    b = trained(SMALL.build(shuffled, guess(labels[order], torch.float64), (E, NU)))()
    torch.testing.assert_close(rows(b), rows(a)[order], rtol=1e-10, atol=1e-12)
    assert rows(a).std(0).max() > 1e-2  # and the answers do differ from point to point


def rotation(seed):
    """A rotation drawn from all."""
    g = torch.Generator().manual_seed(seed)
    q, r = torch.linalg.qr(torch.randn(3, 3, generator=g, dtype=torch.float64))
    q = q * r.diagonal().sign()
    return q * torch.linalg.det(q)


def moved(points, R, shift):
    """The same body somewhere else: x' = R x + s, ln Σ' = R ln Σ Rᵀ."""
    return points.seen_from(-(R.T @ shift), R.T)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float64, 1e-9), (torch.float32, 1e-5)])
def test_net_answers_do_not_depend_on_where_a_body_lies_or_how_it_is_turned(seed, dtype, tolerance):
    """f(R x + s) = f(x), relative to the largest change: rounding over the gap of the moments of 150 points, ~ 0.1."""
    points, labels = burger(dtype=torch.float64)
    R, shift = rotation(seed), torch.tensor([0.3, -0.2, 0.7], dtype=torch.float64)
    there = moved(points, R, shift)
    here, there = (Points(p.x.to(dtype), p.f.to(dtype)) for p in (points, there))
    a, b = (trained(SMALL.build(p, guess(labels, dtype), (E, NU))) for p in (here, there))
    torch.testing.assert_close(rows(b()), rows(a()), rtol=tolerance, atol=tolerance)
    assert rows(a()).std(0).max() > 1e-2
    film = burger(60, seed=3, dtype=torch.float64)[0]
    asked = [Points(p.x.to(dtype), p.f.to(dtype)) for p in (film, moved(film, R, shift))]
    torch.testing.assert_close(rows(b(asked[1])), rows(a(asked[0])), rtol=tolerance, atol=tolerance)


def test_net_of_a_ball_does_not_depend_on_how_it_is_turned():
    """Symmetric in law, not in its points: N = 400 points leave gaps of order 1/20 between the moments."""
    g = torch.Generator().manual_seed(0)
    x = torch.nn.functional.normalize(torch.randn(400, 3, generator=g), dim=1)
    x = x * torch.rand(400, 1, generator=g) ** (1 / 3)
    one = torch.ones(400)
    points = features(x, one[:, None] * torch.tensor([0.8, 0.2, 0.2]), one, -4 * torch.eye(3).repeat(400, 1, 1))
    start = warm_start(ELASTIC, PLASTIC, 0 * one.long(), (Hypothesis(None, None, {"E": 1e5, "nu": 0.3}, 1e3),))
    nets = [trained(SMALL.build(p, start, (E, NU))) for p in (points, moved(points, rotation(7).float(), x[0]))]
    torch.testing.assert_close(rows(nets[1]()), rows(nets[0]()), rtol=1e-5, atol=1e-5)


def test_net_answers_each_query_alone():
    """A query's material does not depend on who else asks; the draft particles as queries give the draft field."""
    points, labels = burger()
    net = trained(SMALL.build(points, guess(labels), (E, NU)))
    draft = rows(net())
    torch.testing.assert_close(rows(net(points)), draft, rtol=1e-5, atol=1e-6)
    film, film_labels = burger(400, seed=9)
    every = rows(net(film, guess(film_labels)))
    some = rows(net(Points(film.x[::3], film.f[::3]), guess(film_labels[::3])))
    torch.testing.assert_close(some, every[::3], rtol=1e-5, atol=1e-6)


def test_patches_are_centred_and_of_unit_size():
    """Stored p = (x − centre)/r̄: the centre's nearest particles, itself first; the mean reach is 1."""
    points, labels = burger(dtype=torch.float64)
    net = SMALL.build(points, guess(labels, torch.float64), (E,))
    assert not net.groups[:, 0, :3].any()
    reach = net.groups[..., :3].norm(dim=2).amax(1)
    torch.testing.assert_close(reach.mean().item(), 1.0, rtol=1e-12, atol=0)
    x = net.draft[:, :3]
    d = (net.centres[:, None] - x).norm(dim=-1).sort(1).values[:, :8]
    torch.testing.assert_close(net.groups[..., :3].norm(dim=2) * d[:, -1].mean(), d, rtol=1e-10, atol=1e-12)


def test_net_transfers_the_start_of_the_nearest_draft_particle():
    points, labels = burger()
    net = SMALL.build(points, guess(labels), (E,))
    film, _ = burger(300, seed=9)
    index = (film.x[:, None] - points.x).norm(dim=-1).argmin(1)
    assert torch.equal(net(film).theta["nu"], net.start.theta["nu"][index])
    assert torch.equal(net(film).rho, net.start.rho[index])


def test_net_fields_are_valid_whatever_the_weights():
    """Rows on the simplex, parameters in their bounds, for a wild head."""
    points, labels = burger()
    field = trained(SMALL.build(points, guess(labels), (E, NU)), scale=30.0)()
    for w in (field.w_e, field.w_p):
        assert (w >= 0).all()
        torch.testing.assert_close(w.sum(1), torch.ones(len(points)), rtol=0, atol=1e-6)
    for p in (E, NU):
        assert (field.theta[p.name] >= p.lo).all() and (field.theta[p.name] <= p.hi * (1 + 1e-6)).all()
    assert field.theta["E"].max() > 9e6 and field.theta["E"].min() < 1.1e3  # the wild head did push to the ends


SPARSE, BARE = Net(12, 8, 16, 2, 2, gate="sparsemax", bias=0.5), Net(12, 8, 16, 0, 2, own=False)


@pytest.mark.parametrize("net", [SMALL, SPARSE, BARE])
def test_gradients_reach_every_weight(net):
    """At the start only the head's last (zero) layer moves; after one step everything does."""
    points, labels = burger()
    module = net.build(points, guess(labels), (E, NU))
    target = torch.rand(len(points), 8, generator=torch.Generator().manual_seed(0))

    def loss():
        return (rows(module()) * target).sum()

    loss().backward()
    last = module.decoder.head[-1]
    assert all(p.grad.abs().max() > 0 for p in last.parameters())
    trained(module, scale=0.05)
    module.zero_grad()
    loss().backward()
    dead = [name for name, p in module.named_parameters() if p.grad is None or not (p.grad != 0).any()]
    assert not dead


def test_net_has_its_exact_gradient():
    """Autograd against central differences in float64, through encoder, interpolation and decoder."""
    points, labels = burger(40, dtype=torch.float64)
    net = trained(Net(6, 5, 8, 1, 2).build(points, guess(labels, torch.float64), (E, NU)))
    weight = net.encoder.patch.point[0].weight
    direction = torch.randn(weight.shape, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    base = weight.detach().clone()

    def value(step):
        with torch.no_grad():
            weight.copy_(base + step * direction)
        return rows(net()).square().sum()

    (grad,) = torch.autograd.grad(value(0.0), weight)
    h = 1e-5  # truncation h² ~ 1e-10, rounding 1e-16 · 1e5 / h ~ 1e-6 relative to a sum of ~1e4
    difference = (value(h) - value(-h)).detach() / (2 * h)
    torch.testing.assert_close((grad * direction).sum(), difference, rtol=1e-5, atol=1e-6)


def test_net_learns_a_stiffness_per_region():
    """Two regions of different E from one start: the network tells them apart by what it sees of them."""
    points, labels = burger()
    start = warm_start(("neo_hookean",), ("identity",), 0 * labels, (Hypothesis(None, None, {"E": 1e5}, 1e3),))
    net = SMALL.build(points, start, (E,))
    target = torch.tensor([5.5, 4.2])[labels]
    optimiser = torch.optim.Adam(net.parameters(), lr=3e-3)
    for _ in range(150):
        optimiser.zero_grad()
        (net().theta["E"].log10() - target).square().mean().backward()
        optimiser.step()
    error = (net().theta["E"].log10() - target).abs()
    assert error.mean() < 0.1  # a tenth of a decade, where the start was 0.5 and 0.8 away


def test_net_is_a_function_of_its_seed_and_leaves_the_global_generator_alone():
    points, labels = burger()
    before = torch.get_rng_state()
    a, b, c = (Net(12, 8, 16, 1, 2, seed=s).build(points, guess(labels), (E,)) for s in (0, 0, 1))
    assert torch.equal(torch.get_rng_state(), before)
    assert all(torch.equal(p, q) for p, q in zip(a.parameters(), b.parameters(), strict=True))
    assert not torch.equal(next(a.parameters()), next(c.parameters()))


def test_net_state_survives_the_workspace(tmp_path):
    """Tensors only: what is loaded into a network built with other weights answers bit by bit the same."""
    points, labels = burger()
    net = trained(SMALL.build(points, guess(labels), (E, NU)))
    work = Workspace(tmp_path)
    work.save({"net": net.state_dict()})
    again = Net(groups=12, group_size=8, width=16, heads=2, seed=7).build(points, guess(labels), (E, NU))
    again.load_state_dict(work.load()["net"])
    assert torch.equal(rows(again()), rows(net()))


def test_net_names_what_is_wrong():
    points, labels = burger(40)
    start = guess(labels)
    with pytest.raises(ValueError, match=r"net\.groups = 64"):
        Net().build(points, start, (E,))
    with pytest.raises(ValueError, match="start for 30"):
        SMALL.build(points, guess(labels[:30]), (E,))
    with pytest.raises(ValueError, match="no points"):
        SMALL.build(points, start, (E,))(start=start)
    with pytest.raises(ValueError, match="multiple of net"):
        Net(width=96, heads=5)
    with pytest.raises(ValueError, match="sparsemax"):
        Net(gate="sparsemax", bias=4.0)
    with pytest.raises(ValueError, match="'gumbel'"):
        Net(gate="gumbel")


def test_net_is_free_next_to_a_simulation():
    """Default size, 1.5k particles, one core: ≤ 30 ms of processor time, the least of some runs; 5 ms were measured."""
    points, labels = burger(1500)
    net = Net().build(points, guess(labels), (E, NU))
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    seconds = []
    with torch.no_grad():
        for _ in range(7):
            began = time.process_time()
            net()
            seconds.append(time.process_time() - began)
    torch.set_num_threads(threads)
    assert min(seconds) < 0.03


@pytest.mark.gpu
def test_net_on_cuda_gives_the_field_of_the_cpu():
    points, labels = burger(dtype=torch.float64)
    here = trained(SMALL.build(points, guess(labels, torch.float64), (E, NU)))
    there = SMALL.build(Points(points.x.cuda(), points.f.cuda()), guess(labels, torch.float64).to("cuda"), (E, NU))
    there.load_state_dict(here.state_dict())
    torch.testing.assert_close(rows(there()).cpu(), rows(here()), rtol=1e-10, atol=1e-12)
    assert there().rho.is_cuda
