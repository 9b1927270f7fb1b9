"""What drives do to a particle, and the adjoint of that, compiled for one list of drives."""

from functools import cache
from types import SimpleNamespace

import warp as wp

from diffuphy.mpm.drive.drives import HOLDING
from diffuphy.mpm.drive.kernels_fields import make_field
from diffuphy.mpm.drive.layout import N_DRIVE, Signature

HOLDING_KINDS = tuple(d.__name__ for d in HOLDING)


@cache
def make_drives(signature: Signature, real: type) -> SimpleNamespace:
    """Warp functions of a list of drives; what it does not contain leaves no code.

        accelerate(r, v, tag, row, s) → b                          sum of their accelerations [m/s²]
        accelerate_adjoint(r, v, tag, row, s, b_bar) → (r_bar, v_bar)
        pushed(tag, row, s, b_bar, p, out)                         adds b_bar · b of its k-th impulse to out[p, k]
        hold(r, v, C, tag, row, s) → (v, C)                        the later drive rules
        hold_adjoint(r, v, C, tag, row, s, v_bar, C_bar) → (r_bar, v_bar, C_bar)
        holding(tag, row, s) → bool                                whether one of them holds the particle
        joined(tag) → bool                                         whether it is one piece with what some of them hold

    r is the particle at the beginning of the substep, from the lowest node of the grid [m], ``tag`` its bits from
    ``layout.tags``, ``row`` the data of ``layout.drive_rows`` and s the row of this substep. ``hold`` is for the
    velocities that a particle takes to the grid and again, with the same r, for those that it gets from there and
    moves with.
    Gradients are exact; which particles are inside a region, or still held, is fixed. Rows get none, but for the mass
    that an impulse is shared by: ``layout.mass_gradient`` makes that of ``pushed``.
    """
    kinds = tuple(kind for kind, _ in signature)
    n = len(kinds) + 1 if "Release" in kinds else 0
    accelerate, accelerate_adjoint = _accelerations(signature, real)
    hold, hold_adjoint, holding = _holds(kinds, n, real)
    drive_t = wp.types.vector(N_DRIVE, real)
    return SimpleNamespace(
        drive_t=drive_t,
        accelerate=accelerate,
        accelerate_adjoint=accelerate_adjoint,
        pushed=_pushes(kinds, real),
        hold=hold,
        hold_adjoint=hold_adjoint,
        holding=holding,
        joined=_joined(len(kinds)),
        accelerates=any(k not in HOLDING_KINDS for k in kinds),
        holds=any(k in HOLDING_KINDS for k in kinds),
        impulses=kinds.count("Impulse"),
    )


@cache
def _joined(count: int) -> wp.Function:
    bit = 1 << count

    @wp.func(module="unique")
    def joined(tag: wp.int32) -> bool:
        return (tag & bit) != 0

    return joined


@cache
def _accelerations(signature: Signature, real: type) -> tuple[wp.Function, wp.Function]:
    """The sum over the accelerating drives of a list: those before the last, and the last."""
    vec3, drive_t = wp.types.vector(3, real), wp.types.vector(N_DRIVE, real)
    if not signature:

        @wp.func(module="unique")
        def nothing(r: vec3, v: vec3, tag: wp.int32, row: wp.array2d[drive_t], s: wp.int32) -> vec3:
            return vec3()

        @wp.func(module="unique")
        def nothing_adjoint(r: vec3, v: vec3, tag: wp.int32, row: wp.array2d[drive_t], s: wp.int32, b_bar: vec3):
            return vec3(), vec3()

        return nothing, nothing_adjoint

    before, before_adjoint = _accelerations(signature[:-1], real)
    kind, region = signature[-1]
    if kind in HOLDING_KINDS:
        return before, before_adjoint
    last = len(signature) - 1
    bit = 1 << last
    field, field_adjoint = make_field(kind, region, real)

    @wp.func(module="unique")
    def accelerate(r: vec3, v: vec3, tag: wp.int32, row: wp.array2d[drive_t], s: wp.int32) -> vec3:
        b = before(r, v, tag, row, s)
        if (tag & bit) != 0:
            b += field(r, v, row[s, last])
        return b

    @wp.func(module="unique")
    def accelerate_adjoint(r: vec3, v: vec3, tag: wp.int32, row: wp.array2d[drive_t], s: wp.int32, b_bar: vec3):
        r_bar, v_bar = before_adjoint(r, v, tag, row, s, b_bar)
        if (tag & bit) != 0:
            r_more, v_more = field_adjoint(r, v, row[s, last], b_bar)
            r_bar += r_more
            v_bar += v_more
        return r_bar, v_bar

    return accelerate, accelerate_adjoint


