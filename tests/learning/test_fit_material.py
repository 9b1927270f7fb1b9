"""The material stage: scan, train through the whole gradient path, harden; resumable to the last bit."""

import dataclasses
import json
import math
from typing import Any

import pytest
import torch

from diffuphy.learning import scan as module
from diffuphy.learning.appearance import appearance
from diffuphy.learning.descent import descend
from diffuphy.learning.fit_material import FitMaterial
from diffuphy.learning.probe import Probe, TableClips
from diffuphy.learning.scan import region_values, scan
from diffuphy.losses import sds
from diffuphy.losses.guidance.analytic import Analytic
from diffuphy.losses.takes import Take, Takes
from diffuphy.losses.velocity import Velocity
from diffuphy.material.net import Net
from diffuphy.types import Gaussians, Look, Motion, Particles, SimulationDiverged
from diffuphy.workspace import Workspace

LOOK = Look("ball", "a ball")


def ball(n=9, size=0.4):
    """A ball on a lattice, each particle carrying one Gaussian; striped so that turning is seen."""
    a = (torch.arange(n) + 0.5) / n * 2 - 1
    grid = torch.cartesian_prod(a, a, a)
    means = grid[grid.norm(dim=1) < 1]
    stripes = (torch.sin(7 * means[:, 2:]) > 0).float()
    rgb = stripes * torch.tensor([0.9, 0.3, 0.2]) + (1 - stripes) * torch.tensor([0.95, 0.8, 0.3])
    G = len(means)
    gaussians = Gaussians(
        means,
        torch.tensor([1.0, 0, 0, 0]).repeat(G, 1),
        torch.full((G, 3), -2.2),
        torch.full((G,), 3.0),
        ((rgb - 0.5) / 0.28209479)[:, None, :],
    )
    h = size / n
    particles = Particles(means * size / 2, torch.full((G,), h**3), torch.arange(G), size / 2, (0.0, 0.0, 0.0), h)
    return gaussians, particles


PROBE = Probe(particles=200, frames=5, image=32)
NET = Net(groups=12, group_size=12, width=16, depth=1, heads=2)


def stage(**settings):
    defaults = {
        "elastic": ("neo_hookean",),
        "plastic": ("identity",),
        "net": NET,
        "probe": PROBE,
        "scan_frames": 4,
        "stiffness_steps": 3,
        "steps": 3,
    }
    return FitMaterial(guidance=Analytic(layout="clip", s=0.0), **(defaults | settings))


def run(component, material="rubber", work=None):
    gaussians, particles = ball()
    motion = Motion("falling", f"a {material} ball falling", {"": material}, 0.4)
    return component(LOOK, motion, gaussians, particles, work=work or Workspace())


def test_field_covers_all_particles_is_one_hot_and_is_told(tmp_path):
    """Rows of 0 and 1, a sheet of target and present drop, and a sentence for each part."""
    field = run(stage(plastic=("identity", "von_mises"), refine=1), work=Workspace(tmp_path, progress=False))
    _, particles = ball()
    assert len(field) == len(particles)
    for w in (field.w_e, field.w_p):
        assert torch.equal(w.sum(1), torch.ones(len(field))) and torch.equal(w.amax(1), torch.ones(len(field)))
    assert {p.name for p in (tmp_path / "previews").iterdir()} == {"material-00000.png", "material-00003.png"}
    (words,) = json.loads((tmp_path / "summary.json").read_text())["parts"]
    assert words.startswith("object: ") and "neo_hookean, identity" in words


