"""What is no material is refused where matter is made."""

import dataclasses

import pytest
import torch

from diffuphy.mpm import Scene, simulate
from diffuphy.mpm.state import make_matter
from tests.mpm.bodies import block, field

X, VOL = block((1, 1, 1), 0.1)
LAWS = ("neo_hookean", "hencky"), ("identity", "fluid")


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("name", ["w_e", "w_p"])
@pytest.mark.parametrize(
    ("row", "message"),
    [
        ([0.5, 0.6], r"\[0.5, 0.6\] .*at least 0 and sum to 1, these sum to 1.1"),
        ([1.5, -0.5], r"\[1.5, -0.5\] .*at least 0 and sum to 1"),
        ([0.0, 0.0], r"these sum to 0"),
        ([float("nan"), 1.0], r"\[nan, 1.0\]"),
    ],
)
def test_weights_off_the_simplex_are_refused(row, message, name, dtype):
    """Row, particle, what is allowed and what to do; the kernels would answer with a stress that is none."""
    f = field(len(X), *LAWS, dtype=dtype)
    w = getattr(f, name).clone()
    w[3] = torch.tensor(row, dtype=dtype)
    wrong = dataclasses.replace(f, **{name: w})
    with pytest.raises(ValueError, match=rf"{name} of particle 3 is .*{message}"):
        make_matter(wrong, VOL, ("E", "nu"), dtype)
    with pytest.raises(ValueError, match=f"{name} of particle 3"):
        next(simulate(Scene(dx=0.1), X, VOL, wrong))


def test_weights_to_rounding_are_accepted():
    """Softmax and sparsemax in float32, also when they are used in float64."""
    from diffuphy.material.decoder import gate

    z = 4 * torch.randn(len(X), 2, generator=torch.Generator().manual_seed(0))
    for kind in ("softmax", "sparsemax"):
        w = gate(z, kind)
        f = dataclasses.replace(field(len(X), *LAWS), w_e=w, w_p=w.double())
        make_matter(f, VOL, ("E", "nu"), torch.float64)
