"""The sphere tracer: signed distance of a table of primitives, its shading, rays against it. One source for CPU and CUDA.

A scene is a table with one row a primitive; a contiguous run of rows with the same group number is one solid, made by smooth
unions and cuts in the order of the rows; the object is the plain union of its groups. All distances are lower bounds of the
Euclidean one, so a ray may step by them (Hart, "Sphere tracing", The Visual Computer 1996); the closed forms of the primitives
are those collected by I. Quilez, "Distance functions" (iquilezles.org).
"""

import warp as wp

wp.config.quiet = True

ELLIPSOID, DOME, FRUSTUM, BOX, TORUS, CONE, STAR = range(7)
"""Kinds of primitives; what `a` means for each is said in `primitives.Sketch`."""

UNION, CUT = 0, 1
"""How a primitive joins its group."""

PLAIN, SEGMENTS, NOISE, WAFFLE, FACES, STRIPES, HEIGHT, RIM, DOTS = range(9)
"""Colour patterns; see `primitives.Paint`."""

TILE = 8
"""Pixels along a side of the square of pixels that shares one list of primitives."""

FAR = 1.0e6
HIT = 1.0e-3
"""Distance at which a ray is on the surface [object units]; a fifteenth of a pixel at 128 px."""
STEPS = 96
PROBE = 1.5e-3
"""Half the side of the tetrahedron on which the gradient is measured [drawing units]."""
SKY_STEP = 0.11
"""Spacing of the points at which occlusion is measured [drawing units]; the farthest sees primitives within 5 of it."""


KIND, AT, SLAB, TURN, SIZE, BEND, LIMITS, PAINT, SECOND, THIRD, GLOSS, COLUMNS = range(12)
"""Columns of the table, each a vec4:
KIND    kind, group, UNION or CUT, blend radius k of the join
AT      centre, bounding radius with the reach
SLAB    local z axis, half height with the reach
TURN    quaternion xyzw from the primitive's frame to the drawing's
SIZE    sizes
BEND    ruffle, ribs, count, droop
LIMITS  of the bend: 1 / Lipschitz constant, swelling, distance from which the swollen one is used
PAINT   colour, pattern
SECOND  second colour, scale
THIRD   third colour, grain
GLOSS   highlight, glow, reach: how far the blends of its group may move the surface
"""


@wp.func
def ellipsoid(p: wp.vec3, r: wp.vec3):
    """Outside k0 (k0 - 1) / k1 with k0 = |p/r|, k1 = |p/r²|, first order exact at the surface; inside (k0 - 1) min r.

    A lower bound, but steeper than 1 far from thin ellipsoids.
    """
    k0 = wp.length(wp.cw_div(p, r))
    if k0 < 1.0:
        return (k0 - 1.0) * wp.min(r)
    return k0 * (k0 - 1.0) / wp.length(wp.cw_div(wp.cw_div(p, r), r))


@wp.func
def smooth_min(a: float, b: float, k: float):
    """Polynomial smooth minimum: min(a, b) - h² k / 4 with h = max(1 - |a - b| / k, 0); 1-Lipschitz when a and b are."""
    h = wp.max(k - wp.abs(a - b), 0.0) / wp.max(k, 1.0e-6)
    return wp.min(a, b) - 0.25 * h * h * k


@wp.func
def frustum(p: wp.vec3, r1: float, r2: float, h: float, radius: float):
    """Cone frustum from radius r1 at z = -h to r2 at z = h, edges rounded with `radius`; exact outside and inside."""
    ra = r1 - radius
    rb = r2 - radius
    hh = h - radius
    q = wp.vec2(wp.sqrt(p[0] * p[0] + p[1] * p[1]), p[2])
    k = wp.vec2(rb - ra, 2.0 * hh)
    cap = rb
    if q[1] < 0.0:
        cap = ra
    ca = wp.vec2(q[0] - wp.min(q[0], cap), wp.abs(q[1]) - hh)
    side = wp.vec2(rb, hh) - q
    cb = q - wp.vec2(rb, hh) + k * wp.clamp(wp.dot(side, k) / wp.dot(k, k), 0.0, 1.0)
    s = float(1.0)
    if cb[0] < 0.0 and ca[1] < 0.0:
        s = -1.0
    return s * wp.sqrt(wp.min(wp.dot(ca, ca), wp.dot(cb, cb))) - radius


@wp.func
def box(p: wp.vec3, half: wp.vec3, radius: float):
    qx = wp.abs(p[0]) - half[0] + radius
    qy = wp.abs(p[1]) - half[1] + radius
    qz = wp.abs(p[2]) - half[2] + radius
    outside = wp.length(wp.vec3(wp.max(qx, 0.0), wp.max(qy, 0.0), wp.max(qz, 0.0)))
    return outside + wp.min(wp.max(qx, wp.max(qy, qz)), 0.0) - radius