def test_the_filmed_field_does_not_depend_on_the_time_step():
    """Gates in rate form, 1 − (1 − w)^(Δt/t_ref), leave 0 and 1 as they are: any t_ref gives the same bits."""
    case = made(stage(plastic=("identity", "von_mises")))
    w_p = torch.nn.functional.one_hot((case.points.x[:, 2] > 0).long(), 2).float()
    split = dataclasses.replace(case.table, w_p=w_p)
    drops = [case.bench.simulate(split, gate_time=t) for t in (None, 1 / 30, 1 / 100)]
    soft = dataclasses.replace(split, w_p=0.9 * w_p + 0.05)
    others = [case.bench.simulate(soft, gate_time=t) for t in (1 / 30, 1 / 100)]
    assert torch.equal(drops[0].x, drops[1].x) and torch.equal(drops[0].F, drops[2].F)
    assert not torch.equal(others[0].x, others[1].x)


def test_scan_finds_the_stiffness_of_the_reference_within_a_quarter_of_its_grid():
    """3 values over [3.6, 6.2] are 1.3 apart; two halvings of the compass search leave a quarter of that."""
    field = run(stage(steps=0, stiffness=(3.5, 6.3)), material="jelly")
    assert float(field.theta["E"].log10().mean()) == pytest.approx(4.477, abs=1.3 / 4)


class Scores(Workspace):
    """Remembers the scores of a scan."""

    def __init__(self):
        super().__init__(progress=False)
        self.seen = []

    def log(self, step, **scalars):
        self.seen.append(scalars["scan"])


def test_hypotheses_of_one_time_step_in_one_launch_score_as_one_by_one(monkeypatch):
    """Two regions, two laws, two stiffnesses: 16 hypotheses in two launches; where one of a launch cannot be simulated
    all are, one by one. √L is a distance of clips, so it differs by no more than two clips of one hypothesis are apart:
    in a launch all take the substeps of the fastest, some 40 a frame, an error of the first order, Δt/T = 1/160 of the
    most that clips differ."""
    case = made(stage(elastic=("hencky",), plastic=("identity", "von_mises")), "playdoh")
    case = dataclasses.replace(case, labels=(case.points.x[:, 2] > 0).long())

    def scores(**batched):
        watch = Scores()
        scan(case, (4.0, 5.0), frames=4, weight="x0", work=watch, few=1, **batched)
        return torch.tensor(watch.seen)

    launches, alone = [], scores()
    together = module.rollout_batch
    monkeypatch.setattr(module, "rollout_batch", lambda *a, **k: launches.append(len(a[3])) or together(*a, **k))
    assert len(alone) == 16
    far = float(alone.max().sqrt())
    torch.testing.assert_close(scores(batched=True).sqrt(), alone.sqrt(), rtol=0, atol=far / 160)
    assert sorted(launches) == [4, 12]

    def torn(*scene, **options):
        raise SimulationDiverged("particle 3 was turned inside out")

    monkeypatch.setattr(module, "rollout_batch", torn)
    assert torch.equal(scores(batched=True), alone)


def test_training_moves_the_stiffness_towards_the_reference():
    """From a tenth of the truth, and from ten times it, without a scan."""
    from diffuphy.material.presets import lookup

    truth = torch.tensor(lookup("rubber").E).log10().item()
    for start in (truth - 0.6, truth + 0.6):
        field = run(stage(stiffness_steps=0, start=start, steps=6, lr_region=0.15, stiffness=(3.5, 7.0)))
        assert abs(float(field.theta["E"].log10().mean()) - truth) < 0.9 * 0.6


def test_from_a_start_that_is_much_too_soft_only_a_blurred_clip_leads_to_the_reference():
    """A flat body on the floor and one in the air do not overlap: dL/d(log E) of sharp pictures is positive, towards
    still softer; through a low-pass of an eighth of the picture it is negative."""
    case, truth = made(stage()), math.log10(4e5)
    slope = {}
    for blur in (0.0, 1 / 8):
        log_E = torch.tensor(truth - 2.1, requires_grad=True)
        theta = case.table.theta | {"E": (10**log_E).expand(len(case.table))}
        drop = case.bench.simulate(dataclasses.replace(case.table, theta=theta))
        take = dataclasses.replace(Take.whole(4), blur=blur)
        loss = case.cond.distil(drop, take, t=0.5, generator=torch.Generator().manual_seed(1), weight="x0")
        (slope[blur],) = torch.autograd.grad(loss, log_E)
    assert slope[0.0] > 0 > slope[1 / 8]


