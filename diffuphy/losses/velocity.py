"""The velocity loss: Newton's second law between two frames, in forms that measure different things.

The paper (eqs 12–15) compares the velocity change of each particle with the one its forces explain:

    L = 1/N Σ_i |Δv_i − Δv_expected,i|²
    Δv_expected,i = (F_stress,i + m_i g) Δt / m_i,   F_stress,i = −Δt V_i Σ_j σ_i : ∇w_ij

``literal``
    As printed. The weights sum to one, so Σ_j ∇w_ij = 0 and F_stress,i vanishes identically whatever the material:
    what is left, |Δv_i − g Δt|², *punishes every departure from free fall*, contact and elasticity included. It is
    zero for a body that falls and never lands, and g² Δt² for one at rest on the floor.
``consistent``
    With the forces the solver really applied: Δv_expected,i = Σ_substeps Δt (Σ_j w_ij f_j / m_j + g), f_j = −Σ_p V_p
    τ_p ∇w_pj, gathered by the simulator over the substeps of a frame and given here as ``expected_dv``. What is left
    is the transfer filter and wall impulses. Frame-end states cannot replace the gathering: a wave crosses a soft
    half-metre body (10 m/s) in 1.5 frames and a stiff one (100 m/s) in 0.15, so the stress at the end of a frame says
    nothing of its mean over the frame.
``momentum``
    For the whole body, in which internal forces cancel: r = (Σ m Δv − M g Δt − J) / M with the wall impulse J that
    the simulator counted. Zero to rounding for a correct solver and any material: a test of the solver, not a teacher
    of the material. Where nobody counted, ``contact_impulse`` gives the impulse a wall could have had.
``image``
    The momentum of the body as a camera sees it: the velocity of the centroid of the picture against that of the
    prior's clip. Newton's law holds for both, so what differs is when and how hard the floor answered. Needs a prior
    that has a clip in mind.

Measured on the recovery of Young's modulus: the sign of the literal form's gradient is right in 46–54 % of starts, a
coin; from 3e-3 on it can drive a good fit away. Hence weight 0 by default, and the forms kept apart by name.
"""

import math
from dataclasses import dataclass
from typing import Any, Literal, get_args

import torch
from torch import Tensor

Form = Literal["consistent", "literal", "momentum", "image"]


def velocity_loss(
    form: Form,
    v: Tensor,
    m: Tensor,
    *,
    gravity: Tensor | tuple[float, float, float],
    dt: float,
    expected_dv: Tensor | None = None,
    impulse: Tensor | None = None,
) -> Tensor:
    """One of the forms above that particles tell, mean over frames, in m²/s².

        literal      mean_t 1/N Σ_i |v_i,t+1 − v_i,t − g Δt|²
        consistent   mean_t 1/N Σ_i |v_i,t+1 − v_i,t − Δv_expected,i,t|²
        momentum     mean_t |Σ_i m_i (v_i,t+1 − v_i,t − g Δt) − J_t|² / M²

    Args:
        form: which. v: velocities at the frames, shape (T, N, 3) [m/s], T ≥ 2. m: masses, shape (N,) [kg]. gravity: g
        [m/s²], shape (3,). dt: time between frames Δt [s]. expected_dv: for ``consistent``, shape (T−1, N, 3) [m/s].
        impulse: for ``momentum``, impulse of all walls on the body in each frame, shape (T−1, 3) [N s]; zeros in free
        flight.

    Raises:
        ValueError: for an unknown form, a wrong shape, a step that is not positive, or what the form needs not given.
    """
    _check(form, v, m, dt, expected_dv, impulse)
    change = v[1:] - v[:-1]
    fall = torch.as_tensor(gravity, dtype=v.dtype, device=v.device) * dt
    if form == "consistent":
        return (change - expected_dv).square().sum(-1).mean()
    if form == "literal":
        return (change - fall).square().sum(-1).mean()
    residual = ((change - fall) * m[:, None]).sum(1) - impulse
    return (residual / m.sum()).square().sum(-1).mean()


def centroid(picture: Tensor, background: Tensor) -> Tensor:
    """Where the picture differs from its background, on the average [px], shape (2,): column, row.

        c = Σ_q a_q q / Σ_q a_q,   a_q = |rgb_q − background|²

    Args:
        picture: shape (H, W, 3). background: shape (3,).

    Raises:
        ValueError: nothing differs from the background, so nothing has a centroid.
    """
    a = (picture - background).square().sum(-1)
    total = a.sum()
    if not float(total.detach()) > 0:
        raise ValueError("the picture is all background; film the object, or take another velocity.form than 'image'")
    rows, columns = (torch.arange(n, dtype=a.dtype, device=a.device) + 0.5 for n in a.shape)
    return torch.stack([(a.sum(0) * columns).sum(), (a.sum(1) * rows).sum()]) / total


def image_velocity_loss(c: Tensor, target: Tensor, *, pixel: float, dt: float) -> Tensor:
    """mean_t |u_t − u*_t|² with the velocities u_t = pixel · (c_{t+1} − c_t)/Δt of two centroids [m²/s²].

    Args:
        c, target: centroids of the frames, shape (T, 2) [px], T ≥ 2.
        pixel: side of a pixel where the object is [m].
        dt: time between frames Δt [s].
    """
    if c.shape != target.shape or len(c) < 2:
        raise ValueError(f"c and target must be the same T ≥ 2 centroids, got {tuple(c.shape)}, {tuple(target.shape)}")
    return (pixel / dt * (c - target).diff(dim=0)).square().sum(-1).mean()


