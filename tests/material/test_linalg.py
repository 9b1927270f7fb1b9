"""The decomposition F = B Vᵀ against its definition, in both precisions."""

import numpy as np
import pytest
import warp as wp

from diffuphy.material import linalg
from tests.material.evaluate import rotations, stretched

N = 2000
PRECISIONS = {"float32": (wp.float32, np.float32), "float64": (wp.float64, np.float64)}


def stretches(kind: str, rng: np.random.Generator) -> np.ndarray:
    one = np.ones(N)
    return {
        "rest": np.column_stack([one, one, one]),
        "equal": np.column_stack([1.2 * one, 1.2 * one, rng.uniform(0.5, 2.0, N)]),
        "nearly equal": np.column_stack([one, 1 + 10 ** rng.uniform(-9, -2, N), rng.uniform(0.5, 2.0, N)]),
        "moderate": np.exp(rng.normal(size=(N, 3)) * 0.3),
        "condition 1e4": 10 ** rng.uniform(-2, 2, (N, 3)),
        "rod": np.column_stack([one, 2e-4 * one, 1e-4 * one]),
        "sheet": np.column_stack([one, one, 1e-4 * one]),
    }[kind]


KINDS = ("rest", "equal", "nearly equal", "moderate", "condition 1e4", "rod", "sheet")


def decompose(F: np.ndarray, real: type) -> tuple[np.ndarray, ...]:
    vec3, mat33, f = wp.types.vector(3, real), wp.types.matrix((3, 3), real), linalg.build(real)

    @wp.kernel(module="unique", enable_backward=False)
    def run(
        F: wp.array(dtype=mat33),
        B: wp.array(dtype=mat33),
        V: wp.array(dtype=mat33),
        s: wp.array(dtype=vec3),
        e: wp.array(dtype=vec3),
    ):
        p = wp.tid()
        B_p, V_p, s_p, _d, e_p = f.principal(F[p], F[p] - f.eye())
        B[p] = B_p
        V[p] = V_p
        s[p] = s_p
        e[p] = e_p

    out = [wp.zeros(len(F), dtype=t, device="cpu") for t in (mat33, mat33, vec3, vec3)]
    wp.launch(run, dim=len(F), inputs=[wp.array(F, dtype=mat33, device="cpu")], outputs=out, device="cpu")
    return tuple(o.numpy().astype(np.float64) for o in out)


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("kind", KINDS)
def test_frames_are_orthogonal_to_a_few_ulp(kind: str, precision: str):
    """VᵀV = I and UᵀU = I with U = B diag(1/s), whatever the condition number.

    16 ulp: each column passes through three rotations and a normalisation, every one a handful of rounded operations.
    """
    real, dtype = PRECISIONS[precision]
    F = stretched(stretches(kind, np.random.default_rng(0)), np.random.default_rng(1)).astype(dtype)
    B, V, s, _ = decompose(F, real)
    U = B / s[:, None, :]
    tol = 16 * np.finfo(dtype).eps
    assert np.abs(V.swapaxes(1, 2) @ V - np.eye(3)).max() < tol
    assert np.abs(U.swapaxes(1, 2) @ U - np.eye(3)).max() < tol


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("kind", KINDS)
def test_decomposition_rebuilds_the_matrix(kind: str, precision: str):
    """B Vᵀ = F to 16 ulp of the largest stretch (backward stability), and s agrees with LAPACK to the same."""
    real, dtype = PRECISIONS[precision]
    F = stretched(stretches(kind, np.random.default_rng(2)), np.random.default_rng(3)).astype(dtype)
    B, V, s, e = decompose(F, real)
    exact = np.linalg.svd(F.astype(np.float64), compute_uv=False)
    tol = 16 * np.finfo(dtype).eps * exact[:, :1]
    assert (np.abs(B @ V.swapaxes(1, 2) - F).max((1, 2)) < tol[:, 0]).all()
    assert (np.abs(np.sort(s, -1)[:, ::-1] - exact) < tol).all()
    assert np.abs(e - np.log(s)).max() < 16 * np.finfo(dtype).eps * max(1.0, np.abs(e).max())