def test_stiffness_and_yield_stress_are_learnt_together():
    """From twice the stiffness and twice the yield stress of the reference, both errors |ln θ/θ*| fall; their ratio
    is seen much less than their size."""
    component = stage(plastic=("von_mises",), elastic=("hencky",), learn=("E", "yield_stress"), lr_region=0.15)
    case = made(component, "playdoh")
    (true,) = region_values(case.table, case.labels)
    off = {"E": 2 * true["theta"]["E"], "yield_stress": 2 * true["theta"]["yield_stress"]}
    start = {"elastic": "hencky", "plastic": "von_mises", "theta": true["theta"] | off, "rho": true["rho"]}
    model = component.model(case, [start])
    descend(case, model, dataclasses.replace(component.descent(6), patience=0), Workspace())
    with torch.no_grad():
        found = model().theta
    for name in off:
        error = abs(math.log(float(found[name].log().mean().exp()) / true["theta"][name]))
        assert error < 0.9 * math.log(2), name


WHOLE: dict[str, Any] = {}
"""Fields of uninterrupted runs."""
LONG = {"steps": 4, "refine": 2, "refine_steps": 1, "stiffness_steps": 2, "plastic": ("identity", "von_mises")}


class Kill(Workspace):
    """Saves whenever it may, and ends the run at a save of a kind."""

    def __init__(self, directory, phase, count):
        super().__init__(directory, progress=False)
        self.phase, self.left = phase, count

    def due(self):
        return True

    def save(self, state):
        super().save(state)
        phase = "scan" if "scores" in state else f"{'run' if 'run' in state else 'between'} {len(state['tried'])}"
        self.left -= phase == self.phase
        if self.left == 0:
            raise KeyboardInterrupt


SOME = Takes("window", count=3, views=4, background="random")


@pytest.mark.parametrize(
    ("takes", "phase", "count"),
    [(Takes(), "scan", 2), (Takes(), "run 1", 1), (Takes(), "between 1", 1), (Takes(), "run 2", 3), (SOME, "run 2", 2)],
)
def test_interrupted_training_continues_to_the_same_bits(tmp_path, takes, phase, count):
    """Killed in the scan, in a refinement, between two of them, between two steps of the training: the same field."""
    component = stage(takes=takes, **LONG)
    if takes.frames not in WHOLE:
        WHOLE[takes.frames] = run(component)
    whole = WHOLE[takes.frames]
    with pytest.raises(KeyboardInterrupt):
        run(component, work=Kill(tmp_path, phase, count))
    resumed = run(component, work=Workspace(tmp_path, progress=False))
    for name in whole.theta:
        assert torch.equal(whole.theta[name], resumed.theta[name])
    assert torch.equal(whole.w_p, resumed.w_p)


def test_gradient_reaches_every_weight_of_the_network():
    """Pixels → Gaussians → trajectory → MPM adjoint → decoder → encoder: no parameter is cut off."""
    gaussians, particles = ball()
    component = stage(plastic=("identity", "von_mises"))
    case = component.case(LOOK, Motion("falling", "x", {"": "rubber"}, 0.4), gaussians, particles)
    (region,) = region_values(case.table, case.labels)
    start = {"elastic": None, "plastic": None, "theta": region["theta"] | {"E": 1e5}, "rho": region["rho"]}
    model, bench, cond = component.model(case, [start]), case.bench, case.cond
    net = model.net
    torch.nn.init.normal_(net.decoder.head[-1].weight, std=1e-3)  # the zero head would stop the gradient behind it
    drop = bench.simulate(model(), 4, gate_time=1 / 30)
    loss = cond.distil(drop, Take.whole(4), t=0.5, generator=torch.Generator().manual_seed(1), weight="x0")
    ours = torch.autograd.grad(loss, list(net.parameters()), retain_graph=True)
    assert all(float(g.abs().max()) > 0 for g in ours)

    # and is that of one graph from the score back to the network, to the bit
    settings = {"t": torch.tensor([0.5]), "generator": torch.Generator().manual_seed(1), "weight": "x0"}
    clip = bench.film(drop)
    value = sds(cond.guidance, clip[None], cond.prepare(Take.whole(4)), **settings) / clip.numel()
    for a, b in zip(ours, torch.autograd.grad(value, list(net.parameters())), strict=True):
        assert torch.equal(a, b)


