"""Leave out what a scene does not need, outside the simulation: learning, pictures, models, report.

Where a part can be set to do nothing, that equals a run without it to the last bit; absent, none of its code is run.
Which packages a run loads is tested in ``test_weight_free``.
"""

import dataclasses
import subprocess
import sys
from pathlib import Path

import pytest
import torch

import diffuphy.learning.fit_material as fit_module
from diffuphy.artifact import Done
from diffuphy.deliverables import export
from diffuphy.learning.probe import Bench
from diffuphy.losses.velocity import Velocity
from diffuphy.material.field import harden, prune
from diffuphy.mpm import rollout
from diffuphy.mpm.sampling.filling import Flood, Rays
from diffuphy.mpm.sampling.sample import Sample
from diffuphy.plan import Plan
from diffuphy.render import Film, orbit, render_gaussians, sh
from diffuphy.render.film.floor import Shadow
from diffuphy.render.kinematics import limit_stretch
from diffuphy.types import N_SH, Motion, Trajectory
from diffuphy.workspace import Workspace
from tests.learning.test_fit_material import ball, run, stage
from tests.mpm.bodies import field as material

ROOT = Path(__file__).parents[1]
HEAVY = ("diffusers", "transformers", "open_clip", "accelerate", "gsplat", "openai", "viser", "matplotlib", "lpips")


class Forbidden:
    """Something that must not be asked for."""

    def __init__(self, what):
        self.what = what

    def __call__(self, *args, **options):
        raise AssertionError(f"{self.what} was run")

    def __getattr__(self, name):
        raise AssertionError(f"{self.what}.{name} was asked for")


# ---------------------------------------------------------------- learning
def test_a_velocity_loss_of_weight_zero_is_no_velocity_loss(monkeypatch):
    """Same field to the last bit, nothing gathered, the loss never called; with weight it changes the field."""
    without = run(stage(velocity=None))
    with monkeypatch.context() as m:
        m.setattr(Velocity, "__call__", Forbidden("the velocity loss"))
        asked = []
        simulate = Bench.simulate
        m.setattr(Bench, "simulate", lambda self, *a, **k: (asked.append(k), simulate(self, *a, **k))[1])
        nothing = run(stage(velocity=Velocity("consistent", 0.0)))
        assert not any(options.get("gather") for options in asked)
    heavy = run(stage(velocity=Velocity("consistent", 10.0)))
    assert torch.equal(without.theta["E"], nothing.theta["E"])
    assert not torch.equal(without.theta["E"], heavy.theta["E"])


def test_without_steps_no_gradient_is_taken_and_no_adjoint_made(monkeypatch):
    """material.steps = 0: no kernel of the backward pass, no network step, and the field is that of the scan."""
    for name in ("make_adjoint", "make_nodes_adjoint"):
        monkeypatch.setattr(sys.modules["diffuphy.mpm.engine.program"], name, Forbidden(name))
    monkeypatch.setattr(torch.Tensor, "backward", Forbidden("backward"))
    assert len(run(stage(steps=0))) == len(ball()[1])


def test_without_enumeration_nothing_is_scanned(monkeypatch):
    monkeypatch.setattr(fit_module, "scan", Forbidden("the scan"))
    run(stage(stiffness_steps=0, steps=0))


def test_experts_without_weight_are_pruned_to_the_last_bit_of_the_film():
    """One-hot on hencky and von Mises among two and two: without the others, the same film, and none of their columns.

    Weights of 1 and 0 multiply and add exactly, and both mixtures work in the principal frame.
    """
    _, particles = ball(5)
    n = len(particles)
    field = material(
        n, ("hencky", "neo_hookean"), ("von_mises", "identity"), E=3e4, dtype=torch.float32, yield_stress=50.0
    )
    one = torch.tensor([1.0, 0.0]).expand(n, 2)
    field = dataclasses.replace(field, w_e=one.clone(), w_p=one.clone())
    pruned = prune(harden(field))
    assert pruned.dropped == ("neo_hookean", "identity") and pruned.moved == 0.0
    assert pruned.field.w_e.shape == pruned.field.w_p.shape == (n, 1)
    scene = fit_module.Probe(particles=64, frames=3).scene(0.12, 0.4)
    films = [rollout(scene, particles.x, particles.vol, f, frames=3) for f in (field, pruned.field)]
    assert torch.equal(films[0].x, films[1].x) and torch.equal(films[0].F, films[1].F)