def contact_impulse(
    v: Tensor,
    m: Tensor,
    touching: Tensor,
    *,
    gravity: Tensor | tuple[float, float, float],
    dt: float,
    normal: Tensor | tuple[float, float, float] = (0.0, 0.0, 1.0),
    friction: float = math.inf,
) -> Tensor:
    """The impulse of a wall in each frame, as far as velocities tell: the admissible one nearest to what they ask for.

        R = Σ m Δv − M g Δt,   J = argmin |J − R|²  over  J·n ≥ 0, |J − (J·n) n| ≤ μ J·n,  and J = 0 without touch

    A wall pushes, never pulls (Signorini), and drags at most μ times as hard (Coulomb). The cone is convex, so the sum
    of the impulses on all particles over all substeps lies in it too: this holds at frame scale. With it the
    ``momentum`` form measures what *no* wall explains: a push in mid-air, a pull towards the floor, too much drag.

    Args:
        v, m, gravity, dt: as in ``velocity_loss``.
        touching: whether anything touched the wall in the frame, shape (T−1,), bool.
        normal: unit normal n of the wall, out of it, shape (3,).
        friction: μ [-]; infinite for a wall that holds.

    Returns:
        J, shape (T−1, 3) [N s], constant to autograd; the gradient of a squared distance to a convex set is right so.
    """
    with torch.no_grad():
        n = torch.as_tensor(normal, dtype=v.dtype, device=v.device)
        fall = torch.as_tensor(gravity, dtype=v.dtype, device=v.device) * dt
        asked = ((v[1:] - v[:-1] - fall) * m[:, None]).sum(1)
        push = (asked * n).sum(-1, keepdim=True)
        drag = asked - push * n
        if math.isinf(friction):
            impulse = drag + push.clamp(min=0) * n
        else:
            size = drag.norm(dim=-1, keepdim=True)
            share = ((push + friction * size) / (1 + friction**2)).clamp(min=0)
            edge = share * (n + friction * drag / size.clamp(min=torch.finfo(v.dtype).tiny))
            impulse = torch.where(size <= friction * push, asked, edge)
        return torch.where(touching[:, None], impulse, torch.zeros_like(impulse))


def _check(form: str, v: Tensor, m: Tensor, dt: float, expected_dv: Tensor | None, impulse: Tensor | None) -> None:
    if form not in get_args(Form):
        raise ValueError(f"form must be one of {get_args(Form)}, got {form!r}")
    if v.ndim != 3 or v.shape[0] < 2 or v.shape[2] != 3:
        raise ValueError(f"v must be (T, N, 3) with T ≥ 2 frames, got {tuple(v.shape)}; give the whole trajectory")
    frames, n, _ = v.shape
    if tuple(m.shape) != (n,):
        raise ValueError(f"m must be ({n},), one mass per particle of v, got {tuple(m.shape)}")
    if not dt > 0:
        raise ValueError(f"dt must be the positive time between frames [s], got {dt}")
    given = {
        "consistent": ("expected_dv", expected_dv, (frames - 1, n, 3)),
        "momentum": ("impulse", impulse, (frames - 1, 3)),
    }
    if form in given:
        name, value, shape = given[form]
        if value is None or tuple(value.shape) != shape:
            got = "nothing" if value is None else tuple(value.shape)
            raise ValueError(f"form {form!r} needs {name} {shape} from the simulator, got {got}; or use another form")


@dataclass(frozen=True)
class Velocity:
    """λ_vel · L_vel (paper eq. 15)."""

    form: Form = "consistent"
    """``consistent``, ``literal`` (eqs 12–14 as printed: punishes all but free fall), ``momentum`` or ``image``."""
    weight: float = 0.0
    """λ_vel [s²/m²]; 0.2 in the paper. 0 leaves the loss out: no form teaches the material, the literal misleads."""

    def __post_init__(self) -> None:
        if self.form not in get_args(Form):
            raise ValueError(f"velocity.form must be one of {get_args(Form)}, got {self.form!r}")
        if self.weight < 0:
            raise ValueError(f"velocity.weight must be ≥ 0, got {self.weight}; 0 leaves the loss out")

    @property
    def needs(self) -> str | None:
        """``expected_dv`` or ``impulse`` if the simulator must gather it; None if v is enough or the weight is 0."""
        return {"consistent": "expected_dv", "momentum": "impulse"}.get(self.form) if self.weight > 0 else None

    def __call__(self, v: Tensor, m: Tensor, **given: Any) -> Tensor:
        """``weight`` · ``velocity_loss(form, ...)``."""
        return self.weight * velocity_loss(self.form, v, m, **given)

    def of_pictures(self, c: Tensor, target: Tensor, *, pixel: float, dt: float) -> Tensor:
        """``weight`` · ``image_velocity_loss(...)``."""
        return self.weight * image_velocity_loss(c, target, pixel=pixel, dt=dt)
