"""Normal and signed distance of each shape of wall, as Warp functions of a row of ``layout``."""

from functools import cache

import warp as wp

from diffuphy.mpm.boundary.layout import N_WALL


@cache
def make_surface(shape: str, real: type) -> wp.Function:
    """``surface(w, r, sdf) → (n, φ + (reach − SLACK) Δx)`` at r, from the lowest node [m].

    n is the direction in which φ grows fastest; where that is none (the middle of a ball, or of a box) it is one of
    those in which the surface is closest.
    """
    if shape == "HalfSpace":
        return _half_space(real)
    if shape == "Sphere":
        return _sphere(real)
    return {"Box": _box, "Cylinder": _cylinder, "Mesh": _mesh}[shape](real, _frame(real))


def _half_space(real: type) -> wp.Function:
    vec3, wall_t = wp.types.vector(3, real), wp.types.vector(N_WALL, real)

    @wp.func(module="unique")
    def surface(w: wall_t, r: vec3, sdf: wp.array[real]):
        n = vec3(w[0], w[1], w[2])
        return n, wp.dot(n, r) - w[3]

    return surface


def _sphere(real: type) -> wp.Function:
    vec3, wall_t = wp.types.vector(3, real), wp.types.vector(N_WALL, real)

    @wp.func(module="unique")
    def surface(w: wall_t, r: vec3, sdf: wp.array[real]):
        e = r - vec3(w[0], w[1], w[2])
        d = wp.length(e)
        n = vec3(real(0.0), real(0.0), real(1.0))
        if d > real(0.0):
            n = e / d
        return n, d - w[3]

    return surface


def _frame(real: type) -> wp.Function:
    wall_t, mat33 = wp.types.vector(N_WALL, real), wp.types.matrix((3, 3), real)

    @wp.func(module="unique")
    def frame(w: wall_t) -> mat33:
        """R, from the frame of the shape to that of the grid."""
        return mat33(w[15], w[16], w[17], w[18], w[19], w[20], w[21], w[22], w[23])

    return frame


def _box(real: type, frame: wp.Function) -> wp.Function:
    vec3, wall_t = wp.types.vector(3, real), wp.types.vector(N_WALL, real)

    @wp.func(module="unique")
    def surface(w: wall_t, r: vec3, sdf: wp.array[real]):
        R = frame(w)
        e = wp.transpose(R) * (r - vec3(w[0], w[1], w[2]))
        q, side, out = vec3(), vec3(), vec3()
        for k in range(3):
            side[k] = wp.where(e[k] < real(0.0), real(-1.0), real(1.0))
            q[k] = side[k] * e[k] - w[24 + k]
            out[k] = side[k] * wp.max(q[k], real(0.0))
        phi = wp.length(out)
        if phi > real(0.0):
            return R * (out / phi), phi - w[3]
        n = vec3(side[0], real(0.0), real(0.0))
        phi = q[0]
        if q[1] > phi:
            n = vec3(real(0.0), side[1], real(0.0))
            phi = q[1]
        if q[2] > phi:
            n = vec3(real(0.0), real(0.0), side[2])
            phi = q[2]
        return R * n, phi - w[3]

    return surface


def _cylinder(real: type, frame: wp.Function) -> wp.Function:
    vec3, wall_t = wp.types.vector(3, real), wp.types.vector(N_WALL, real)

    @wp.func(module="unique")
    def surface(w: wall_t, r: vec3, sdf: wp.array[real]):
        R = frame(w)
        e = wp.transpose(R) * (r - vec3(w[0], w[1], w[2]))
        rho = wp.sqrt(e[0] * e[0] + e[1] * e[1])
        radial = vec3(real(1.0), real(0.0), real(0.0))
        if rho > real(0.0):
            radial = vec3(e[0] / rho, e[1] / rho, real(0.0))
        axial = vec3(real(0.0), real(0.0), wp.where(e[2] < real(0.0), real(-1.0), real(1.0)))
        q_r, q_h = rho - w[24], wp.abs(e[2]) - w[25]
        out = wp.max(q_r, real(0.0)) * radial + wp.max(q_h, real(0.0)) * axial
        phi = wp.length(out)
        if phi > real(0.0):
            return R * (out / phi), phi - w[3]
        if q_h > q_r:
            return R * axial, q_h - w[3]
        return R * radial, q_r - w[3]

    return surface


def _mesh(real: type, frame: wp.Function) -> wp.Function:
    vec3, wall_t = wp.types.vector(3, real), wp.types.vector(N_WALL, real)

    @wp.func(module="unique")
    def surface(w: wall_t, r: vec3, sdf: wp.array[real]):
        R = frame(w)
        n = vec3(real(0.0), real(0.0), real(1.0))
        g = (wp.transpose(R) * (r - vec3(w[0], w[1], w[2])) - vec3(w[24], w[25], w[26])) * w[27]
        nx, ny, nz = wp.int32(w[29]), wp.int32(w[30]), wp.int32(w[31])
        low = g[0] >= real(0.0) and g[1] >= real(0.0) and g[2] >= real(0.0)
        if not (low and g[0] <= real(nx - 1) and g[1] <= real(ny - 1) and g[2] <= real(nz - 1)):
            return n, real(1.0)  # beyond the samples is outside
        i, j, k = wp.min(wp.int32(g[0]), nx - 2), wp.min(wp.int32(g[1]), ny - 2), wp.min(wp.int32(g[2]), nz - 2)
        x, y, z = g[0] - real(i), g[1] - real(j), g[2] - real(k)
        o = wp.int32(w[28]) + (i * ny + j) * nz + k
        c00, d00 = sdf[o], sdf[o + 1] - sdf[o]
        c01, d01 = sdf[o + nz], sdf[o + nz + 1] - sdf[o + nz]
        o += ny * nz
        c10, d10 = sdf[o], sdf[o + 1] - sdf[o]
        c11, d11 = sdf[o + nz], sdf[o + nz + 1] - sdf[o + nz]
        p00, p01, p10, p11 = c00 + z * d00, c01 + z * d01, c10 + z * d10, c11 + z * d11
        a0, a1 = p00 + y * (p01 - p00), p10 + y * (p11 - p10)
        dz0, dz1 = d00 + y * (d01 - d00), d10 + y * (d11 - d10)
        dy = (p01 - p00) + x * ((p11 - p10) - (p01 - p00))
        slope = vec3(a1 - a0, dy, dz0 + x * (dz1 - dz0))
        length = wp.length(slope)
        if length > real(0.0):
            n = slope / length
        return R * n, a0 + x * (a1 - a0) - w[3]

    return surface
