"""The acceleration of each kind of drive, and its adjoint, as Warp functions of a row of ``layout``."""

from functools import cache

import warp as wp

from diffuphy.mpm.drive.layout import N_DRIVE


@cache
def make_field(kind: str, region: str, real: type) -> tuple[wp.Function, wp.Function]:
    """``field(r, v, w) → b`` and ``field_adjoint(r, v, w, b_bar) → (r_bar, v_bar)``; zero outside the region."""
    vec3, drive_t = wp.types.vector(3, real), wp.types.vector(N_DRIVE, real)
    everywhere, everywhere_adjoint = {
        "Impulse": _uniform,
        "Acceleration": _uniform,
        "Attractor": _attractor,
        "Vortex": _vortex,
        "Drag": _drag,
    }[kind](real)
    if not region:
        return everywhere, everywhere_adjoint
    box = region == "InBox"

    @wp.func(module="unique")
    def inside(r: vec3, w: drive_t) -> bool:
        if wp.static(box):
            for k in range(3):
                if r[k] < w[9 + k] or r[k] > w[12 + k]:
                    return False
            return True
        return wp.length(r - vec3(w[9], w[10], w[11])) <= w[12]

    @wp.func(module="unique")
    def field(r: vec3, v: vec3, w: drive_t) -> vec3:
        if inside(r, w):
            return everywhere(r, v, w)
        return vec3()

    @wp.func(module="unique")
    def field_adjoint(r: vec3, v: vec3, w: drive_t, b_bar: vec3):
        r_bar, v_bar = vec3(), vec3()
        if inside(r, w):
            r_bar, v_bar = everywhere_adjoint(r, v, w, b_bar)
        return r_bar, v_bar

    return field, field_adjoint


def _uniform(real: type) -> tuple[wp.Function, wp.Function]:
    vec3, drive_t = wp.types.vector(3, real), wp.types.vector(N_DRIVE, real)

    @wp.func(module="unique")
    def field(r: vec3, v: vec3, w: drive_t) -> vec3:
        return vec3(w[0], w[1], w[2])

    @wp.func(module="unique")
    def field_adjoint(r: vec3, v: vec3, w: drive_t, b_bar: vec3):
        return vec3(), vec3()

    return field, field_adjoint


def _attractor(real: type) -> tuple[wp.Function, wp.Function]:
    vec3, drive_t = wp.types.vector(3, real), wp.types.vector(N_DRIVE, real)

    @wp.func(module="unique")
    def field(r: vec3, v: vec3, w: drive_t) -> vec3:
        d = r - vec3(w[0], w[1], w[2])
        return (-w[3] * wp.pow(real(1.0) + w[4] * wp.dot(d, d), w[5])) * d

    @wp.func(module="unique")
    def field_adjoint(r: vec3, v: vec3, w: drive_t, b_bar: vec3):
        # b = −a q^e d,  dq = 2 d·dd/s²
        d = r - vec3(w[0], w[1], w[2])
        q = real(1.0) + w[4] * wp.dot(d, d)
        a = -w[3] * wp.pow(q, w[5])
        return a * b_bar + (real(2.0) * a * w[5] * w[4] / q * wp.dot(d, b_bar)) * d, vec3()

    return field, field_adjoint


def _vortex(real: type) -> tuple[wp.Function, wp.Function]:
    vec3, drive_t = wp.types.vector(3, real), wp.types.vector(N_DRIVE, real)

    @wp.func(module="unique")
    def across(r: vec3, w: drive_t):
        """The axis and d⊥."""
        a, d = vec3(w[3], w[4], w[5]), r - vec3(w[0], w[1], w[2])
        return a, d - wp.dot(d, a) * a

    @wp.func(module="unique")
    def field(r: vec3, v: vec3, w: drive_t) -> vec3:
        a, d = across(r, w)
        return (w[6] * wp.pow(real(1.0) + w[7] * wp.dot(d, d), w[8])) * wp.cross(a, d)

    @wp.func(module="unique")
    def field_adjoint(r: vec3, v: vec3, w: drive_t, b_bar: vec3):
        # b = k q^e a × d⊥,  dq = 2 d⊥·dd/s²; what is along the axis drops out of both terms
        a, d = across(r, w)
        q = real(1.0) + w[7] * wp.dot(d, d)
        k = w[6] * wp.pow(q, w[8])
        along = wp.dot(wp.cross(a, d), b_bar)
        return k * wp.cross(b_bar, a) + (real(2.0) * k * w[8] * w[7] / q * along) * d, vec3()

    return field, field_adjoint


def _drag(real: type) -> tuple[wp.Function, wp.Function]:
    vec3, drive_t = wp.types.vector(3, real), wp.types.vector(N_DRIVE, real)

    @wp.func(module="unique")
    def field(r: vec3, v: vec3, w: drive_t) -> vec3:
        u = v - vec3(w[0], w[1], w[2])
        k = w[4] * wp.length(u)
        return (-w[5] * (w[3] + k) / (real(1.0) + k)) * u

    @wp.func(module="unique")
    def field_adjoint(r: vec3, v: vec3, w: drive_t, b_bar: vec3):
        # b = −g(|u|) u,  g' = q κ (1 − lost)/(Δt (1 + q κ |u|)²)
        u = v - vec3(w[0], w[1], w[2])
        length = wp.length(u)
        k = real(1.0) + w[4] * length
        v_bar = (-w[5] * (w[3] + w[4] * length) / k) * b_bar
        if length > real(0.0):
            v_bar -= (w[5] * w[4] * (real(1.0) - w[3]) / (k * k * length) * wp.dot(u, b_bar)) * u
        return vec3(), v_bar

    return field, field_adjoint