@wp.func
def round_cone(p: wp.vec3, h: float, r1: float, r2: float):
    """Hull of a ball r1 at the origin and a ball r2 at (0, 0, h); exact. Needs h > |r1 - r2|."""
    x = wp.sqrt(p[0] * p[0] + p[1] * p[1])
    b = (r1 - r2) / h
    a = wp.sqrt(1.0 - b * b)
    k = a * p[2] - b * x
    if k < 0.0:
        return wp.length(p) - r1
    if k > a * h:
        return wp.sqrt(x * x + (p[2] - h) * (p[2] - h)) - r2
    return a * x + b * p[2] - r1


@wp.func
def star(p: wp.vec3, r: float, inner: float, half: float, radius: float):
    """Prism over a five-pointed star (tips at radius r, notches at inner r), thickness 2 half along z, rounded."""
    c1 = wp.vec2(0.809016994, -0.587785252)
    c2 = wp.vec2(-0.809016994, -0.587785252)
    q = wp.vec2(wp.abs(p[0]), p[1])
    q = q - 2.0 * wp.max(wp.dot(c1, q), 0.0) * c1
    q = q - 2.0 * wp.max(wp.dot(c2, q), 0.0) * c2
    q = wp.vec2(wp.abs(q[0]), q[1] - (r - radius))
    edge = inner * wp.vec2(0.587785252, 0.809016994) - wp.vec2(0.0, 1.0)
    t = wp.clamp(wp.dot(q, edge) / wp.dot(edge, edge), 0.0, r - radius)
    d2 = wp.length(q - edge * t) * wp.sign(q[1] * edge[0] - q[0] * edge[1])
    dz = wp.abs(p[2]) - (half - radius)
    outside = wp.length(wp.vec2(wp.max(d2, 0.0), wp.max(dz, 0.0)))
    return wp.min(wp.max(d2, dz), 0.0) + outside - radius


@wp.func
def bent(p: wp.vec3, b: wp.vec4, reach: float):
    """Undo the bend of a primitive: droop and ruffle shift z, ribs scale the distance to the z axis by scallops."""
    r = wp.sqrt(p[0] * p[0] + p[1] * p[1])
    theta = wp.atan2(p[1], p[0])
    s = wp.min(r / reach, 1.2)
    z = p[2] + s * s * (b[3] + b[0] * wp.sin(b[2] * theta))
    g = 1.0 / (1.0 + b[1] * (2.0 * wp.abs(wp.cos(0.5 * b[2] * theta)) - 1.0))
    return wp.vec3(p[0] * g, p[1] * g, z)


@wp.func
def to_primitive(j: int, p: wp.vec3, rows: wp.array2d(dtype=wp.vec4)):
    o = rows[j, wp.static(AT)]
    t = rows[j, wp.static(TURN)]
    return wp.quat_rotate_inv(wp.quat(t[0], t[1], t[2], t[3]), p - wp.vec3(o[0], o[1], o[2]))


@wp.func
def solid(kind: int, q: wp.vec3, a: wp.vec4):
    """Distance of the point q of its own frame to a primitive that is not bent."""
    d = float(FAR)
    if kind == wp.static(ELLIPSOID):
        d = ellipsoid(q, wp.vec3(a[0], a[1], a[2]))
    elif kind == wp.static(DOME):
        d = -smooth_min(-ellipsoid(q, wp.vec3(a[0], a[1], a[2])), q[2], a[3])
    elif kind == wp.static(FRUSTUM):
        d = frustum(q, a[0], a[1], a[2], a[3])
    elif kind == wp.static(BOX):
        d = box(q, wp.vec3(a[0], a[1], a[2]), a[3])
    elif kind == wp.static(TORUS):
        d = wp.length(wp.vec2(wp.sqrt(q[0] * q[0] + q[1] * q[1]) - a[0], q[2])) - a[1]
    elif kind == wp.static(CONE):
        d = round_cone(q, a[0], a[1], a[2])
    else:
        d = star(q, a[0], a[1], a[2], a[3])
    return d


@wp.func
def primitive(j: int, p: wp.vec3, rows: wp.array2d(dtype=wp.vec4)):
    """Distance of the point p of the drawing to primitive j.

    Of a bent one the larger of two lower bounds: that of the straight one swollen by the bend, which alone counts far away, and
    that in the coordinates in which it is straight, divided by the Lipschitz constant of the map to them.
    """
    q = to_primitive(j, p, rows)
    a = rows[j, wp.static(SIZE)]
    kind = int(rows[j, wp.static(KIND)][0])
    d = solid(kind, q, a)
    limits = rows[j, wp.static(LIMITS)]
    if limits[0] < 1.0:
        d = d - limits[1]
        if d < limits[2]:
            d = wp.max(d, limits[0] * solid(kind, bent(q, rows[j, wp.static(BEND)], a[0]), a))
    return d


@wp.func
def clearance(j: int, p: wp.vec3, rows: wp.array2d(dtype=wp.vec4)):
    """Distance to the bounding ball of primitive j or to its bounding slab, whichever is larger: cheap, and never too large."""
    o = rows[j, wp.static(AT)]
    s = rows[j, wp.static(SLAB)]
    r = p - wp.vec3(o[0], o[1], o[2])
    return wp.max(wp.length(r) - o[3], wp.abs(wp.dot(r, wp.vec3(s[0], s[1], s[2]))) - s[3])


