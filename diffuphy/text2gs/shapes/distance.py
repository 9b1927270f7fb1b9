"""Signed distance of a table of primitives. One source for CPU and CUDA.

A scene is a table with one row a primitive; a contiguous run of rows with the same group number is one solid, made by
smooth unions and cuts in the order of the rows; the object is the plain union of its groups. All distances are lower
bounds of the Euclidean one, so a ray may step by them (Hart, "Sphere tracing", The Visual Computer 1996); the closed
forms of the primitives are those collected by I. Quilez, "Distance functions" (iquilezles.org).
"""

import warp as wp

import diffuphy.compiling  # noqa: F401, sets Warp up before it starts

ELLIPSOID, DOME, FRUSTUM, BOX, TORUS, CONE, STAR = range(7)
"""Kinds of primitives; what `a` means for each is said in `primitives.Sketch`."""

UNION, CUT = 0, 1
"""How a primitive joins its group."""

FAR = 1.0e6
HIT = 1.0e-3
"""Distance at which a ray is on the surface [drawing units]; a fifteenth of a pixel at 128 px."""
PROBE = 1.5e-3
"""Half the side of the tetrahedron on which the gradient is measured [drawing units]."""

KIND, AT, SLAB, TURN, SIZE, BEND, LIMITS, PAINT, SECOND, THIRD, GLOSS, COLUMNS = range(12)
"""Columns of the table, each a vec4:
KIND    kind, group, UNION or CUT, blend radius k of the join
AT      centre, bounding radius
SLAB    local z axis, half height
TURN    quaternion xyzw from the primitive's frame to the drawing's
SIZE    sizes
BEND    ruffle, ribs, count, droop
LIMITS  of the bend: 1 / Lipschitz constant, swelling, distance from which the swollen one is used;
        reach: how far the blends of its group may move the surface
PAINT   colour, pattern
SECOND  second colour, scale
THIRD   third colour, grain
GLOSS   highlight, glow
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
    """Polynomial smooth minimum: min(a, b) - h² k / 4 with h = max(1 - |a - b| / k, 0); 1-Lipschitz when a and b
    are."""
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

    Of a bent one the larger of two lower bounds: that of the straight one swollen by the bend, which alone counts far
    away, and that in the coordinates in which it is straight, divided by the Lipschitz constant of the map to them.
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
    """Distance to the bounding ball of primitive j or to its bounding slab, whichever is larger: cheap, and never too
    large."""
    o = rows[j, wp.static(AT)]
    s = rows[j, wp.static(SLAB)]
    r = p - wp.vec3(o[0], o[1], o[2])
    return wp.max(wp.length(r) - o[3], wp.abs(wp.dot(r, wp.vec3(s[0], s[1], s[2]))) - s[3])


@wp.func
def distance(
    p: wp.vec3, cap: float, ids: wp.array(dtype=wp.int32), start: int, count: int, rows: wp.array2d(dtype=wp.vec4)
):
    """Smaller of `cap` and the distance of a point of the drawing to the listed primitives, and the primitive it is
    nearest to (-1: none).

    A primitive whose bounds are farther than what is known, by more than the reach of its group's blends, cannot change
    the answer.
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
        elif away - rows[j, wp.static(LIMITS)][3] < wp.min(best, d):
            e = wp.max(primitive(j, p, rows), away)
            if e < d:
                owner = j
            d = smooth_min(d, e, blend)
    if d < best:
        best = d
        hit = owner
    return best, hit


@wp.func
def normal(
    p: wp.vec3, cap: float, ids: wp.array(dtype=wp.int32), start: int, count: int, rows: wp.array2d(dtype=wp.vec4)
):
    """Unit gradient of the distance, which must be below the cap, by four evaluations at the corners of a
    tetrahedron."""
    n = wp.vec3(0.0, 0.0, 0.0)
    for i in range(4):
        e = wp.vec3(-1.0, -1.0, -1.0)
        if i == 0:
            e = wp.vec3(1.0, 1.0, -1.0)
        elif i == 1:
            e = wp.vec3(1.0, -1.0, 1.0)
        elif i == 2:
            e = wp.vec3(-1.0, 1.0, 1.0)
        d, _k = distance(p + wp.static(PROBE) * e, cap, ids, start, count, rows)
        n = n + d * e
    return wp.normalize(n)