@cache
def _pushes(kinds: tuple[str, ...], real: type) -> wp.Function:
    """What the impulses of a list do to a particle, those before the last, and the last."""
    vec3, drive_t = wp.types.vector(3, real), wp.types.vector(N_DRIVE, real)
    if not kinds:

        @wp.func(module="unique")
        def nothing(
            tag: wp.int32, row: wp.array2d[drive_t], s: wp.int32, b_bar: vec3, p: wp.int32, out: wp.array2d[real]
        ):
            return

        return nothing

    before = _pushes(kinds[:-1], real)
    if kinds[-1] != "Impulse":
        return before
    last, at = len(kinds) - 1, kinds[:-1].count("Impulse")
    bit = 1 << last

    @wp.func(module="unique")
    def pushed(tag: wp.int32, row: wp.array2d[drive_t], s: wp.int32, b_bar: vec3, p: wp.int32, out: wp.array2d[real]):
        before(tag, row, s, b_bar, p, out)
        if (tag & bit) != 0:
            w = row[s, last]
            out[p, at] = out[p, at] + wp.dot(b_bar, vec3(w[0], w[1], w[2]))

    return pushed


@cache
def _holds(kinds: tuple[str, ...], n: int, real: type) -> tuple[wp.Function, ...]:
    """The holding drives of a list, the last of them outermost; n bits of a tag come before a time of release."""
    vec3, mat33, drive_t = wp.types.vector(3, real), wp.types.matrix((3, 3), real), wp.types.vector(N_DRIVE, real)
    if not kinds:

        @wp.func(module="unique")
        def nothing(r: vec3, v: vec3, C: mat33, tag: wp.int32, row: wp.array2d[drive_t], s: wp.int32):
            return v, C

        @wp.func(module="unique")
        def nothing_adjoint(
            r: vec3, v: vec3, C: mat33, tag: wp.int32, row: wp.array2d[drive_t], s: wp.int32, v_bar: vec3, C_bar: mat33
        ):
            return vec3(), v_bar, C_bar

        @wp.func(module="unique")
        def nobody(tag: wp.int32, row: wp.array2d[drive_t], s: wp.int32) -> bool:
            return False

        return nothing, nothing_adjoint, nobody

    before, before_adjoint, others = _holds(kinds[:-1], n, real)
    if kinds[-1] not in HOLDING_KINDS:
        return before, before_adjoint, others
    last, held = len(kinds) - 1, kinds[-1] == "Held"
    bit = 1 << last

    @wp.func(module="unique")
    def holds(tag: wp.int32, w: drive_t) -> bool:
        if (tag & bit) == 0:
            return False
        if wp.static(held):
            return w[15] != real(0.0)
        return real(tag >> n) > w[0]

    @wp.func(module="unique")
    def hold(r: vec3, v: vec3, C: mat33, tag: wp.int32, row: wp.array2d[drive_t], s: wp.int32):
        w = row[s, last]
        if holds(tag, w):
            if wp.static(held):
                A = mat33(w[6], w[7], w[8], w[9], w[10], w[11], w[12], w[13], w[14])
                return vec3(w[0], w[1], w[2]) + A * (r - vec3(w[3], w[4], w[5])), A
            return vec3(), mat33()
        v_before, C_before = before(r, v, C, tag, row, s)
        return v_before, C_before

    @wp.func(module="unique")
    def hold_adjoint(
        r: vec3, v: vec3, C: mat33, tag: wp.int32, row: wp.array2d[drive_t], s: wp.int32, v_bar: vec3, C_bar: mat33
    ):
        w = row[s, last]
        if holds(tag, w):
            if wp.static(held):
                A = mat33(w[6], w[7], w[8], w[9], w[10], w[11], w[12], w[13], w[14])
                return wp.transpose(A) * v_bar, vec3(), mat33()
            return vec3(), vec3(), mat33()
        r_before, v_before, C_before = before_adjoint(r, v, C, tag, row, s, v_bar, C_bar)
        return r_before, v_before, C_before

    @wp.func(module="unique")
    def holding(tag: wp.int32, row: wp.array2d[drive_t], s: wp.int32) -> bool:
        return holds(tag, row[s, last]) or others(tag, row, s)

    return hold, hold_adjoint, holding
