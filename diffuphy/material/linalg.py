"""Principal frames of a 3 × 3 matrix, accurate to a few ulp, without an iteration of unknown length.

A deformation is given twice, as F and as H = F − I: H holds the digits of small strains that F rounds away, F those of
small stretches that H rounds away. F = U S Vᵀ is found as B = F V with orthogonal columns b_i = s_i u_i:

1. The eigenvalue of E = FᵀF − I = H + Hᵀ + HᵀH that lies farthest from the other two is a root β of β³ − 3β − 2h = 0
   in [√3, 2], where the cubic is well conditioned: a fitted polynomial and one or two Newton steps give it to machine
   precision.
2. Its eigenvector is a column of the adjugate of E − βI, which is well conditioned for the same reason.
3. V = (that vector, any orthonormal complement). Where |E| < ½ one Jacobi rotation of E splits the complement, and
   its eigenvalues λ_i give s_i = √(1 + λ_i), s_i − 1 = λ_i/(1 + s_i) and e_i = ½ ln(1 + λ_i), all to the digits of E.
   Elsewhere three one-sided Jacobi rotations of the columns of B = F V split it and remove the rounding of step 2.
   Working on B, never on FᵀF, keeps small stretches to full relative accuracy (Demmel & Veselić, SIAM J. Matrix Anal.
   Appl. 13 (1992)).
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import warp as wp

from . import near_one

# Cubic fit of 2 cos(arccos(h)/3) on [0, 1] at Chebyshev nodes, largest error 8.2e-5, so that Newton's method, whose
# error obeys ε ← 0.9 ε², needs one step to reach float32 and two to reach float64.
ROOT = (1.73213266, 0.3306607, -0.08138239, 0.01863937)

NEAR = 0.25
"""|FᵀF − I|² and |F − I|² below which the digits of these are used: no stretch is below ½ there."""


@dataclass(frozen=True)
class LinalgFunctions:
    """Warp functions of one precision."""

    principal: Any
    """(F, H) → (B, V, s, d, e): B = F V with orthogonal columns, V orthonormal columns, principal stretches s_i > 0,
    d_i = s_i − 1, e_i = ln s_i; NaN where det F ≤ 0, to rounding."""
    eye: Any
    """() → I."""
    gram: Any
    """A → AᵀA."""
    strain: Any
    """H → FᵀF − I = H + Hᵀ + HᵀH, twice the strain of Green; with Hᵀ it is FFᵀ − I."""
    polar: Any
    """F → R, the rotation nearest to F, for det F > 0."""
    cofactor: Any
    """F → cof F = det(F) F⁻ᵀ = ∂ det F/∂F."""


@cache
def build(real: Any) -> LinalgFunctions:
    """Linear algebra for ``wp.float32`` or ``wp.float64``."""
    vec3 = wp.types.vector(3, real)
    mat33 = wp.types.matrix((3, 3), real)
    nan = real(float("nan"))
    newton = 1 if real is wp.float32 else 2
    c0, c1, c2, c3 = (real(c) for c in ROOT)
    done = real(1e-9 if real is wp.float32 else 1e-18)  # |ΔR|² after which the next change is below one ulp
    slack = real((6 * (2**-23 if real is wp.float32 else 2**-52)) ** 2)  # columns count as orthogonal to 6 ulp
    flat = real(
        2**-23 if real is wp.float32 else 2**-52
    )  # a stretch below one ulp of the largest may be zero or negative
    tiny = real(1e-37 if real is wp.float32 else 1e-290)
    near = real(NEAR)
    third = real(1.0 / 3.0)
    log1p = near_one.build(real).log1p

    @wp.func(module="unique")
    def far_root(h: real) -> real:
        """Root β ∈ [√3, 2] of β³ − 3β − 2h = 0 for h ∈ [0, 1]."""
        x = c0 + h * (c1 + h * (c2 + h * c3))
        for _i in range(wp.static(newton)):
            y = x * x
            x = x - (x * (y - real(3.0)) - real(2.0) * h) / (real(3.0) * (y - real(1.0)))
        return x

    @wp.func(module="unique")
    def eye():
        return wp.diag(vec3(real(1.0), real(1.0), real(1.0)))

    @wp.func(module="unique")
    def gram(A: mat33) -> mat33:
        a = vec3(A[0, 0], A[1, 0], A[2, 0])
        b = vec3(A[0, 1], A[1, 1], A[2, 1])
        c = vec3(A[0, 2], A[1, 2], A[2, 2])
        d = wp.dot(b, c)
        e = wp.dot(a, c)
        f = wp.dot(a, b)
        return mat33(wp.dot(a, a), f, e, f, wp.dot(b, b), d, e, d, wp.dot(c, c))

    @wp.func(module="unique")
    def strain(H: mat33) -> mat33:
        return H + wp.transpose(H) + gram(H)

    @wp.func(module="unique")
    def far_vector(C: mat33) -> vec3:
        """Unit eigenvector of a symmetric matrix whose eigenvalue lies farthest from the other two."""
        # from differences, which are exact of close numbers: less a rounded mean, the diagonal of a matrix that is a
        # multiple of I to one ulp would have a trace of its own size, and the root below could be a double one
        x = C[0, 0] - C[1, 1]
        y = C[1, 1] - C[2, 2]
        z = C[2, 2] - C[0, 0]
        a = third * (x - z)
        b = third * (y - x)
        c = third * (z - y)
        d = C[1, 2]
        e = C[0, 2]
        f = C[0, 1]
        p2 = (a * a + b * b + c * c + real(2.0) * (d * d + e * e + f * f)) / real(6.0)
        p = real(1.0) / wp.sqrt(p2 + tiny)
        a = a * p
        b = b * p
        c = c * p
        d = d * p
        e = e * p
        f = f * p
        h = real(0.5) * (a * (b * c - d * d) - f * (f * c - d * e) + e * (f * d - b * e))
        beta = far_root(wp.min(wp.abs(h), real(1.0)))
        beta = wp.where(h < real(0.0), -beta, beta)
        a = a - beta
        b = b - beta
        c = c - beta
        # adjugate of (C − qI)/p − βI = (β−β')(β−β'') v vᵀ with trace ≥ 6: its largest diagonal is at least 2
        xx = b * c - d * d
        yy = a * c - e * e
        zz = a * b - f * f
        xy = e * d - f * c
        xz = f * d - b * e
        yz = e * f - a * d
        v = wp.where(yy > xx, vec3(xy, yy, yz), vec3(xx, xy, xz))
        v = wp.where(zz > wp.max(xx, yy), vec3(xz, yz, zz), v)
        return v * (real(1.0) / wp.sqrt(wp.dot(v, v)))

    @wp.func(module="unique")
    def rotation(aa: real, bb: real, ab: real):
        """Cosine, sine and tangent of the Jacobi rotation that makes two columns with these products orthogonal."""
        d = bb - aa
        ab2 = ab + ab
        t = ab2 / (wp.abs(d) + wp.sqrt(d * d + ab2 * ab2) + tiny)
        t = wp.where(d < real(0.0), -t, t)
        c = real(1.0) / wp.sqrt(real(1.0) + t * t)
        return c, t * c, t

    @wp.func(module="unique")
    def turned(a: vec3, b: vec3, c: real, s: real):
        """A pair of columns after that rotation."""
        return c * a - s * b, s * a + c * b

    @wp.func(module="unique")
    def orthogonal(a: vec3, b: vec3, ab: real) -> bool:
        return ab * ab <= slack * (wp.dot(a, a) * wp.dot(b, b))

    @wp.func(module="unique")
    def complement(v: vec3):
        """Two unit vectors that make a right-handed frame with this one (Duff et al., JCGT 6 (2017))."""
        g = wp.where(v[2] < real(0.0), real(-1.0), real(1.0))
        a = real(-1.0) / (g + v[2])
        b = v[0] * v[1] * a
        return vec3(real(1.0) + g * v[0] * v[0] * a, g * b, -g * v[0]), vec3(b, g + v[1] * v[1] * a, -v[1])

    @wp.func(module="unique")
    def decompose(F: mat33, v0: vec3, y1: vec3, y2: vec3):
        """(B, V, |b_i|²) from a first frame whose first column is nearly right."""
        b0 = F * v0
        x1 = F * y1
        x2 = F * y2
        # the close pair first, by any angle
        c, s, _t = rotation(wp.dot(x1, x1), wp.dot(x2, x2), wp.dot(x1, x2))
        b1, b2 = turned(x1, x2, c, s)
        v1, v2 = turned(y1, y2, c, s)
        # then one sweep against what rounding left; seldom needed below a condition number of 10
        ab = wp.dot(b0, b1)
        if not orthogonal(b0, b1, ab):
            c, s, _t = rotation(wp.dot(b0, b0), wp.dot(b1, b1), ab)
            b0, b1 = turned(b0, b1, c, s)
            v0, v1 = turned(v0, v1, c, s)
        ab = wp.dot(b0, b2)
        if not orthogonal(b0, b2, ab):
            c, s, _t = rotation(wp.dot(b0, b0), wp.dot(b2, b2), ab)
            b0, b2 = turned(b0, b2, c, s)
            v0, v2 = turned(v0, v2, c, s)
        ab = wp.dot(b1, b2)
        if not orthogonal(b1, b2, ab):
            c, s, _t = rotation(wp.dot(b1, b1), wp.dot(b2, b2), ab)
            b1, b2 = turned(b1, b2, c, s)
            v1, v2 = turned(v1, v2, c, s)
        return (
            wp.matrix_from_cols(b0, b1, b2),
            wp.matrix_from_cols(v0, v1, v2),
            vec3(wp.dot(b0, b0), wp.dot(b1, b1), wp.dot(b2, b2)),
        )

    @wp.func(module="unique")
    def principal(F: mat33, H: mat33):
        E = strain(H)
        v0 = far_vector(E)
        y1, y2 = complement(v0)
        B = mat33()
        V = mat33()
        s = vec3()
        d = vec3()
        e = vec3()
        if wp.ddot(E, E) < near:
            E1 = E * y1
            E2 = E * y2
            aa = wp.dot(y1, E1)
            bb = wp.dot(y2, E2)
            ab = wp.dot(y1, E2)
            c, t, tangent = rotation(aa, bb, ab)
            v1, v2 = turned(y1, y2, c, t)
            V = wp.matrix_from_cols(v0, v1, v2)
            B = F * V
            l = vec3(wp.trace(E) - aa - bb, aa - tangent * ab, bb + tangent * ab)
            one = real(1.0)
            s = vec3(wp.sqrt(one + l[0]), wp.sqrt(one + l[1]), wp.sqrt(one + l[2]))
            d = vec3(l[0] / (one + s[0]), l[1] / (one + s[1]), l[2] / (one + s[2]))
            e = real(0.5) * vec3(log1p(l[0]), log1p(l[1]), log1p(l[2]))
        else:
            B, V, s2 = decompose(F, v0, y1, y2)
            s = vec3(wp.sqrt(s2[0]), wp.sqrt(s2[1]), wp.sqrt(s2[2]))
            d = s - vec3(real(1.0), real(1.0), real(1.0))
            e = vec3(wp.log(s[0]), wp.log(s[1]), wp.log(s[2]))
        # V is a rotation, so B has the sign of F; its columns are orthogonal, so here the sign survives any condition
        least = wp.min(s[0], wp.min(s[1], s[2]))
        if not (wp.determinant(B) > real(0.0) and least > flat * wp.max(s[0], wp.max(s[1], s[2]))):
            e = vec3(nan, nan, nan)
            s = e
            d = e
        return B, V, s, d, e

    @wp.func(module="unique")
    def cofactor(F: mat33) -> mat33:
        r0 = vec3(F[0, 0], F[0, 1], F[0, 2])
        r1 = vec3(F[1, 0], F[1, 1], F[1, 2])
        r2 = vec3(F[2, 0], F[2, 1], F[2, 2])
        return wp.matrix_from_rows(wp.cross(r1, r2), wp.cross(r2, r0), wp.cross(r0, r1))

    @wp.func(module="unique")
    def polar(F: mat33) -> mat33:
        """Newton's iteration R ← (R + R⁻ᵀ)/2 (Higham 1986): quadratic, four to five steps from a strain of 20 %."""
        R = F
        change = real(1.0)
        steps = int(0)
        while change > done and steps < 40:  # 40: stretches down to 1e-9
            C = cofactor(R)
            det = R[0, 0] * C[0, 0] + R[0, 1] * C[0, 1] + R[0, 2] * C[0, 2]
            D = (real(0.5) / det) * C - real(0.5) * R
            R = R + D
            change = wp.ddot(D, D)
            steps += 1
        return R

    return LinalgFunctions(principal, eye, gram, strain, polar, cofactor)
