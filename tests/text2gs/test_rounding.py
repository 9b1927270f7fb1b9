"""Needles become rounder, and the pictures stay."""

import json
import math

import pytest
import torch

from diffuphy.losses.guidance.analytic import Analytic
from diffuphy.render import orbit, render_gaussians
from diffuphy.render.scenes.ply import write
from diffuphy.render.sh import from_rgb
from diffuphy.text2gs.cameras import Orbits
from diffuphy.text2gs.fit import FitGaussians
from diffuphy.text2gs.load import LoadGaussians
from diffuphy.text2gs.rounding import Rounding, ratios
from diffuphy.text2gs.shapes import Library
from diffuphy.types import Gaussians, Look
from diffuphy.workspace import Workspace


def hedgehog(n: int = 400) -> Gaussians:
    """A ball of round Gaussians, every tenth a needle of ratio 40."""
    k = torch.arange(n) + 0.5
    polar, azimuth = torch.acos(1 - 2 * k / n), math.pi * (1 + 5**0.5) * k
    x = torch.stack([azimuth.cos() * polar.sin(), azimuth.sin() * polar.sin(), polar.cos()], 1)
    scales = torch.full((n, 3), 0.09)
    scales[::10] = torch.tensor([0.24, 0.006, 0.006])
    quats = torch.randn(n, 4, generator=torch.Generator().manual_seed(0))
    return Gaussians(x, quats, scales.log(), torch.full((n,), 2.0), from_rgb(0.5 + 0.4 * x))


SHORT = Rounding(4.0, steps=60, cameras=Orbits(bank=12, size=48))


def difference(a: Gaussians, b: Gaussians) -> float:
    """Mean squared, from cameras in between those of the fine-tuning."""
    camera = orbit([40.0, 160.0, 280.0], [20.0, 0.0, 50.0], 3.4, width=48, height=48)
    first, second = (render_gaussians(g, camera, background=torch.ones(3)).rgb for g in (a, b))
    return float((first - second).square().mean())


def test_no_gaussian_stays_longer_than_the_ratio_and_the_picture_is_nearer_than_by_force(tmp_path):
    """The longest ratio falls from 40 to r, to rounding; the picture changes less than when shortest axes are merely
    raised to the bound."""
    before = hedgehog()
    work = Workspace(tmp_path)
    after = SHORT(before, work=work)
    assert float(ratios(before).max()) == pytest.approx(40.0, rel=1e-5)
    assert float(ratios(after).max()) <= 4.0 * (1 + 1e-5)
    s = before.log_scales
    forced = Gaussians(before.means, before.quats, torch.maximum(s, s.amax(1, keepdim=True) - math.log(4.0)),
                       before.logit_opacities, before.sh)  # fmt: skip
    assert difference(before, after) < 0.5 * difference(before, forced)
    said = json.loads((tmp_path / "metrics.jsonl").read_text().splitlines()[-1])
    assert said["ratio_before"] == pytest.approx(40.0, rel=1e-5) and said["ratio_after"] <= 4.0 * (1 + 1e-5)
    assert said["above_before"] == pytest.approx(0.1) and said["above_after"] == 0.0 and said["psnr"] > 20.0


def test_round_gaussians_stay_what_they_are():
    """Nothing is longer than r and the pictures are those of the target: no gradient but rounding's, which Adam makes
    steps of; they move by less than the rasteriser's cut-off at 1/255, a mean square of 1e-5."""
    round_ = hedgehog()
    round_.log_scales[:] = math.log(0.09)
    assert difference(round_, SHORT(round_)) < 1e-5


def test_given_gaussians_are_rounded_on_demand(tmp_path, monkeypatch):
    """gaussians.anisotropy = r; without it nothing is even imported."""
    write(tmp_path / "needles.ply", hedgehog())
    plain = LoadGaussians(str(tmp_path / "needles.ply"))(Look("", ""))
    assert float(ratios(plain).max()) == pytest.approx(40.0, rel=1e-4)
    monkeypatch.setattr("diffuphy.text2gs.rounding.Rounding.steps", 5)
    monkeypatch.setattr("diffuphy.text2gs.rounding.Rounding.__call__", lambda self, g, work: (self, g))
    load = LoadGaussians(str(tmp_path / "needles.ply"), anisotropy=6.0)
    component, _ = load(Look("", ""))
    assert component.ratio == 6.0
    with pytest.raises(ValueError, match="anisotropy must be at least 1"):
        LoadGaussians(str(tmp_path / "needles.ply"), anisotropy=0.5)


def test_the_term_of_the_fit_makes_gaussians_rounder():
    """With a large weight and r = 1 less than half of the excess over 1 is left."""

    def fitted(weight: float) -> Gaussians:
        fit = FitGaussians(Analytic(Library()), Orbits(bank=6, size=32), steps=25, densify=None, anisotropy=weight,
                           anisotropy_ratio=1.0)  # fmt: skip
        return fit(Look("ball", "a ball"))

    without, with_ = (float(ratios(fitted(w)).mean()) for w in (0.0, 1e4))
    assert with_ - 1 < 0.5 * (without - 1)
    with pytest.raises(ValueError, match="anisotropy must not be negative"):
        FitGaussians(Analytic(Library()), anisotropy=-1.0)


def test_an_unused_term_is_not_evaluated(monkeypatch):
    def forbidden(*_):
        raise AssertionError("the anisotropy of a fit without weight")

    monkeypatch.setattr("diffuphy.text2gs.fit.anisotropy", forbidden)
    FitGaussians(Analytic(Library()), Orbits(bank=6, size=16), steps=2)(Look("ball", "a ball"))


@pytest.mark.parametrize("wrong", [dict(ratio=0.9), dict(weight=-1.0), dict(steps=0)])
def test_settings_without_meaning_are_errors(wrong):
    with pytest.raises(ValueError, match="ratio and steps must be at least 1"):
        Rounding(**wrong)
