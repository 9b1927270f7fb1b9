"""Perspective projection of 3D Gaussians to 2D Gaussians and its adjoint.

    M = F R(q) diag(s),  Σ = M Mᵀ,  Σ₂ = J W Σ Wᵀ Jᵀ + ε I

Zwicker et al., EWA splatting (2002), eq. 29-31; Kerbl et al., 3D Gaussian splatting (2023), eq. 5. With the rows a,
b of J W and α = Mᵀa, β = Mᵀb, the 2D covariance is [[|α|² + ε, α·β], [α·β, |β|² + ε]] and, by Lagrange's identity,
det Σ₂ = |α × β|² + ε (|α|² + |β|²) + ε²: a sum of positive terms, exact even for needles.

One thread a Gaussian, which visits all views: its gradients gather in registers, without atomics and in a fixed order.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

MARGIN = 0.15
"""The slope of the ray at which J is evaluated is clamped to the image enlarged by this fraction of its size on each
side, as in gsplat (``_torch_impl.py: _persp_proj``): beyond it the first-order expansion of the perspective is
worthless."""


@cache
def projection_kernels(real: type, deformed: bool) -> SimpleNamespace:
    """Kernels ``project``, ``project_adjoint`` and ``bound`` in precision ``real``; without F in their code if not
    ``deformed``."""
    vec2 = wp.types.vector(2, real)
    vec3 = wp.types.vector(3, real)
    vec4 = wp.types.vector(4, real)
    mat33 = wp.types.matrix((3, 3), real)
    mat44 = wp.types.matrix((4, 4), real)
    margin = MARGIN

    @wp.func
    def rotation(u: vec4):
        """Matrix of the unit quaternion ``u`` (wxyz)."""
        w, x, y, z = u[0], u[1], u[2], u[3]
        one, two = real(1.0), real(2.0)
        # fmt: off
        return mat33(one - two * (y * y + z * z), two * (x * y - w * z), two * (x * z + w * y),
                     two * (x * y + w * z), one - two * (x * x + z * z), two * (y * z - w * x),
                     two * (x * z - w * y), two * (y * z + w * x), one - two * (x * x + y * y))
        # fmt: on

    @wp.func
    def rotation_adjoint(u: vec4, g: mat33):
        """∂⟨g, R(u)⟩/∂u, as if the four components were independent."""
        w, x, y, z = u[0], u[1], u[2], u[3]
        two = real(2.0)
        a, b, c = g[2, 1] - g[1, 2], g[0, 2] - g[2, 0], g[1, 0] - g[0, 1]
        d, e, f = g[0, 1] + g[1, 0], g[2, 0] + g[0, 2], g[1, 2] + g[2, 1]
        return two * vec4(
            x * a + y * b + z * c,
            w * a + y * d + z * e - two * x * (g[1, 1] + g[2, 2]),
            w * b + x * d + z * f - two * y * (g[0, 0] + g[2, 2]),
            w * c + x * e + y * f - two * z * (g[0, 0] + g[1, 1]),
        )

    @wp.func
    def scale_columns(m: mat33, s: vec3):
        # fmt: off
        return mat33(m[0, 0] * s[0], m[0, 1] * s[1], m[0, 2] * s[2],
                     m[1, 0] * s[0], m[1, 1] * s[1], m[1, 2] * s[2],
                     m[2, 0] * s[0], m[2, 1] * s[1], m[2, 2] * s[2])
        # fmt: on

    @wp.func
    def linear_part(v: mat44):
        return mat33(v[0, 0], v[0, 1], v[0, 2], v[1, 0], v[1, 1], v[1, 2], v[2, 0], v[2, 1], v[2, 2])

    @wp.func
    def clamped_slopes(p: vec3, k: mat33, width: real, height: real):
        """Slopes (x/z, y/z) of the ray to ``p``, clamped to the enlarged image."""
        fx, fy, cx, cy = k[0, 0], k[1, 1], k[0, 2], k[1, 2]
        mx, my = real(margin) * width, real(margin) * height
        u = wp.clamp(p[0] / p[2], -(cx + mx) / fx, (width - cx + mx) / fx)
        v = wp.clamp(p[1] / p[2], -(cy + my) / fy, (height - cy + my) / fy)
        return vec2(u, v)

    @wp.kernel(module="unique", enable_backward=False)
    def project(
        start: int,
        means: wp.array(dtype=vec3),  # (G)
        quats: wp.array(dtype=vec4),  # (G)
        scales: wp.array(dtype=vec3),  # (G)
        F: wp.array(dtype=mat33),  # (G), (0) if not deformed
        viewmats: wp.array(dtype=mat44),  # (C)
        Ks: wp.array(dtype=mat33),  # (C) [px]
        width: real,
        height: real,
        dilation: real,  # ε [px²]
        near: real,
        means2d: wp.array2d(dtype=vec2),  # (C, G) [px]
        conics: wp.array2d(dtype=vec3),  # (C, G) upper triangle of Σ₂⁻¹ [1/px²]
        depths: wp.array2d(dtype=real),  # (C, G)
        sigmas: wp.array2d(dtype=vec2),  # (C, G) √ of the diagonal of Σ₂ [px], 0 behind the near plane
    ):
        i = start + wp.tid()
        M = scale_columns(rotation(wp.normalize(quats[i])), scales[i])
        if wp.static(deformed):
            M = F[i] * M
        for c in range(viewmats.shape[0]):
            V = viewmats[c]
            k = Ks[c]
            W = linear_part(V)
            p = W * means[i] + vec3(V[0, 3], V[1, 3], V[2, 3])
            z = p[2]
            xy, conic, sigma = vec2(), vec3(), vec2()
            if z > near:
                fx, fy = k[0, 0], k[1, 1]
                u = clamped_slopes(p, k, width, height)
                N = W * M
                alpha = wp.transpose(N) * vec3(fx / z, real(0.0), -fx * u[0] / z)
                beta = wp.transpose(N) * vec3(real(0.0), fy / z, -fy * u[1] / z)
                A, B, C = wp.dot(alpha, alpha), wp.dot(alpha, beta), wp.dot(beta, beta)
                det = wp.length_sq(wp.cross(alpha, beta)) + dilation * (A + C) + dilation * dilation
                conic = vec3(C + dilation, -B, A + dilation) / det
                sigma = vec2(wp.sqrt(A + dilation), wp.sqrt(C + dilation))
                xy = vec2(fx * p[0] / z + k[0, 2], fy * p[1] / z + k[1, 2])
            means2d[c, i] = xy
            conics[c, i] = conic
            depths[c, i] = z
            sigmas[c, i] = sigma

    @wp.func
    def project_point_adjoint(p: vec3, k: mat33, u: vec2, g_xy: vec2, g_depth: real, g_a: vec3, g_b: vec3):
        """Gradient in camera coordinates from the pixel position, the depth, and the two rows of J at slopes ``u``."""
        fx, fy, z = k[0, 0], k[1, 1], p[2]
        g = vec3(g_xy[0] * fx / z, g_xy[1] * fy / z, g_depth - (g_xy[0] * fx * p[0] + g_xy[1] * fy * p[1]) / (z * z))
        g[2] += (-g_a[0] * fx + g_a[2] * fx * u[0] - g_b[1] * fy + g_b[2] * fy * u[1]) / (z * z)
        g_u, g_v = -g_a[2] * fx / z, -g_b[2] * fy / z
        if u[0] == p[0] / z:  # not clamped
            g[0] += g_u / z
            g[2] -= g_u * u[0] / z
        if u[1] == p[1] / z:
            g[1] += g_v / z
            g[2] -= g_v * u[1] / z
        return g

    @wp.kernel(module="unique", enable_backward=False)
    def project_adjoint(
        start: int,
        means: wp.array(dtype=vec3),
        quats: wp.array(dtype=vec4),
        scales: wp.array(dtype=vec3),
        F: wp.array(dtype=mat33),
        viewmats: wp.array(dtype=mat44),
        Ks: wp.array(dtype=mat33),
        width: real,
        height: real,
        near: real,
        conics: wp.array2d(dtype=vec3),
        g_means2d: wp.array2d(dtype=vec2),
        g_conics: wp.array2d(dtype=vec3),
        g_depths: wp.array2d(dtype=real),
        g_means: wp.array(dtype=vec3),
        g_quats: wp.array(dtype=vec4),
        g_scales: wp.array(dtype=vec3),
        g_F: wp.array(dtype=mat33),
    ):
        i = start + wp.tid()
        s = scales[i]
        unit = wp.normalize(quats[i])
        R = rotation(unit)
        P = R
        if wp.static(deformed):
            P = F[i] * R
        M = scale_columns(P, s)
        g_M = mat33()
        g_mean = vec3()
        for c in range(viewmats.shape[0]):
            V = viewmats[c]
            W = linear_part(V)
            p = W * means[i] + vec3(V[0, 3], V[1, 3], V[2, 3])
            if p[2] > near:
                k = Ks[c]
                u = clamped_slopes(p, k, width, height)
                a = vec3(k[0, 0] / p[2], real(0.0), -k[0, 0] * u[0] / p[2])
                b = vec3(real(0.0), k[1, 1] / p[2], -k[1, 1] * u[1] / p[2])
                N = W * M
                alpha, beta = wp.transpose(N) * a, wp.transpose(N) * b
                # dQ = -Q dΣ₂ Q with Q = [[q0, q1], [q1, q2]] and g the symmetric gradient [[g0, g1/2], [g1/2, g2]]
                q, g = conics[c, i], g_conics[c, i]
                h = real(0.5) * g[1]
                m0, m1 = q[0] * g[0] + q[1] * h, q[0] * h + q[1] * g[2]
                n0, n1 = q[1] * g[0] + q[2] * h, q[1] * h + q[2] * g[2]
                g_A, g_B2, g_C = -(m0 * q[0] + m1 * q[1]), -(m0 * q[1] + m1 * q[2]), -(n0 * q[1] + n1 * q[2])
                g_alpha = real(2.0) * (g_A * alpha + g_B2 * beta)
                g_beta = real(2.0) * (g_C * beta + g_B2 * alpha)
                g_N = wp.outer(a, g_alpha) + wp.outer(b, g_beta)
                g_M += wp.transpose(W) * g_N
                g_p = project_point_adjoint(p, k, u, g_means2d[c, i], g_depths[c, i], N * g_alpha, N * g_beta)
                g_mean += wp.transpose(W) * g_p
        g_P = scale_columns(g_M, s)
        g_R = g_P
        if wp.static(deformed):
            g_R = wp.transpose(F[i]) * g_P
            g_F[i] = g_P * wp.transpose(R)
        g_unit = rotation_adjoint(unit, g_R)
        g_means[i] = g_mean
        g_quats[i] = (g_unit - unit * wp.dot(unit, g_unit)) / wp.length(quats[i])
        g_scales[i] = vec3(
            g_M[0, 0] * P[0, 0] + g_M[1, 0] * P[1, 0] + g_M[2, 0] * P[2, 0],
            g_M[0, 1] * P[0, 1] + g_M[1, 1] * P[1, 1] + g_M[2, 1] * P[2, 1],
            g_M[0, 2] * P[0, 2] + g_M[1, 2] * P[1, 2] + g_M[2, 2] * P[2, 2],
        )

    @wp.kernel(module="unique", enable_backward=False)
    def bound(
        start: int,
        means2d: wp.array2d(dtype=vec2),
        sigmas: wp.array2d(dtype=vec2),
        opacities: wp.array(dtype=real),
        width: int,
        height: int,
        alpha_min: real,
        boxes: wp.array2d(dtype=wp.vec4i),  # (C, G) first column and row, last column and row + 1; zeros if unseen
    ):
        """Smallest box of pixels outside which o exp(-½ dᵀ Σ₂⁻¹ d) < α_min: half widths σ √(2 ln(o / α_min))."""
        i = start + wp.tid()
        o = opacities[i]
        half = real(0.5)
        w, h = real(width), real(height)
        for c in range(means2d.shape[0]):
            box = wp.vec4i(0, 0, 0, 0)
            sigma = sigmas[c, i]
            if o >= alpha_min and sigma[0] > real(0.0):
                m = means2d[c, i]
                r = sigma * wp.sqrt(real(2.0) * wp.log(o / alpha_min))
                # compared as reals before they become integers, which could not hold a far away position
                x0 = int(wp.clamp(wp.ceil(m[0] - r[0] - half), real(0.0), w))
                y0 = int(wp.clamp(wp.ceil(m[1] - r[1] - half), real(0.0), h))
                x1 = int(wp.clamp(wp.floor(m[0] + r[0] + half), real(0.0), w))
                y1 = int(wp.clamp(wp.floor(m[1] + r[1] + half), real(0.0), h))
                if x1 > x0 and y1 > y0:
                    box = wp.vec4i(x0, y0, x1, y1)
            boxes[c, i] = box

    return SimpleNamespace(project=project, project_adjoint=project_adjoint, bound=bound)