# ---------------------------------------------------------------- pictures
def coloured(degree, rest=0.0):
    """The ball with harmonics of a degree, those above 0 equal to ``rest``."""
    gaussians, _ = ball(6)
    values = torch.full((len(gaussians), N_SH[degree], 3), rest)
    values[:, :1] = gaussians.sh
    return dataclasses.replace(gaussians, sh=values)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_harmonics_of_no_amplitude_are_no_harmonics(degree):
    """rgb = ½ + Σ sh Y: zero coefficients add exactly 0; others show; degree 0 has none to rotate or to store."""
    camera, white = orbit([20.0], 15.0, 3.0, width=32, height=32), torch.ones(3)
    F = torch.eye(3).expand(len(coloured(0)), 3, 3) + 0.1
    plain, zero, more = (render_gaussians(g, camera, F=F, background=white).rgb
                         for g in (coloured(0), coloured(degree), coloured(degree, 0.3)))  # fmt: skip
    assert torch.equal(plain, zero) and not torch.equal(plain, more)
    assert coloured(0).sh.shape[1] == 1


def test_degree_zero_looks_at_no_direction(monkeypatch):
    for name in ("polar", "basis", "rotate"):
        monkeypatch.setattr(sh, name, Forbidden(name))
    camera = orbit([20.0], 15.0, 3.0, width=16, height=16)
    F = torch.eye(3).expand(len(coloured(0)), 3, 3) + 0.1
    render_gaussians(coloured(0), camera, F=F, background=torch.ones(3))


def test_a_solid_has_no_interior_to_fill():
    """A cloud that is dense throughout encloses nothing: all settings give the same particles, bit by bit."""
    gaussians, _ = ball(9)
    motion, work = Motion("falling", "", size=0.4), Workspace()
    filled, rays, bare = (Sample(cells=8, filling=f)(gaussians, motion, work=work) for f in (Flood(), Rays(), None))
    assert all(torch.equal(p.x, bare.x) and torch.equal(p.vol, bare.vol) for p in (filled, rays))


def still(frames=2):
    """A ball that rests above the floor."""
    gaussians, particles = ball(6)
    x = particles.x + torch.tensor([0.0, 0.0, 0.3])
    F = torch.eye(3).expand(frames, len(x), 3, 3)
    return gaussians, particles, Trajectory(x.expand(frames, *x.shape), torch.zeros(frames, *x.shape), F, 30.0)


@pytest.mark.parametrize("settings", [dict(shadow=0.0), dict(floor=False)])
def test_a_film_without_a_shadow_casts_none(settings, monkeypatch):
    monkeypatch.setattr(Shadow, "over", Forbidden("the shadow"))
    Film(width=32, height=32, **settings)(*still(), work=Workspace())


def test_a_shadow_shows():
    bare, dark = (Film(width=32, height=32, shadow=s)(*still(), work=Workspace()).rgb for s in (0.0, 0.5))
    assert not torch.equal(bare, dark)


def test_gaussians_that_are_not_stretched_are_not_decomposed(monkeypatch):
    monkeypatch.setattr(torch.linalg, "svd", Forbidden("a decomposition"))
    F = torch.eye(3).expand(50, 3, 3) * 1.2
    assert limit_stretch(F, 3.0) is F


def test_a_run_that_ends_before_the_film_writes_none(monkeypatch, tmp_path):
    """until=gaussians: no film, no sheet, no report; the module that encodes films is not even imported."""
    import diffuphy.deliverables as module

    for name in ("Report", "write", "contact_sheet", "maps", "views"):
        monkeypatch.setattr(module, name, Forbidden(name))
    folder = tmp_path / "gaussians"
    folder.mkdir()
    coloured(0).save(folder)
    files = export(tmp_path, [Done("gaussians", folder, False, 0.0, 0.0)], Plan({}, ()), title="", settings="")
    assert list(files) == ["gaussians"]


# ---------------------------------------------------------------- modules
def loaded(code):
    """Top-level modules that a fresh interpreter has after some code."""
    script = f"{code}\nimport sys\nprint(*sorted({{m.split('.')[0] for m in sys.modules}}))"
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True)
    return set(done.stdout.split())


def test_the_simulator_alone_loads_no_pictures_and_no_priors():
    code = "import diffuphy.mpm, sys; print(*[m for m in sys.modules if m.startswith('diffuphy.')], file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    rooms = {m.split(".")[1] for m in done.stderr.split() if m.startswith("diffuphy.")}
    assert rooms <= {"mpm", "material", "types", "workspace", "geometry", "compiling"}
    assert not loaded("import diffuphy.mpm") & {*HEAVY, "hydra", "imageio_ffmpeg", "torchvision"}
