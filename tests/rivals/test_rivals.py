"""Rivals: each runs on the shared loop, and each piece of theirs is what it says."""

import dataclasses
import math

import pytest
import torch

from diffuphy.learning.case import Case
from diffuphy.learning.probe import Probe, table_field
from diffuphy.losses.guidance.analytic import Analytic
from diffuphy.losses.takes import Take
from diffuphy.material.field import harden
from diffuphy.material.net import Net, Untrained
from diffuphy.material.presets import lookup
from diffuphy.mpm import simulate
from diffuphy.render.sh import from_rgb
from diffuphy.rivals.ablations import OneLaw
from diffuphy.rivals.dreamphysics import DreamPhysics
from diffuphy.rivals.omniphysgs import OmniPhysGS, straight_through
from diffuphy.rivals.particles import MinMax
from diffuphy.rivals.physdreamer import OneClip, PhysDreamer, drawn, photometric
from diffuphy.rivals.physgaussian import KINDS, PhysGaussian
from diffuphy.rivals.physics3d import Physics3D
from diffuphy.rivals.rival import whole
from diffuphy.rivals.substep import LastSubstep
from diffuphy.types import Gaussians, Look, Motion, Particles
from diffuphy.workspace import Workspace

LOOK = Look("ball", "a ball")
PROBE = Probe(particles=100, frames=3, image=24, speed=3.0)
PRIOR = Analytic(layout="clip", s=0.0)


def ball(n=7, size=0.4):
    """A ball on a lattice, each particle carrying one Gaussian; striped so that turning is seen."""
    a = (torch.arange(n) + 0.5) / n * 2 - 1
    means = torch.cartesian_prod(a, a, a)
    means = means[means.norm(dim=1) < 1]
    stripes = (torch.sin(7 * means[:, 2:]) > 0).float()
    rgb = stripes * torch.tensor([0.9, 0.3, 0.2]) + (1 - stripes) * torch.tensor([0.95, 0.8, 0.3])
    G, h = len(means), size / n
    turn = torch.tensor([1.0, 0, 0, 0]).repeat(G, 1)
    gaussians = Gaussians(means, turn, torch.full((G, 3), -1.9), torch.full((G,), 3.0), from_rgb(rgb))
    particles = Particles(means * size / 2, torch.full((G,), h**3), torch.arange(G), size / 2, (0.0, 0.0, 0.0), h)
    return gaussians, particles


def moving(material="rubber", verb="falling"):
    return Motion(verb, f"a {material} ball {verb}", {"": material}, 0.4)


def case(material="rubber", probe=PROBE):
    return Case.make(probe, PRIOR, None, LOOK, moving(material), *ball())


