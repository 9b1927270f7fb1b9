"""Determinants: sign, value and logarithm, in any frame and to the digits of H."""

import numpy as np
import pytest
import warp as wp

from diffuphy.material import linalg, volume
from tests.material.evaluate import rotations, stretched

N = 2000
PRECISIONS = {"float32": (wp.float32, np.float32), "float64": (wp.float64, np.float64)}


def evaluate(F: np.ndarray, real: type, H: np.ndarray | None = None) -> dict[str, np.ndarray]:
    """All functions of a volume at F (N, 3, 3), with H = F − I unless given."""
    mat33, f, eye = wp.types.matrix((3, 3), real), volume.build(real), linalg.build(real).eye
    given = H is not None

    @wp.kernel(module="unique", enable_backward=False)
    def run(F: wp.array(dtype=mat33), H: wp.array(dtype=mat33), out: wp.array2d(dtype=real)):
        p = wp.tid()
        h = F[p] - eye()
        if wp.static(given):
            h = H[p]
        J, j, log_J = f.volume(F[p], h)
        out[p, 0] = J
        out[p, 1] = j
        out[p, 2] = log_J
        out[p, 3] = f.log_det(h)
        out[p, 4] = f.determinant(F[p])
        out[p, 5] = wp.where(f.valid(F[p]), real(1.0), real(0.0))

    out = wp.zeros((len(F), 6), dtype=real, device="cpu")
    inputs = [wp.array(F if a is None else a, dtype=mat33, device="cpu") for a in (F, H)]
    wp.launch(run, dim=len(F), inputs=inputs, outputs=[out], device="cpu")
    names = ("J", "J-1", "log_J", "log_det", "det", "valid")
    return dict(zip(names, out.numpy().astype(np.float64).T, strict=True))


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("condition", [1e2, 1e4, 1e6])
def test_a_state_is_valid_however_it_is_turned(condition: float, precision: str):
    """Stretches c^(½), 1, c^(−½) in random frames, rounded: valid, and its mirror image not. In float32 a sum of
    products knows the determinant to 1e-7 |F|³ = 100 only where it is 1. It is taken where it is right to 4/400; else
    rounding of F alone moves the smallest stretch by 1e-7 c of itself, 10 % at 1e6, and elimination adds a few times
    that."""
    real, dtype = PRECISIONS[precision]
    rng, root = np.random.default_rng(0), np.sqrt(condition)
    s = np.stack([rng.permutation([root, 1.0, 1 / root]) for _ in range(N)])
    F = stretched(s, rng).astype(dtype)
    exact = np.linalg.det(F.astype(np.float64))
    assert (exact > 0).all()
    out = evaluate(F, real)
    assert (out["valid"] == 1).all() and np.isfinite(out["log_J"]).all()
    tolerance = min(0.01 + 16 * np.finfo(dtype).eps * condition, 0.9)
    assert np.abs(out["det"] / exact - 1).max() < tolerance
    assert (evaluate(-F, real)["valid"] == 0).all() and np.isnan(evaluate(-F, real)["log_J"]).all()


@pytest.mark.parametrize("precision", PRECISIONS)
def test_what_is_inverted_flat_or_not_a_number_is_not_valid(precision: str):
    real, dtype = PRECISIONS[precision]
    Q = rotations(4, np.random.default_rng(4)).astype(dtype)
    flat = np.stack([np.diag([1.0, 1.0, 0.0]), np.diag([1.0, 0.0, 0.0]), np.zeros((3, 3)), np.ones((3, 3))])
    bad = np.concatenate([Q * np.array([1, 1, -1], dtype), flat.astype(dtype), Q * np.nan, Q * np.inf])
    out = evaluate(bad, real)
    assert (out["valid"] == 0).all()
    assert not np.isfinite(out["log_J"]).any()


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("strain", [1e-12, 1e-7, 1e-3, 0.1, 1.0])
def test_volume_has_the_digits_of_the_strain(strain: float, precision: str):
    """J − 1 = tr H + minors + det H and ln J = log1p of it, to 16 ulp of |H|."""
    real, dtype = PRECISIONS[precision]
    H = (strain * np.random.default_rng(1).uniform(-0.3, 0.3, (N, 3, 3))).astype(dtype)
    h = H.astype(np.float64)
    minors = (np.trace(h, axis1=1, axis2=2) ** 2 - np.einsum("pij,pji->p", h, h)) / 2
    j = np.trace(h, axis1=1, axis2=2) + minors + np.linalg.det(h)
    out = evaluate((np.eye(3) + h).astype(dtype), real, H)
    scale = 16 * np.finfo(dtype).eps * np.abs(h).sum((1, 2))
    assert (np.abs(out["J-1"] - j) < scale).all()
    assert (np.abs(out["log_J"] - np.log1p(j)) < 4 * scale).all()
    assert (np.abs(out["log_det"] - np.log1p(j)) < 4 * scale).all()