@wp.func
def distance(p: wp.vec3, cap: float, ids: wp.array(dtype=wp.int32), start: int, count: int, rows: wp.array2d(dtype=wp.vec4)):
    """Smaller of `cap` and the distance of a point of the drawing to the listed primitives, and the primitive it is nearest to (-1: none).

    A primitive whose bounds, which hold the reach of its group's blends, are farther than what is known cannot change the answer.
    """
    best = cap
    hit = int(-1)
    d = float(FAR)
    owner = int(-1)
    group = int(-1)
    for i in range(count):
        j = ids[start + i]
        how = rows[j, wp.static(KIND)]
        if int(how[1]) != group:
            if d < best:
                best = d
                hit = owner
            d = float(FAR)
            owner = int(-1)
            group = int(how[1])
        away = clearance(j, p, rows)
        blend = how[3]
        if int(how[2]) == wp.static(CUT):
            if away < blend - d:
                d = -smooth_min(-d, wp.max(primitive(j, p, rows), away), blend)
        elif away < wp.min(best, d):
            e = wp.max(primitive(j, p, rows), away)
            if e < d:
                owner = j
            d = smooth_min(d, e, blend)
    if d < best:
        best = d
        hit = owner
    return best, hit


@wp.func
def normal(p: wp.vec3, cap: float, ids: wp.array(dtype=wp.int32), start: int, count: int, rows: wp.array2d(dtype=wp.vec4)):
    """Unit gradient of the distance, which must be below the cap, by four evaluations at the corners of a tetrahedron."""
    n = wp.vec3(0.0, 0.0, 0.0)
    for i in range(4):
        e = wp.vec3(-1.0, -1.0, -1.0)
        if i == 0:
            e = wp.vec3(1.0, 1.0, -1.0)
        elif i == 1:
            e = wp.vec3(1.0, -1.0, 1.0)
        elif i == 2:
            e = wp.vec3(-1.0, 1.0, 1.0)
        d, k = distance(p + wp.static(PROBE) * e, cap, ids, start, count, rows)
        n = n + d * e
    return wp.normalize(n)


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
def openness(p: wp.vec3, n: wp.vec3, ids: wp.array(dtype=wp.int32), start: int, count: int, rows: wp.array2d(dtype=wp.vec4)):
    """Share of the sky that the object leaves open, from three distances along the normal (A. Evans, SIGGRAPH 2006 course)."""
    free = float(1.0)
    weight = float(0.34)
    for i in range(3):
        step = wp.static(SKY_STEP) * (0.5 + float(i))
        d, k = distance(p + step * n, step, ids, start, count, rows)
        free = free - weight * wp.clamp(1.0 - d / step, 0.0, 1.0)
        weight = weight * 0.7
    return free


@wp.func
def shade(j: int, p: wp.vec3, n: wp.vec3, free: float, rows: wp.array2d(dtype=wp.vec4)):
    """Paint under a fixed sky: hemisphere light through the open part of it, one wrapped key light, a painted-on highlight.

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
    """How far every ray within `spread` of the axis may go: |o + t d - p| ≤ t spread, so each may advance by r - t spread."""
    t = near
    r = float(0.5 * FAR)
    for _step in range(wp.static(STEPS)):
        r, j = distance(origin + t * axis, 2.0 * r + HIT, ids, start, count, rows)
        advance = r - t * spread
        if advance < 0.2 * t * spread or t > far:
            break
        t = t + advance
    return t


@wp.func
def cone_meets(j: int, origin: wp.vec3, axis: wp.vec3, spread: float, near: float, far: float, rows: wp.array2d(dtype=wp.vec4)):
    """False when the cone of rays surely passes primitive j, blend included: the march of `march_cone` against it alone."""
    reach = rows[j, wp.static(GLOSS)][2]
    t = near
    for _step in range(wp.static(STEPS)):
        p = origin + t * axis
        advance = wp.max(primitive(j, p, rows) - reach, clearance(j, p, rows)) - t * spread
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
    ids: wp.array(dtype=wp.int32),  # (C * tiles * 2 n,) two lists for every tile: what its rays may meet, what may shadow that
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
        wide = o[3] + wp.static(5.0 * SKY_STEP)
        if away <= wide or angle <= cone + wp.asin(wp.min(wide / wp.max(away, 1.0e-6), 1.0)):
            ids[start + n + around] = j
            around = around + 1
            first = wp.max(away - o[3], 0.0)
            if cone_meets(j, origin, axis, spread, first, away + o[3], rows):
                ids[start + count] = j
                count = count + 1
                near = wp.min(near, first)
                far = wp.max(far, away + o[3])
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
    r, j = distance(p, FAR, ids, 0, ids.shape[0], rows)
    normals[i] = n
    colours[i] = shade(j, p, n, openness(p, n, ids, 0, ids.shape[0], rows), rows)
