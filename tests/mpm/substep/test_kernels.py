"""Kernels as text: they compile for CUDA too, and hold nothing that the scene does not need."""

import re
from types import SimpleNamespace

import pytest
import warp as wp

from diffuphy.material import PLASTIC, make_mixture
from diffuphy.mpm import HalfSpace, Scheme, Sphere
from diffuphy.mpm.boundary import signature
from diffuphy.mpm.drive import Drag, Held, drive_signature
from diffuphy.mpm.substep.adjoint import make_adjoint
from diffuphy.mpm.substep.gather import make_gather
from diffuphy.mpm.substep.kernels import make_kernels
from diffuphy.mpm.substep.nodes import make_nodes
from diffuphy.mpm.substep.nodes_adjoint import make_nodes_adjoint
from diffuphy.mpm.substep.sharpen import make_sharpening
from diffuphy.mpm.substep.variant import Variant
from tests.mpm.text import source

NEO = ("neo_hookean",), ("identity",)


def variant(laws=NEO, real: type = wp.float32, scheme: Scheme = Scheme(), **more) -> Variant:  # noqa: B008, frozen
    elastic, plastic, *branches = laws
    return Variant(make_mixture(elastic, plastic, real, *branches), real, scheme, **more)


def forward(v: Variant) -> list[wp.Kernel]:
    """What a round launches."""
    nodes = make_nodes(v)
    between = [nodes.divide] * v.two_passes + [make_sharpening(v).cells] * v.scheme.sharpen
    kernels = make_kernels(v)
    return [kernels.p2g, *between, nodes.move, kernels.g2p]


def backward(v: Variant) -> list[wp.Kernel]:
    """What a round backwards launches besides."""
    return [k for parts in (make_adjoint(v), make_nodes_adjoint(v)) for k in of(parts)]


def of(parts: SimpleNamespace) -> list[wp.Kernel]:
    return [k for k in vars(parts).values() if isinstance(k, wp.Kernel)]


def test_kernels_are_made_once():
    """Equal variants share their kernels, also when they were made apart."""
    walls = signature((HalfSpace(friction=0.5),))
    assert make_kernels(variant(walls=walls)) is make_kernels(variant(walls=walls))
    assert make_kernels(variant(walls=walls)) is not make_kernels(variant())
    assert make_kernels(variant()).p2g is not make_kernels(variant(real=wp.float64)).p2g


def functions(kernel: wp.Kernel) -> set[str]:
    """Names of the Warp functions in the text of a kernel, and of what they take from the C++ library that costs."""
    text = re.sub(r"//.*", "", source(kernel))
    own = {n for n in re.findall(r"^static .*?(\w+?)_\d+\(", text, flags=re.MULTILINE) if not n.startswith("adj")}
    costly = re.findall(r"wp::(sqrt|exp|log|pow|acos|atan2|sin|cos|svd3|qr3|eig3|length|normalize)\(", text)
    return {n.split("__locals__")[-1] for n in own} | set(costly)


SPLINE = {"weights", "inside", "cell", "eye"}
NEEDED = {
    "p2g": SPLINE
    | {"row", "column", "placed", "beside", "bring", "scatter", "plus", "add"}
    | {"material_of", "stress", "direct", "lame_theta"}
    | {"strain", "gram", "volume", "dilation", "growth", "determinant", "eliminated", "log1p", "log"},
    "divide": {"index", "summed"},
    "cells": {"index", "flat", "corner", "gradient", "lightest", "packed"},
    "move": {"index", "flat", "corner", "neighbour", "sharpened", "free", "summed"},
    "g2p": SPLINE
    | {"around", "fields", "first", "second", "gather", "plus", "take", "moments", "turned", "determinant"}
    | {"eliminated"},
}
"""All that a neo-Hookean body in free space may call; the logarithm is that of its law."""

EXTRAS = {
    "p2g": {"decompose", "flow", "hold", "accelerate", "branch_stress", "stress_h", "exp", "sqrt"},
    "divide": {"folded", "image", "signed", "odd", "seen", "side"},
    "move": {"act", "surface", "apply"},
    "g2p": {"hold", "log_det"},
}
"""Some of what plasticity, branches, memory, drives, walls and mirrors bring with them."""