NETWORK = {"groups": 8, "group_size": 8, "width": 16, "heads": 2}
RIVALS = {
    "physgaussian": PhysGaussian(),
    "dreamphysics": DreamPhysics(PRIOR, probe=PROBE, steps=2),
    "dreamphysics, full gradient": DreamPhysics(PRIOR, probe=PROBE, steps=2, gradient="full", rule="adam"),
    "physics3d": Physics3D(PRIOR, probe=PROBE, steps=2),
    "physdreamer": PhysDreamer(PRIOR, probe=PROBE, steps=2),
    "omniphysgs": OmniPhysGS(
        PRIOR, probe=PROBE, steps=2, network=Untrained(**NETWORK, depth=0, own=False, bias=0.0),
        candidates_elastic=("hencky",), candidates_plastic=("identity", "von_mises"),
    ),
    "one law": OneLaw(
        PRIOR, probe=PROBE, steps=2, stiffness_steps=2, scan_frames=3, net=Net(**NETWORK, depth=1),
        elastic=("neo_hookean",), plastic=("identity", "von_mises"),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", RIVALS)
def test_every_rival_finds_a_finite_one_hot_field_of_all_particles(name, tmp_path):
    """And it trains: what it learns is not where it began."""
    rival, motion = RIVALS[name], moving()
    work = Workspace(tmp_path, progress=False)
    field = rival(LOOK, motion, *ball(), work=work)
    assert len(field) == len(ball()[1])
    for w in (field.w_e, field.w_p):
        assert torch.equal(w.amax(1), torch.ones(len(field))) and torch.equal(w.sum(1), torch.ones(len(field)))
    assert all(bool(torch.isfinite(v).all()) for v in field.theta.values())
    if hasattr(rival, "experts"):
        elastic, plastic, _ = rival.experts(motion)
        assert set(field.elastic) <= set(elastic) and set(field.plastic) <= set(plastic)
    if name in ("physgaussian", "omniphysgs"):
        assert float(field.theta["E"].std()) == 0  # constants
    else:
        start = getattr(rival, "start", None)
        assert start is None or float((field.theta["E"].log10() - math.log10(start)).abs().max()) > 1e-4
        assert (tmp_path / "summary.json").exists() and (tmp_path / "metrics.jsonl").exists()


def test_physics3d_relaxes():
    field = RIVALS["physics3d"](LOOK, moving(), *ball(), work=Workspace())
    assert field.branches == ("maxwell",) and float(field.theta["relaxation_time"].std()) > 0


def test_interrupted_rival_continues_to_the_same_bits(tmp_path):
    rival, motion = RIVALS["dreamphysics"], moving()
    at_once = rival(LOOK, motion, *ball(), work=Workspace())

    class Stop(Workspace):
        def due(self):
            return True

        def save(self, state):
            super().save(state)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        rival(LOOK, motion, *ball(), work=Stop(tmp_path, progress=False))
    resumed = rival(LOOK, motion, *ball(), work=Workspace(tmp_path, progress=False))
    assert torch.equal(at_once.theta["E"], resumed.theta["E"])


# ---------------------------------------------------------------------- the gradient of one substep
def in_doubles(bench):
    draft = dataclasses.replace(bench.draft, x=bench.draft.x.double(), vol=bench.draft.vol.double())
    return dataclasses.replace(bench, draft=draft)


def test_truncated_gradient_is_that_of_the_last_substep_alone():
    """∂|x_T|²/∂ ln E with the state one substep before held fixed, against central differences of that substep."""
    bench = LastSubstep.like(in_doubles(case().bench))
    field = table_field(None, LOOK, moving(), bench.draft)
    # one particle is the stiffest: the fastest wave sets what the scheme retains, and its maximum has one derivative
    log_E = torch.linspace(11.0, 12.0, len(bench.draft), dtype=torch.float64).requires_grad_()

    def with_E(y):
        return dataclasses.replace(field, theta=field.theta | {"E": y.exp()})

    film = bench.simulate(with_E(log_E), 3)
    (ours,) = torch.autograd.grad(film.x[3].square().sum(), log_E)
    # the same path by hand: everything up to the last substep as it was, that substep with another E
    spans = []
    original = LastSubstep._after

    def watched(self, scene, field, state, run):
        spans.append((scene, state))
        return original(self, scene, field, state, run)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(LastSubstep, "_after", watched)
        bench.simulate(with_E(log_E), 3)
    scene, state = spans[-1]

    def end(y):
        *_, last = simulate(scene, bench.draft.x, bench.draft.vol, with_E(y), frames=1, state=state)
        return float(last.x.square().sum())

    along = torch.randn(len(log_E), generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    h = 1e-4
    with torch.no_grad():
        difference = (end(log_E + h * along) - end(log_E - h * along)) / (2 * h)
    # differences are good to h² = 1e-8 and, at 1e-16 rounding over h of a gradient of 1e-4, to 1e-8 as well
    assert float(ours @ along) == pytest.approx(difference, rel=1e-5)


def test_truncation_changes_no_motion():
    """The substeps of a frame are those of a frame cut in two: the same motion up to the order of the scheme, Δt²."""
    bench = case().bench
    field = table_field(None, LOOK, moving(), bench.draft)
    whole_, cut = bench.simulate(field), LastSubstep.like(bench).simulate(field)
    with torch.no_grad():
        assert torch.equal(LastSubstep.like(bench).simulate(field).x, bench.simulate(field).x)
    # a frame holds tens of substeps: another number of them moves the body by less than a hundredth of its size
    assert float((whole_.x - cut.x).norm(dim=-1).max()) < 0.01 * bench.size


# ---------------------------------------------------------------------- pieces
def test_straight_through_has_hard_values_and_soft_gradients():
    logits = torch.randn(6, 4, generator=torch.Generator().manual_seed(0), dtype=torch.float64, requires_grad=True)
    hard = torch.nn.functional.one_hot(logits.argmax(1), 4).double()
    cotangent = torch.randn(6, 4, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    w = straight_through(torch.softmax(logits, 1), hard)
    assert torch.equal(w, hard)
    (ours,) = torch.autograd.grad((w * cotangent).sum(), logits)
    (soft,) = torch.autograd.grad((torch.softmax(logits, 1) * cotangent).sum(), logits)
    assert torch.equal(ours, soft)


def test_groups_of_omniphysgs_choose_as_one():
    """Particles nearest to one centre follow the same laws, in training and at the film's particles."""
    rival, c = RIVALS["omniphysgs"], case()
    model = rival.model(c, rival.begin(c.table))
    field = model()
    for g in range(8):
        rows = field.w_p[model.group == g]
        assert torch.equal(rows, rows[:1].expand_as(rows))
    assert torch.equal(harden(field).w_p, field.w_p.detach())
    again = model.at(c.points, torch.arange(len(c.points)))
    assert torch.equal(again.w_p, field.w_p) and torch.equal(again.rho, field.rho)


def test_minmax_moves_by_a_fixed_length_whatever_the_gradient():
    """The ends of the field move by half a step each, for any positive multiple and any shift of the gradient."""
    g = torch.tensor([[3.0, -1.0, 1.0]])
    for gradient in (g, 1e-12 * g, g + 100):
        y = torch.nn.Parameter(torch.zeros(1, 3))
        y.grad = gradient
        MinMax([y], 0.4, torch.tensor([[-0.1]]), torch.tensor([[9.0]])).step()
        # float32 rounds a gradient near 100 to 4e-6 of its range of 4
        torch.testing.assert_close(y.detach(), torch.tensor([[-0.1, 0.2, 0.0]]), atol=1e-5, rtol=0)


def test_minmax_stays_where_the_gradient_is_even():
    y = torch.nn.Parameter(torch.ones(1, 3))
    y.grad = torch.full((1, 3), 2.0)
    MinMax([y], 0.4, torch.tensor([[0.0]]), torch.tensor([[9.0]])).step()
    assert torch.equal(y.detach(), torch.ones(1, 3))


def test_the_prior_draws_its_own_clip():
    """Deterministic sampling of the exact prior of one clip ends at that clip from any noise: z_0 = r."""
    c = case()
    clip = OneClip(c.cond, seed=3, steps=7).clip()
    # each step keeps z on the line through r and the noise; float32 loses σ/α = 80 of 1e-7 at the first time
    torch.testing.assert_close((clip[0] + 1) / 2, c.cond.target(), atol=1e-4, rtol=0)
    noise = torch.randn(clip.shape, generator=torch.Generator().manual_seed(9))
    take = c.cond.prepare(Take.whole(PROBE.frames))
    torch.testing.assert_close(drawn(c.cond.guidance, take, noise, 3), clip, atol=2e-4, rtol=0)


@pytest.mark.parametrize("pictures", [True, False])
def test_photometric_loss_is_zero_at_the_truth_and_positive_elsewhere(pictures):
    z = torch.rand(1, 2, 24, 24, 3, generator=torch.Generator().manual_seed(0)) * 2 - 1
    assert abs(float(photometric(z, z, pictures=pictures))) < 1e-7  # SSIM(a, a) = 1 to rounding
    assert float(photometric(z, 0.9 * z, pictures=pictures)) > 1e-4


def test_photometric_loss_sees_the_frames_of_a_take():
    c = case()
    one = OneClip(c.cond, seed=0, steps=3)
    drop = c.bench.simulate(c.table)
    short = float(one.distil(drop, Take.whole(2), t=0.5))
    z = 2 * c.bench.film(drop, Take.whole(2))[None] - 1
    assert short == pytest.approx(float(photometric(z, one.clip()[:, :2], pictures=True)), rel=1e-5)


@pytest.mark.parametrize("law", KINDS)
def test_every_law_of_the_table_has_a_published_material(law):
    word = next(w for w in ("rubber", "clay", "sand", "honey", "water") if lookup(w).plastic == law)
    gaussians, particles = ball()
    motion = moving(word)
    field = PhysGaussian()(LOOK, motion, gaussians, particles, work=Workspace())
    assert (field.elastic, field.plastic) == PhysGaussian().experts(motion)[:2]
    bench = PROBE.bench(gaussians, particles, 0.4)
    x = bench.simulate(dataclasses.replace(PhysGaussian()(LOOK, motion, gaussians, bench.draft, work=Workspace())), 1).x
    assert bool(torch.isfinite(x).all())


def test_given_values_are_those_of_the_prior():
    particles = ball()[1]
    for motion in (moving("clay"), moving("cake", "melting")):
        given = PhysGaussian(values="table")(LOOK, motion, *ball(), work=Workspace())
        known = table_field(None, LOOK, motion, particles)
        assert given.plastic == known.plastic == (whole(motion).plastic,)
        assert all(torch.equal(given.theta[k], known.theta[k]) for k in known.theta)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: DreamPhysics(PRIOR, start=1e3), "low < start < high"),
        (lambda: PhysDreamer(PRIOR, steps=-1), "≥ 0"),
    ],
)
def test_bad_settings_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
