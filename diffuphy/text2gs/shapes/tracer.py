"""The sphere tracer and the kernels that question a table of primitives. One source for CPU and CUDA.

A ray may step by a lower bound of the distance (Hart, "Sphere tracing", The Visual Computer 1996). Here cones step
first: a tile of pixels finds which primitives its rays may meet and how far all of them may go, a pixel goes on from
there, its rays from where that ended.
"""

import warp as wp

from diffuphy.text2gs.shapes.distance import AT, FAR, HIT, LIMITS, PROBE, clearance, distance, normal, primitive
from diffuphy.text2gs.shapes.shading import SKY_STEP, openness, shade

TILE = 8
"""Pixels along a side of the square of pixels that shares one list of primitives."""
STEPS = 256
"""Steps of a ray or cone at most; a ray that needs more runs along a surface and counts as a miss."""


@wp.func
def ray(x: float, y: float, k: wp.mat33, view: wp.mat44):
    """Unit direction in the object's frame of the ray through the image point (x, y) [px]."""
    d = wp.vec3((x - k[0, 2] - k[0, 1] * (y - k[1, 2]) / k[1, 1]) / k[0, 0], (y - k[1, 2]) / k[1, 1], 1.0)
    return wp.normalize(
        wp.vec3(
            view[0, 0] * d[0] + view[1, 0] * d[1] + view[2, 0] * d[2],
            view[0, 1] * d[0] + view[1, 1] * d[1] + view[2, 1] * d[2],
            view[0, 2] * d[0] + view[1, 2] * d[1] + view[2, 2] * d[2],
        )
    )


@wp.func
def eye(view: wp.mat44, frame: wp.vec4):
    """Camera centre -Rᵀ t in the coordinates of the drawing."""
    o = wp.vec3(
        -(view[0, 0] * view[0, 3] + view[1, 0] * view[1, 3] + view[2, 0] * view[2, 3]),
        -(view[0, 1] * view[0, 3] + view[1, 1] * view[1, 3] + view[2, 1] * view[2, 3]),
        -(view[0, 2] * view[0, 3] + view[1, 2] * view[1, 3] + view[2, 2] * view[2, 3]),
    )
    return (o - wp.vec3(frame[0], frame[1], frame[2])) / frame[3]


@wp.func
def march_cone(
    origin: wp.vec3,
    axis: wp.vec3,
    spread: float,
    near: float,
    far: float,
    ids: wp.array(dtype=wp.int32),
    start: int,
    count: int,
    rows: wp.array2d(dtype=wp.vec4),
):
    """How far every ray within `spread` of the axis may go: |o + t d - p| ≤ t spread, so each may advance by r - t
    spread."""
    t = near
    r = float(0.5 * FAR)
    for _step in range(wp.static(STEPS)):
        r, _j = distance(origin + t * axis, 2.0 * r + HIT, ids, start, count, rows)
        advance = r - t * spread
        if advance < 0.2 * t * spread or t > far:
            break
        t = t + advance
    return t


@wp.func
def cone_meets(
    j: int, origin: wp.vec3, axis: wp.vec3, spread: float, near: float, far: float, rows: wp.array2d(dtype=wp.vec4)
):
    """False when the cone of rays surely passes primitive j, blend included: the march of `march_cone` against it
    alone."""
    reach = rows[j, wp.static(LIMITS)][3]
    t = near
    for _step in range(wp.static(STEPS)):
        p = origin + t * axis
        advance = wp.max(primitive(j, p, rows), clearance(j, p, rows)) - reach - t * spread
        if advance < 0.1 * t * spread:
            return True
        t = t + advance
        if t > far:
            return False
    return True


@wp.kernel(enable_backward=False, module="unique")
def cull(
    rows: wp.array2d(dtype=wp.vec4),  # (n, COLUMNS)
    frame: wp.vec4,  # object point of the drawing's origin, units of the object per unit of the drawing
    views: wp.array(dtype=wp.mat44),  # (C,)
    ks: wp.array(dtype=wp.mat33),  # (C,) [px]
    columns: int,
    ids: wp.array(dtype=wp.int32),  # (C * tiles * 2 n,) two lists a tile: what its rays may meet, what may shadow that
    spans: wp.array2d(dtype=wp.vec4),  # (C, tiles) lengths of the lists, nearest and farthest distance along the rays
):
    """List for every tile the primitives that the cone of its rays may meet, and those close enough to occlude them."""
    c, tile = wp.tid()
    n = rows.shape[0]
    origin = eye(views[c], frame)
    x = float(wp.static(TILE)) * (float(tile % columns) + 0.5)
    y = float(wp.static(TILE)) * (float(tile / columns) + 0.5)
    half = 0.5 * float(wp.static(TILE))
    axis = ray(x, y, ks[c], views[c])
    cone = float(0.0)
    for i in range(4):
        corner = ray(x + half * (2.0 * float(i % 2) - 1.0), y + half * (2.0 * float(i / 2) - 1.0), ks[c], views[c])
        cone = wp.max(cone, wp.acos(wp.clamp(wp.dot(axis, corner), -1.0, 1.0)))
    spread = 2.0 * wp.sin(0.5 * cone)
    start = (c * spans.shape[1] + tile) * 2 * n
    count = int(0)
    around = int(0)
    near = float(FAR)
    far = float(0.0)
    for j in range(n):
        o = rows[j, wp.static(AT)]
        to = wp.vec3(o[0], o[1], o[2]) - origin
        away = wp.length(to)
        angle = wp.acos(wp.clamp(wp.dot(axis, to) / wp.max(away, 1.0e-6), -1.0, 1.0))
        radius = o[3] + rows[j, wp.static(LIMITS)][3]
        wide = radius + wp.static(5.0 * SKY_STEP)
        if away <= wide or angle <= cone + wp.asin(wp.min(wide / wp.max(away, 1.0e-6), 1.0)):
            ids[start + n + around] = j
            around = around + 1
            first = wp.max(away - radius, 0.0)
            if cone_meets(j, origin, axis, spread, first, away + radius, rows):
                ids[start + count] = j
                count = count + 1
                near = wp.min(near, first)
                far = wp.max(far, away + radius)
    if count > 0:
        near = march_cone(origin, axis, spread, near, far, ids, start, count, rows)
        if near > far:
            count = 0
    spans[c, tile] = wp.vec4(float(count), float(around), near, far)


