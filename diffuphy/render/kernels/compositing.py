"""Front-to-back compositing of 2D Gaussians and its adjoint.

    α_k = min(α_max, o_k exp(-½ dᵀ Q_k d)),   C = Σ_k f_k α_k T_k,   T_k = Π_{j<k} (1 - α_j)

with f = (r, g, b, depth); terms with α_k < α_min are left out and a pixel is finished once T < T_min (Kerbl et al.
2023, eq. 3). With the output gradients g of C and ĝ of 1 - T, the adjoint runs front to back too and carries what
lies behind, ρ_k = Σ_{j>k} ⟨f_j, g⟩ α_j T_j - ĝ T_end, which starts at ⟨C, g⟩ - ĝ T_end:

    ∂L/∂α_k = T_k ⟨f_k, g⟩ - ρ_k / (1 - α_k)

Two drivers share these formulae. ``tile``: one thread a tile, Gaussians outside, pixels inside, state of the pixels
in the image, one addition to the gradients for each pair of tile and Gaussian. ``pixel``: one thread a pixel, state
in registers, atomic additions.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp


@cache
def compositing_kernels(real: type) -> SimpleNamespace:
    """Kernels ``tile``, ``tile_adjoint``, ``pixel`` and ``pixel_adjoint`` in precision ``real``."""
    vec2 = wp.types.vector(2, real)
    vec3 = wp.types.vector(3, real)
    vec4 = wp.types.vector(4, real)

    @wp.struct
    class Splats:
        """What the compositing reads, of C views of G Gaussians in lists by tile."""

        means2d: wp.array2d(dtype=vec2)  # (C, G) [px]
        conics: wp.array2d(dtype=vec3)  # (C, G) [1/px²]
        sigmas: wp.array2d(dtype=vec2)  # (C, G) [px]
        depths: wp.array2d(dtype=real)  # (C, G)
        colors: wp.array2d(dtype=vec3)  # (C or 1, G)
        opacities: wp.array(dtype=real)  # (G)
        boxes: wp.array2d(dtype=wp.vec4i)  # (C, G) [px]
        offsets: wp.array2d(dtype=int)  # (C, tiles + 1)
        ids: wp.array(dtype=int)  # (pairs)
        width: int  # [px]
        height: int  # [px]
        tile: int  # [px]
        columns: int
        alpha_min: real
        alpha_max: real
        T_min: real

    @wp.func
    def feature(s: Splats, c: int, i: int):
        """Colour and depth of Gaussian i in view c."""
        color = s.colors[wp.min(c, s.colors.shape[0] - 1), i]
        return vec4(color[0], color[1], color[2], s.depths[c, i])

    @wp.func
    def exponent(q: vec3, dx: real, dy: real):
        return -real(0.5) * (q[0] * dx * dx + q[2] * dy * dy) - q[1] * dx * dy

    @wp.func
    def ellipse(q: vec3, sigma: vec2, o: real, alpha_min: real):
        """The region o exp(-½ dᵀ Q d) ≥ α_min in the form (dx + s dy)² ≤ r² - f dy²: (s, f, r²).

        f = det Q / A², with det Q = C / σ_x², in which nothing cancels.
        """
        inverse = real(1.0) / q[0]
        flat = q[2] * inverse * inverse / (sigma[0] * sigma[0])
        return vec3(q[1] * inverse, flat, real(2.0) * wp.log(o / alpha_min) * inverse)

    @wp.func
    def row_span(e: vec3, mx: real, dy: real, x0: real, x1: real):
        """Columns [first, last) of a row of the tile whose centres lie in the ellipse."""
        square = e[2] - e[1] * dy * dy
        half = wp.sqrt(wp.max(square, real(0.0)))
        middle = mx - e[0] * dy
        # clamped as reals, before they become integers, which could not hold a far away position; cut off towards zero
        first = x1 - real(int(x1 - wp.clamp(middle - half - real(0.5), x0, x1)))
        last = real(int(wp.clamp(middle + half + real(0.5), x0, x1)))
        return vec2(first, wp.where(square < real(0.0), first, last))

    @wp.kernel(module="unique", enable_backward=False)
    def tile(
        start: int,
        s: Splats,
        pixels: wp.array(dtype=vec4),  # (C H W), set to 0 here
        T: wp.array(dtype=real),  # (C H W), set to 1 here
    ):
        j, c = wp.tid()
        t = start + j
        x0, y0 = (t % s.columns) * s.tile, (t // s.columns) * s.tile
        x1, y1 = wp.min(x0 + s.tile, s.width), wp.min(y0 + s.tile, s.height)
        first = c * s.height * s.width
        for y in range(y0, y1):
            for p in range(first + y * s.width + x0, first + y * s.width + x1):
                pixels[p] = vec4()
                T[p] = real(1.0)
        unfinished = (x1 - x0) * (y1 - y0)
        left, right = real(x0), real(x1)
        for k in range(s.offsets[c, t], s.offsets[c, t + 1]):
            i = s.ids[k]
            m, q, o = vec2(s.means2d[c, i]), vec3(s.conics[c, i]), real(s.opacities[i])
            b, f = s.boxes[c, i], feature(s, c, i)
            region = ellipse(q, s.sigmas[c, i], o, s.alpha_min)
            curve = wp.exp(-q[0])
            for y in range(wp.max(b[1], y0), wp.min(b[3], y1)):
                dy = real(y) + real(0.5) - m[1]
                span = row_span(region, m[0], dy, left, right)
                dx = span[0] + real(0.5) - m[0]
                raw = o * wp.exp(exponent(q, dx, dy))
                ratio = wp.exp(-q[0] * (dx + real(0.5)) - q[1] * dy)
                row = first + y * s.width
                for p in range(row + int(span[0]), row + int(span[1])):
                    T_k = T[p]
                    if T_k >= s.T_min:
                        alpha = wp.min(s.alpha_max, raw)
                        pixels[p] = pixels[p] + f * (alpha * T_k)
                        T_k = T_k * (real(1.0) - alpha)
                        T[p] = T_k
                        if T_k < s.T_min:
                            unfinished -= 1
                    raw *= ratio
                    ratio *= curve
            if unfinished == 0:
                break

    @wp.kernel(module="unique", enable_backward=False)
    def tile_adjoint(
        start: int,
        s: Splats,
        pixels: wp.array(dtype=vec4),  # (C H W) result of the forward pass
        T_end: wp.array(dtype=real),  # (C H W) result of the forward pass
        g_pixels: wp.array(dtype=vec4),  # (C H W)
        g_alpha: wp.array(dtype=real),  # (C H W)
        T: wp.array(dtype=real),  # (C H W) scratch
        rho: wp.array(dtype=real),  # (C H W) scratch
        g_means2d: wp.array2d(dtype=vec2),  # (C, G), these four are added to
        g_conics: wp.array2d(dtype=vec3),
        g_features: wp.array2d(dtype=vec4),
        g_opacities: wp.array2d(dtype=real),
    ):
        j, t = wp.tid()
        c = start + j
        x0, y0 = (t % s.columns) * s.tile, (t // s.columns) * s.tile
        x1, y1 = wp.min(x0 + s.tile, s.width), wp.min(y0 + s.tile, s.height)
        first = c * s.height * s.width
        for y in range(y0, y1):
            for p in range(first + y * s.width + x0, first + y * s.width + x1):
                T[p] = real(1.0)
                rho[p] = wp.dot(pixels[p], g_pixels[p]) - g_alpha[p] * T_end[p]
        unfinished = (x1 - x0) * (y1 - y0)
        left, right = real(x0), real(x1)
        for k in range(s.offsets[c, t], s.offsets[c, t + 1]):
            i = s.ids[k]
            m, q, o = vec2(s.means2d[c, i]), vec3(s.conics[c, i]), real(s.opacities[i])
            b, f = s.boxes[c, i], feature(s, c, i)
            region = ellipse(q, s.sigmas[c, i], o, s.alpha_min)
            curve = wp.exp(-q[0])
            # moments of the gradient g with respect to the exponent: Σ g (1, dx, dx²) and Σ g dy (1, dx, dy)
            gx, gy = vec3(), vec3()
            g_f = vec4()
            for y in range(wp.max(b[1], y0), wp.min(b[3], y1)):
                dy = real(y) + real(0.5) - m[1]
                span = row_span(region, m[0], dy, left, right)
                dx = span[0] + real(0.5) - m[0]
                raw = o * wp.exp(exponent(q, dx, dy))
                ratio = wp.exp(-q[0] * (dx + real(0.5)) - q[1] * dy)
                r0, rx, rxx = real(0.0), real(0.0), real(0.0)
                row = first + y * s.width
                for p in range(row + int(span[0]), row + int(span[1])):
                    T_k = T[p]
                    if T_k >= s.T_min:
                        alpha = wp.min(s.alpha_max, raw)
                        w = alpha * T_k
                        g_pixel = g_pixels[p]
                        fg = wp.dot(f, g_pixel)
                        behind = rho[p] - w * fg
                        rho[p] = behind
                        g_f += g_pixel * w
                        if raw < s.alpha_max:
                            g = alpha * (T_k * fg - behind / (real(1.0) - alpha))
                            r0 += g
                            rx += g * dx
                            rxx += g * dx * dx
                        T_k = T_k * (real(1.0) - alpha)
                        T[p] = T_k
                        if T_k < s.T_min:
                            unfinished -= 1
                    dx += real(1.0)
                    raw *= ratio
                    ratio *= curve
                gx += vec3(r0, rx, rxx)
                gy += vec3(r0, rx, r0 * dy) * dy
            g_opacities[c, i] = g_opacities[c, i] + gx[0] / o
            g_means2d[c, i] = g_means2d[c, i] + vec2(q[0] * gx[1] + q[1] * gy[0], q[1] * gx[1] + q[2] * gy[0])
            g_conics[c, i] = g_conics[c, i] - vec3(real(0.5) * gx[2], gy[1], real(0.5) * gy[2])
            g_features[c, i] = g_features[c, i] + g_f
            if unfinished == 0:
                break

    @wp.kernel(module="unique", enable_backward=False)
    def pixel(start: int, s: Splats, pixels: wp.array(dtype=vec4), T: wp.array(dtype=real)):
        c, j, x = wp.tid()
        y = start + j
        t = (y // s.tile) * s.columns + x // s.tile
        p = (c * s.height + y) * s.width + x
        px, py = real(x) + real(0.5), real(y) + real(0.5)
        total = vec4()
        T_k = real(1.0)
        for k in range(s.offsets[c, t], s.offsets[c, t + 1]):
            i = s.ids[k]
            m = s.means2d[c, i]
            raw = s.opacities[i] * wp.exp(exponent(s.conics[c, i], px - m[0], py - m[1]))
            if raw >= s.alpha_min:
                alpha = wp.min(s.alpha_max, raw)
                total += feature(s, c, i) * (alpha * T_k)
                T_k = T_k * (real(1.0) - alpha)
                if T_k < s.T_min:
                    break
        pixels[p] = total
        T[p] = T_k

    @wp.kernel(module="unique", enable_backward=False)
    def pixel_adjoint(
        start: int,
        s: Splats,
        pixels: wp.array(dtype=vec4),
        T_end: wp.array(dtype=real),
        g_pixels: wp.array(dtype=vec4),
        g_alpha: wp.array(dtype=real),
        g_means2d: wp.array2d(dtype=vec2),
        g_conics: wp.array2d(dtype=vec3),
        g_features: wp.array2d(dtype=vec4),
        g_opacities: wp.array2d(dtype=real),
    ):
        j, y, x = wp.tid()
        c = start + j
        t = (y // s.tile) * s.columns + x // s.tile
        p = (c * s.height + y) * s.width + x
        px, py = real(x) + real(0.5), real(y) + real(0.5)
        g_pixel = g_pixels[p]
        rho = wp.dot(pixels[p], g_pixel) - g_alpha[p] * T_end[p]
        T_k = real(1.0)
        for k in range(s.offsets[c, t], s.offsets[c, t + 1]):
            i = s.ids[k]
            m, q, o = s.means2d[c, i], s.conics[c, i], s.opacities[i]
            dx, dy = px - m[0], py - m[1]
            e = wp.exp(exponent(q, dx, dy))
            raw = o * e
            if raw >= s.alpha_min:
                alpha = wp.min(s.alpha_max, raw)
                w = alpha * T_k
                fg = wp.dot(feature(s, c, i), g_pixel)
                rho -= w * fg
                wp.atomic_add(g_features, c, i, g_pixel * w)
                if raw < s.alpha_max:
                    g_a = T_k * fg - rho / (real(1.0) - alpha)
                    g = g_a * alpha
                    wp.atomic_add(g_opacities, c, i, g_a * e)
                    wp.atomic_add(g_means2d, c, i, g * vec2(q[0] * dx + q[1] * dy, q[1] * dx + q[2] * dy))
                    wp.atomic_add(g_conics, c, i, -g * vec3(real(0.5) * dx * dx, dx * dy, real(0.5) * dy * dy))
                T_k = T_k * (real(1.0) - alpha)
                if T_k < s.T_min:
                    break

    return SimpleNamespace(
        Splats=Splats, tile=tile, tile_adjoint=tile_adjoint, pixel=pixel, pixel_adjoint=pixel_adjoint
    )