@pytest.mark.parametrize("precision", PRECISIONS)
def test_strains_are_right_at_a_condition_of_a_million(precision: str):
    """diag(1e3, 1, 1e-3) in any order: e_i to a few ulp. Turned, the matrix itself says its smallest stretch only to
    cond ulp: e_i to 16 of these, and its sign is not lost."""
    real, dtype = PRECISIONS[precision]
    rng, ulp = np.random.default_rng(7), np.finfo(dtype).eps
    s = np.stack([rng.permutation([1e3, 1.0, 1e-3]) for _ in range(N)])
    F = (s[:, :, None] * np.eye(3)).astype(dtype)
    *_, e = decompose(F, real)
    assert np.abs(np.sort(e) - np.log([1e-3, 1.0, 1e3])).max() < 4 * ulp * np.log(1e3)
    F = stretched(s, rng).astype(dtype)
    exact = np.sort(np.log(np.linalg.svd(F.astype(np.float64), compute_uv=False)))
    positive = np.linalg.det(F.astype(np.float64)) > 0
    *_, e = decompose(F[positive], real)
    assert (np.abs(np.sort(e) - exact[positive]) < 16 * ulp * 1e3 / np.exp(exact[positive])).all()


@pytest.mark.parametrize("precision", PRECISIONS)
def test_exact_states_stay_exact(precision: str):
    """At F = I the stretches are 1 and the strains 0, to the last bit."""
    real, dtype = PRECISIONS[precision]
    _, _, s, e = decompose(np.tile(np.eye(3, dtype=dtype), (3, 1, 1)), real)
    assert (s == 1.0).all() and (e == 0.0).all()


@pytest.mark.parametrize("precision", PRECISIONS)
def test_stretches_that_differ_by_rounding_have_frames(precision: str):
    """FᵀF − I = ε I + n ulp, with every combination of n ∈ {−1, 0, 1} in its six entries: B = F V with orthonormal V.

    Every one is within one ulp of a multiple of I, so any V does; 4 ulp for its normalisation, and none is NaN.
    """
    real, dtype = PRECISIONS[precision]
    ulps = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 6, indexing="ij"), -1).reshape(-1, 6)
    for stretch in (0.7, 0.97, 1.03, 1.0268, 1.3):  # FᵀF − I on either side of NEAR
        ulp = np.spacing(dtype(stretch), dtype=dtype)
        F = stretch * np.eye(3) + ulp * ulps[:, [[0, 3, 4], [3, 1, 5], [4, 5, 2]]]
        _, V, s, _ = decompose(F.astype(dtype), real)
        assert np.abs(V.swapaxes(1, 2) @ V - np.eye(3)).max() < 4 * np.finfo(dtype).eps
        assert np.abs(s - stretch).max() < 8 * ulp  # |F| is off by up to 3 ulp


@pytest.mark.parametrize("precision", PRECISIONS)
def test_inverted_states_are_not_hidden(precision: str):
    """det F ≤ 0 gives NaN, not the mirrored state; so does NaN."""
    real, dtype = PRECISIONS[precision]
    Q = rotations(4, np.random.default_rng(4)).astype(dtype)
    bad = np.concatenate([Q * np.array([1, 1, -1], dtype), Q * np.array([1, 1, 0], dtype), Q * np.nan])
    bad[4:8, :, 2] = 0.0
    _, _, s, e = decompose(bad, real)
    assert np.isnan(s).all() and np.isnan(e).all()


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("kind", ("rest", "equal", "nearly equal", "moderate"))
def test_polar_factor_is_the_rotation_of_the_decomposition(kind: str, precision: str):
    """R = U Vᵀ and RᵀR = I, to 16 ulp times the condition of the polar factor, 1/(s_2 + s_3) ≤ 2 here."""
    real, dtype = PRECISIONS[precision]
    F = stretched(stretches(kind, np.random.default_rng(5)), np.random.default_rng(6)).astype(dtype)
    mat33, f = wp.types.matrix((3, 3), real), linalg.build(real)

    @wp.kernel(module="unique", enable_backward=False)
    def run(F: wp.array(dtype=mat33), R: wp.array(dtype=mat33)):
        p = wp.tid()
        R[p] = f.polar(F[p])

    out = wp.zeros(N, dtype=mat33, device="cpu")
    wp.launch(run, dim=N, inputs=[wp.array(F, dtype=mat33, device="cpu")], outputs=[out], device="cpu")
    R = out.numpy().astype(np.float64)
    U, _, Vh = np.linalg.svd(F.astype(np.float64))
    assert np.abs(R - U @ Vh).max() < 32 * np.finfo(dtype).eps
    assert np.abs(R.swapaxes(1, 2) @ R - np.eye(3)).max() < 32 * np.finfo(dtype).eps