@wp.kernel(enable_backward=False, module="unique")
def trace(
    rows: wp.array2d(dtype=wp.vec4),  # (n, COLUMNS)
    frame: wp.vec4,  # object point of the drawing's origin, units of the object per unit of the drawing
    views: wp.array(dtype=wp.mat44),  # (C,)
    ks: wp.array(dtype=wp.mat33),  # (C,) [px]
    columns: int,
    ids: wp.array(dtype=wp.int32),
    spans: wp.array2d(dtype=wp.vec4),
    aa: int,
    out: wp.array3d(dtype=wp.vec4),  # (C, H, W) premultiplied colour and coverage
):
    """Mean over aa × aa rays a pixel of (shaded colour, 1) where the ray meets the object, 0 where it does not."""
    c, y, x = wp.tid()
    tile = (y / wp.static(TILE)) * columns + x / wp.static(TILE)
    span = spans[c, tile]
    count = int(span[0])
    total = wp.vec4(0.0, 0.0, 0.0, 0.0)
    if count > 0:
        start = (c * spans.shape[1] + tile) * 2 * rows.shape[0]
        around = start + rows.shape[0]
        origin = eye(views[c], frame)
        axis = ray(float(x) + 0.5, float(y) + 0.5, ks[c], views[c])
        corner = ray(float(x), float(y), ks[c], views[c])
        near = march_cone(origin, axis, 1.01 * wp.length(axis - corner), span[2], span[3], ids, start, count, rows)
        shadowed = int(-1)
        free = float(1.0)
        for s in range(aa * aa):
            px = float(x) + (float(s % aa) + 0.5) / float(aa)
            py = float(y) + (float(s / aa) + 0.5) / float(aa)
            d = ray(px, py, ks[c], views[c])
            t = near
            hit = int(-1)
            r = float(0.5 * FAR)
            for _step in range(wp.static(STEPS)):
                r, j = distance(origin + t * d, 2.0 * r + HIT, ids, start, count, rows)
                if r < wp.static(HIT):
                    hit = j
                    break
                t = t + r
                if t > span[3]:
                    break
            if hit >= 0:
                p = origin + t * d
                n = normal(p, wp.static(HIT + 4.0 * PROBE), ids, start, count, rows)
                if hit != shadowed:  # occlusion is smooth: one value a pixel and primitive
                    free = openness(p, n, ids, around, int(span[1]), rows)
                    shadowed = hit
                rgb = shade(hit, p, n, free, rows)
                total = total + wp.vec4(rgb[0], rgb[1], rgb[2], 1.0)
    out[c, y, x] = total / float(aa * aa)


@wp.kernel(enable_backward=False, module="unique")
def query(
    rows: wp.array2d(dtype=wp.vec4),  # (n, COLUMNS)
    frame: wp.vec4,
    ids: wp.array(dtype=wp.int32),  # (n,) all primitives
    points: wp.array(dtype=wp.vec3),  # (P,) object frame
    d: wp.array(dtype=wp.float32),  # (P,) distance
    owner: wp.array(dtype=wp.int32),  # (P,) primitive
):
    """Signed distance at points, and the primitive that is nearest."""
    i = wp.tid()
    r, j = distance((points[i] - wp.vec3(frame[0], frame[1], frame[2])) / frame[3], FAR, ids, 0, ids.shape[0], rows)
    d[i] = r * frame[3]
    owner[i] = j


@wp.kernel(enable_backward=False, module="unique")
def look(
    rows: wp.array2d(dtype=wp.vec4),  # (n, COLUMNS)
    frame: wp.vec4,
    ids: wp.array(dtype=wp.int32),  # (n,) all primitives
    points: wp.array(dtype=wp.vec3),  # (P,) object frame
    normals: wp.array(dtype=wp.vec3),  # (P,) unit gradient
    colours: wp.array(dtype=wp.vec3),  # (P,) shaded
):
    """Unit gradient of the distance and shaded colour at points near the surface."""
    i = wp.tid()
    p = (points[i] - wp.vec3(frame[0], frame[1], frame[2])) / frame[3]
    n = normal(p, FAR, ids, 0, ids.shape[0], rows)
    _r, j = distance(p, FAR, ids, 0, ids.shape[0], rows)
    normals[i] = n
    colours[i] = shade(j, p, n, openness(p, n, ids, 0, ids.shape[0], rows), rows)