def name(kernel: wp.Kernel) -> str:
    return kernel.key.rsplit("__", 1)[-1]


@pytest.mark.parametrize("scheme", [Scheme(), Scheme.mls()], ids=["default", "mls"])
def test_a_neo_hookean_body_without_walls_pays_for_nothing_else(scheme):
    """No decomposition, return map, friction, mirror, drive, memory or branch in any kernel: three of the plain scheme,
    five of the default."""
    kernels = forward(variant(scheme=scheme))
    assert len(kernels) == (5 if scheme.sharpen else 3)
    for kernel in kernels:
        turns = {"turned"} if scheme.retain > 0.0 and name(kernel) == "g2p" else set()
        assert functions(kernel) <= NEEDED[name(kernel)] | turns, name(kernel)


def test_what_is_asked_for_is_there():
    """The words of the test above do tell: the kernels of a scene with everything hold them."""
    laws = ("neo_hookean", "hencky"), ("identity", "drucker_prager"), ("maxwell",)
    walls, drives = signature((HalfSpace(friction=0.5),)), drive_signature((Drag(time=1.0), Held()))
    for kernel in forward(variant(laws, walls=walls, mirror=True, drives=drives)):
        assert EXTRAS.get(name(kernel), set()) <= functions(kernel) - NEEDED[name(kernel)], name(kernel)


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """Compiles kernels to PTX, which needs no device; each text once."""
    folder, done = tmp_path_factory.mktemp("ptx"), set()

    def compile(kernels: list[wp.Kernel]) -> None:
        for kernel in kernels:
            identifier = kernel.module.get_module_identifier(256)
            if identifier not in done:
                wp.compile_aot_module(kernel.module, arch=80, module_dir=folder, use_ptx=True)
                done.add(identifier)
                assert (folder / f"{identifier}.sm80.ptx").stat().st_size > 0

    return compile


WALLS = (HalfSpace(friction=0.5), Sphere(kind="slip"))
ELASTIC = ("neo_hookean", "fixed_corotated", "hencky")


@pytest.mark.parametrize(("real", "elastic"), [(wp.float32, False), (wp.float64, False), (wp.float32, True)])
def test_the_default_scheme_compiles_for_cuda(elastic, real, compiled):
    """Forward, backward and gathering, with a floor, a mirror and a ball that holds; films are made with elastic
    contact."""
    walls, scheme = signature(WALLS, elastic), Scheme(contact="elastic" if elastic else "rigid")
    v = variant(real=real, scheme=scheme, walls=walls, held=(1,), mirror=True, twice=True)
    compiled([*forward(v), *backward(v), *of(make_gather(v))])


@pytest.mark.slow
@pytest.mark.parametrize("real", [wp.float32, wp.float64])
@pytest.mark.parametrize("order", [2, 3])
@pytest.mark.parametrize("force", ["mls", "classic"])
@pytest.mark.parametrize("extras", [False, True], ids=["plain", "extras"])
def test_every_scheme_compiles_for_cuda(extras, force, order, real, compiled):
    """All splines and forces, with all parts of the scheme and without, walls of both kinds, measured impulses."""
    plain = {} if extras else {"half_kick": False, "mirror": False, "sharpen": False, "retain": 0.0}
    scheme = Scheme(order=order, force=force, **plain)
    v = variant(real=real, scheme=scheme, walls=signature(WALLS), mirror=extras, measures=True, twice=True, body=extras)
    compiled([*forward(v), *backward(v), *of(make_gather(v))])


@pytest.mark.slow
@pytest.mark.parametrize("real", [wp.float32, wp.float64])
@pytest.mark.parametrize("plastic", [p for p in PLASTIC if p != "identity"])
def test_every_law_compiles_for_cuda(plastic, real, compiled):
    """Each flow rule with all elastic laws and the identity beside it, a viscous branch and drives, as configurations
    may ask for."""
    drives = drive_signature((Drag(time=1.0), Held()))
    v = variant((ELASTIC, ("identity", plastic), ("maxwell",)), real, walls=signature(WALLS), drives=drives, twice=True)
    kernels = make_kernels(v)
    compiled([kernels.p2g, kernels.g2p, *of(make_adjoint(v))])
