"""Paint and light: the colour of a point of the surface. Nothing depends on the view. One source for CPU and CUDA."""

import warp as wp

from diffuphy.text2gs.shapes.distance import GLOSS, PAINT, SECOND, SIZE, THIRD, distance, to_primitive

PLAIN, SEGMENTS, NOISE, WAFFLE, FACES, STRIPES, HEIGHT, RIM, DOTS = range(9)
"""Colour patterns; see `primitives.Paint`."""

SKY_STEP = 0.11
"""Spacing of the points at which occlusion is measured [drawing units]; the farthest sees primitives within 5 of it."""


@wp.func
def value_noise(p: wp.vec3):
    """Perlin noise of three octaves in about [-1, 1]."""
    state = wp.uint32(12345)
    return wp.noise(state, p) + 0.5 * wp.noise(state, 2.1 * p) + 0.35 * wp.noise(state, 4.3 * p)


@wp.func
def mix(a: wp.vec3, b: wp.vec3, t: float):
    return a + wp.clamp(t, 0.0, 1.0) * (b - a)


@wp.func
def ramp(lo: float, hi: float, x: float):
    t = wp.clamp((x - lo) / (hi - lo), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


@wp.func
def paint(j: int, p: wp.vec3, rows: wp.array2d(dtype=wp.vec4)):
    """Colour of primitive j at the point p of the drawing, before light falls on it."""
    q = to_primitive(j, p, rows)
    a = rows[j, wp.static(SIZE)]
    w0 = rows[j, wp.static(PAINT)]
    w1 = rows[j, wp.static(SECOND)]
    w2 = rows[j, wp.static(THIRD)]
    c0 = wp.vec3(w0[0], w0[1], w0[2])
    c1 = wp.vec3(w1[0], w1[1], w1[2])
    c2 = wp.vec3(w2[0], w2[1], w2[2])
    pattern = int(w0[3])
    scale = w1[3]
    theta = wp.atan2(q[1], q[0]) / 6.283185307 + 0.5
    c = c0
    if pattern == wp.static(SEGMENTS):
        k = int(theta * scale) % 4
        if k % 2 == 1:
            c = c2
        elif k == 2:
            c = c1
        if wp.length(wp.vec2(q[0], q[1])) < 0.16 * a[0]:
            c = c2
    elif pattern == wp.static(NOISE):
        c = mix(c0, c1, 0.5 + 0.9 * value_noise(scale * q))
    elif pattern == wp.static(WAFFLE):
        u = theta * scale
        v = 0.16 * scale * q[2] / wp.max(a[0], a[1])
        line = wp.min(wp.abs(wp.frac(u + v + 64.0) - 0.5), wp.abs(wp.frac(u - v + 64.0) - 0.5))
        c = mix(c1, c0, ramp(0.05, 0.14, line))
    elif pattern == wp.static(FACES):
        x = wp.abs(q[0]) / a[0]
        y = wp.abs(q[1]) / a[1]
        z = wp.abs(q[2]) / a[2]
        top = wp.max(x, wp.max(y, z))
        edge = x + y + z - top - wp.min(x, wp.min(y, z))
        c = c2
        if edge < scale:
            c = c0
            if y >= x and y >= z:
                c = c1
            if z >= x and z >= y:
                c = 0.5 * (c0 + c1)
    elif pattern == wp.static(STRIPES):
        if wp.frac(scale * q[2] + 64.0) < 0.5:
            c = c1
    elif pattern == wp.static(HEIGHT):
        c = mix(c1, c0, ramp(-scale, scale, q[2]) + 0.15 * value_noise(3.0 * q))
    elif pattern == wp.static(RIM):
        c = mix(c0, c1, ramp(0.82, 0.97, wp.length(wp.vec2(q[0], q[1])) / a[0]) + 0.25 * value_noise(5.0 * q))
    elif pattern == wp.static(DOTS):
        cell = wp.vec3(wp.frac(scale * q[0] + 64.0), wp.frac(scale * q[1] + 64.0), wp.frac(scale * q[2] + 64.0))
        c = mix(c1, c0, ramp(0.22, 0.3, wp.length(cell - wp.vec3(0.5, 0.5, 0.5))))
    grain = w2[3]
    if grain > 0.0:
        c = c * (1.0 + grain * value_noise(26.0 * p))
    return c


@wp.func
def openness(
    p: wp.vec3, n: wp.vec3, ids: wp.array(dtype=wp.int32), start: int, count: int, rows: wp.array2d(dtype=wp.vec4)
):
    """Share of the sky that the object leaves open, from three distances along the normal (A. Evans, SIGGRAPH 2006
    course)."""
    free = float(1.0)
    weight = float(0.34)
    for i in range(3):
        step = wp.static(SKY_STEP) * (0.5 + float(i))
        d, _k = distance(p + step * n, step, ids, start, count, rows)
        free = free - weight * wp.clamp(1.0 - d / step, 0.0, 1.0)
        weight = weight * 0.7
    return free


@wp.func
def shade(j: int, p: wp.vec3, n: wp.vec3, free: float, rows: wp.array2d(dtype=wp.vec4)):
    """Paint under a fixed sky: hemisphere light through the open part of it, one wrapped key light, a painted-on
    highlight.

    Nothing depends on the view, so spherical harmonics of degree 0 can hold it.
    """
    key = wp.vec3(0.42, -0.35, 0.837)
    glow = rows[j, wp.static(GLOSS)][1]
    sky = 0.5 + 0.5 * n[2]
    lambert = wp.max(0.0, 0.25 + 0.75 * wp.dot(n, key))
    light = (0.52 + 0.20 * sky) * (free + glow * (1.0 - free)) + 0.40 * lambert
    light = light + 0.7 * glow * (1.0 - light)
    c = light * paint(j, p, rows)
    gloss = rows[j, wp.static(GLOSS)][0]
    if gloss > 0.0:
        c = mix(c, wp.vec3(1.0), gloss * ramp(0.93, 1.005, wp.dot(n, wp.normalize(key + wp.vec3(0.1, -0.25, 0.0)))))
    return wp.vec3(wp.clamp(c[0], 0.0, 1.0), wp.clamp(c[1], 0.0, 1.0), wp.clamp(c[2], 0.0, 1.0))