def test_only_what_a_take_shows_is_simulated_and_drawn(monkeypatch):
    """Blocks of two frames out of five in turn: 1–2, 3–4, 4–5; each drawn for the score and once more for its
    gradient."""
    import diffuphy.learning.probe as probe

    simulated, drawn = [], []
    simulate, render = probe.Bench.simulate, probe.render_gaussians

    def watched(self, field, frames=None, **options):
        if torch.is_grad_enabled():
            simulated.append(frames)
            drawn.append(0)
        return simulate(self, field, frames, **options)

    def counted(*args, means, **options):
        drawn[-1] += torch.is_grad_enabled()  # references are drawn without
        return render(*args, means=means, **options)

    monkeypatch.setattr(probe.Bench, "simulate", watched)
    monkeypatch.setattr(probe, "render_gaussians", counted)
    monkeypatch.setattr("diffuphy.learning.fit_material.verdict", lambda *_: {})
    monkeypatch.setattr("diffuphy.learning.descent._Trainer.judge", lambda *_: True)
    run(stage(stiffness_steps=0, curriculum=(5,), steps=3, takes=Takes("consecutive", count=2)))
    assert simulated == [2, 4, 5] and drawn == [4, 4, 4]


@pytest.mark.parametrize("form", ["literal", "consistent", "momentum", "image"])
def test_every_velocity_loss_runs_and_its_value_is_finite(form):
    field = run(stage(velocity=Velocity(form, 1e-3), steps=1))
    assert bool(torch.isfinite(field.theta["E"]).all())


def made(component, material="rubber"):
    return component.case(LOOK, Motion("falling", "x", {"": material}, 0.4), *ball())


def test_reference_clips_are_another_draw_of_particles():
    case = made(stage())
    theirs = case.cond.guidance.references
    assert isinstance(theirs, TableClips)
    mine = case.bench.draft.x
    assert theirs.bench.draft.x.shape != mine.shape or not torch.equal(theirs.bench.draft.x, mine)


def test_a_real_prior_keeps_its_own_references():
    class Film:
        layout = "clip"

    component = dataclasses.replace(stage(), guidance=Film())
    assert made(component).cond.guidance is component.guidance


def test_table_needs_its_expert_among_the_candidates():
    with pytest.raises(ValueError, match="drucker_prager"):
        run(stage(elastic=("hencky",), plastic=("identity",)), material="sand")


def test_appearance_of_filler_is_that_of_the_nearest_gaussian():
    gaussians, particles = ball()
    particles = dataclasses.replace(
        particles, gaussian=torch.where(torch.arange(len(particles)) == 7, -1, particles.gaussian)
    )
    own = appearance(gaussians, ball()[1])
    assert torch.equal(appearance(gaussians, particles).f, own.f)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"stiffness": (6.0, 4.0)}, "lo < hi"),
        ({"start": 9.0}, "inside"),
        ({"steps": -1}, "≥ 0"),
        ({"scan_frames": 99}, "probe.frames"),
        ({"override": {"E": -1.0}}, "E"),
        ({"override": {"nu": 0.5}}, "fluid"),
        ({"override": {"E": 5e6}}, "material.stiffness"),
        ({"override": {"young": 1e5}}, "it takes E, nu"),
    ],
)
def test_bad_settings_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        stage(**settings)
