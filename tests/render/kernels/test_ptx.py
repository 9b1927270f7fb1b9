"""Every kernel compiles for CUDA, without a CUDA device: to PTX, by the compiler that Warp brings along."""

import pytest
import warp as wp

from diffuphy.render.kernels import binning
from diffuphy.render.kernels.compositing import compositing_kernels
from diffuphy.render.kernels.projection import projection_kernels

AMPERE = 80
"""Compute capability; the lowest that current torch wheels still support well."""


@pytest.mark.parametrize("real", [wp.float32, wp.float64])
def test_kernels_compile_to_ptx(real: type, tmp_path) -> None:
    sets = [projection_kernels(real, False), projection_kernels(real, True), compositing_kernels(real), binning]
    kernels = [k for s in sets for k in vars(s).values() if isinstance(k, wp.Kernel)]
    assert len(kernels) == 12
    for k, kernel in enumerate(kernels):
        wp.compile_aot_module(kernel.module, arch=AMPERE, use_ptx=True, module_dir=tmp_path / str(k))
        (ptx,) = (tmp_path / str(k)).glob("*.ptx")
        text = ptx.read_text()
        assert ".target sm_80" in text
        assert kernel.key in text
