"""Kernels as text: they compile for CUDA too, and hold nothing that the scene does not need."""

from pathlib import Path

import pytest
import warp as wp

from diffuphy.material import make_mixture
from diffuphy.mpm import HalfSpace, Sphere
from diffuphy.mpm.adjoint import make_adjoint
from diffuphy.mpm.boundary import signature
from diffuphy.mpm.kernels import make_kernels


def test_kernels_are_made_once():
    mixture = make_mixture(("neo_hookean",), ("identity",), wp.float32)
    walls = signature((HalfSpace(friction=0.5),))
    assert make_kernels(mixture, walls, wp.float32) is make_kernels(mixture, walls, wp.float32)
    assert make_kernels(mixture, walls, wp.float32) is not make_kernels(mixture, (), wp.float32)


@pytest.mark.slow
@pytest.mark.parametrize("real", [wp.float32, wp.float64])
def test_kernels_compile_for_cuda(real, tmp_path):
    """Every kernel of a mixture with walls becomes PTX; no device is needed for that."""
    wp.init()
    mixture = make_mixture(("neo_hookean", "hencky"), ("identity", "von_mises"), real)
    walls = signature((HalfSpace(friction=0.5), Sphere(kind="slip")))
    forward, adjoint = make_kernels(mixture, walls, real), make_adjoint(mixture, walls, real)
    kernels = [forward.p2g, forward.grid_update, forward.g2p]
    kernels += [adjoint.grid_again, adjoint.g2p_adjoint, adjoint.grid_adjoint, adjoint.p2g_adjoint]
    for kernel in kernels:
        wp.compile_aot_module(kernel.module, arch=80, module_dir=tmp_path, use_ptx=True)
    assert len(list(Path(tmp_path).glob("*.ptx"))) == len(kernels)
