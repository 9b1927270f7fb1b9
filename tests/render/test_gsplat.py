"""The adapter to gsplat, as far as it can be tested without the package and without a GPU."""

import sys

import pytest
import torch

from diffuphy.render import Gsplat, Warp, orbit, rasterize

try:
    from .ball import ball
except ImportError:
    from ball import ball


def test_cpu_tensors_are_refused_with_the_way_out() -> None:
    with pytest.raises(ValueError, match=r"CUDA device, got torch.float32 on cpu; use backend=Warp\(\)"):
        rasterize(**ball(5, torch.float32), camera=orbit([0.0], 0.0, 3.0, width=8, height=8), backend=Gsplat())


def test_importing_the_adapter_does_not_import_gsplat() -> None:
    assert "gsplat" not in sys.modules


@pytest.mark.gpu
def test_a_missing_package_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gsplat", None)
    operands = {name: x.cuda() for name, x in ball(5, torch.float32).items()}
    with pytest.raises(ModuleNotFoundError, match=r"diffuphy\[gsplat\]"):
        rasterize(**operands, camera=orbit([0.0], 0.0, 3.0, width=8, height=8), backend=Gsplat())


@pytest.mark.gpu
def test_gsplat_draws_the_same_image() -> None:
    """Both draw Σ = F R S² Rᵀ Fᵀ; they differ in when a pixel is finished and in α_max: one grey level at most
    pixels."""
    pytest.importorskip("gsplat")
    operands = {name: x.cuda() for name, x in ball(500, torch.float32).items()}
    camera = orbit([30.0, 120.0], 20.0, 3.0, width=64, height=64).to("cuda")
    ours, theirs = (rasterize(**operands, camera=camera, backend=b) for b in (Warp(), Gsplat()))
    assert (ours.rgb - theirs.rgb).abs().mean() < 1 / 255
    torch.testing.assert_close(ours.means2d, theirs.means2d, rtol=1e-4, atol=1e-3)
