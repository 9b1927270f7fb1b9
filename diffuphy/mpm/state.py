"""What a simulation works on: particles at one time, their matter, and one frame of time; made from results, and
checked."""

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import torch
import warp as wp
from torch import Tensor

from diffuphy.mpm.scene import Scene
from diffuphy.mpm.substep.variant import Variant
from diffuphy.types import MaterialField

REAL = {torch.float32: wp.float32, torch.float64: wp.float64}
"""Precisions a simulation can run in."""


@dataclass(frozen=True)
class State:
    """N particles at one time."""

    x: Tensor
    """Positions, shape (N, 3) [m]."""
    v: Tensor
    """Velocities, shape (N, 3) [m/s]."""
    C: Tensor
    """Affine velocities, shape (N, 3, 3) [1/s]."""
    He: Tensor
    """Trial elastic deformation gradient minus the identity, shape (N, 3, 3)."""
    H: Tensor | None
    """Total deformation gradient minus the identity, shape (N, 3, 3); None when nothing flows: it is ``He`` then."""
    memory: Tensor | None = None
    """What laws remember, shape (N, K), columns as ``mixture.memory``: "log_J", ln det of the total deformation
    gradient, summed from its increments, since det F has no digits left after much shear; "slip", "heat"; None unless a
    law remembers."""
    HN: Tensor | None = None
    """Elastic deformation gradient of the viscous branch minus the identity, shape (N, 3, 3); None without one."""
    time: float = 0.0
    """Time since the beginning [s]."""

    def tensors(self) -> tuple[Tensor | None, ...]:
        """x, v, C, He, H, memory, HN."""
        return self.x, self.v, self.C, self.He, self.H, self.memory, self.HN

    @property
    def F(self) -> Tensor:
        """Total deformation gradient, shape (N, 3, 3)."""
        return _with_identity(self.He if self.H is None else self.H)

    @property
    def Fe(self) -> Tensor | None:
        """Elastic deformation gradient, shape (N, 3, 3); None where nothing flows: it is F then."""
        return None if self.H is None else _with_identity(self.He)


def _with_identity(H: Tensor) -> Tensor:
    return H + torch.eye(3, dtype=H.dtype, device=H.device)


@dataclass(frozen=True)
class Matter:
    """What does not change during a rollout; contiguous tensors of one precision on one device."""

    w_e: Tensor
    """Elastic weights, shape (N, Ke)."""
    w_p: Tensor
    """Plastic weights, shape (N, Kp)."""
    theta: Tensor
    """Parameters in the order of ``mixture.params``, shape (N, P), SI."""
    m: Tensor
    """Masses, shape (N,) [kg]."""
    vol: Tensor
    """Rest volumes, shape (N,) [m³]."""
    tag: Tensor | None = None
    """Which drives act on a particle, shape (N,), bit masks; None without drives."""

    def tensors(self) -> tuple[Tensor, ...]:
        """w_e, w_p, θ, m, vol."""
        return self.w_e, self.w_p, self.theta, self.m, self.vol


def state_bytes(state: State) -> int:
    """Memory of one state [byte]."""
    return sum(t.numel() * t.element_size() for t in state.tensors() if t is not None)


class Rows:
    """``slots`` copies of the state of a frame below each other: row s N + p is particle p after s rounds; u counts
    from the first."""

    def __init__(self, variant: Variant, state: State, slots: int):
        self.n = state.x.shape[0]

        def rows_of(first: Tensor | None) -> Tensor | None:
            if first is None:
                return None
            out = torch.empty((slots * self.n, *first.shape[1:]), dtype=first.dtype, device=first.device)
            out[: self.n] = first.detach()
            return out

        X = state.x.detach().contiguous()
        first = (torch.zeros_like(X), state.v, state.C, state.He, state.H, state.memory, state.HN)
        self._tensors = [rows_of(t) for t in first]
        v, memory_t = variant, variant.mixture.memory_t
        kinds = (v.vec3, v.vec3, v.mat33, v.mat33, v.mat33, memory_t, v.mat33)
        names = ("u", "v", "C", "He", "H", "memory", "HN")
        views = {n: view(t, d, X.device) for n, t, d in zip(names, self._tensors, kinds, strict=True)}
        self.arrays = SimpleNamespace(X=view(X, v.vec3, X.device), **views)

    def take(self, slot: int) -> list[Tensor | None]:
        """A copy of one slot: u, v, C, He, H, memory, HN."""
        part = slice(slot * self.n, (slot + 1) * self.n)
        return [None if t is None else t[part].clone() for t in self._tensors]

    def put(self, parts: list[Tensor | None]) -> None:
        """Make ``parts`` the first slot."""
        for t, part in zip(self._tensors, parts, strict=True):
            if t is not None:
                t[: self.n] = part


@dataclass(frozen=True)
class Bars:
    """Gradients of a loss in the fields of a state, of matter and of a scene; None where there is nothing or nothing is
    asked for. Kernels add to those of matter and scene, and carry those of a state from its end to its beginning."""

    x: Tensor
    v: Tensor
    C: Tensor
    He: Tensor
    H: Tensor | None
    memory: Tensor | None
    HN: Tensor | None
    w_e: Tensor | None = None
    w_p: Tensor | None = None
    theta: Tensor | None = None
    m: Tensor | None = None
    gravity: Tensor | None = None
    """A row a node, shape (nodes, 3)."""
    alpha: Tensor | None = None
    """In the retention, shape (N,)."""
    omega: Tensor | None = None
    """In ω² of contact, a row a node, shape (nodes,)."""
    walls: Tensor | None = None
    """In the wall data of every round, shape (steps, walls, N_WALL)."""
    push: Tensor | None = None
    """b̄ · b of every impulse, shape (N, impulses)."""

    def state(self, v: Variant) -> list[tuple[Tensor | None, Any]]:
        """Gradients of a state with their Warp types."""
        return [
            (self.x, v.vec3), (self.v, v.vec3), (self.C, v.mat33), (self.He, v.mat33), (self.H, v.mat33),
            (self.memory, v.mixture.memory_t), (self.HN, v.mat33),
        ]  # fmt: skip

    def matter(self, v: Variant) -> list[tuple[Tensor | None, Any]]:
        """Gradients of matter with their Warp types."""
        mix = v.mixture
        return [(self.w_e, mix.w_e_t), (self.w_p, mix.w_p_t), (self.theta, mix.theta_t), (self.m, v.real)]


def view(t: Tensor | None, dtype: Any, device: torch.device | str) -> wp.array:
    """A tensor as a Warp array, without a copy; nothing at all for an argument that the kernel never reads."""
    if t is None:
        return wp.zeros(0, dtype=dtype, device=str(device))
    return wp.from_torch(t.detach(), dtype=dtype)


def check(x: Tensor, vol: Tensor, field: MaterialField) -> None:
    """Refuse what cannot be simulated.

    Raises:
        ValueError: naming the field, the first bad row, and what is allowed.
    """
    N = x.shape[0]
    if x.dtype not in REAL:
        raise ValueError(f"x must be float32 or float64, got {x.dtype}")
    if N == 0 or x.shape != (N, 3):
        raise ValueError(f"x must have shape (N, 3) with N > 0, got {tuple(x.shape)}")
    shapes = {
        "vol": (vol, (N,)),
        "rho": (field.rho, (N,)),
        "w_e": (field.w_e, (N, len(field.elastic))),
        "w_p": (field.w_p, (N, len(field.plastic))),
    }
    shapes |= {f"theta[{k!r}]": (t, (N,)) for k, t in field.theta.items()}
    for name, (t, shape) in shapes.items():
        if tuple(t.shape) != shape:
            raise ValueError(f"{name} must have shape {shape} for {N} particles, got {tuple(t.shape)}")
    positive = {"vol", "rho"}
    for name, t in {"x": x, **{k: t for k, (t, _) in shapes.items()}}.items():
        bad = ~torch.isfinite(t.detach()) if name not in positive else ~(torch.isfinite(t.detach()) & (t.detach() > 0))
        if bool(bad.any()):
            row = int(bad.reshape(N, -1).any(1).nonzero()[0])
            raise ValueError(
                f"{name} of particle {row} is {t[row].tolist()}; it must be "
                f"finite{' and positive' if name in positive else ''}"
            )


SIMPLEX = 1e-5
"""How far a weight may be below 0, and the sum of a row from 1 [-]: some ten ulp of float32 for each of ten laws."""


def check_weights(field: MaterialField) -> None:
    """Refuse weights that are not on the simplex: stresses would not be a mean of those of the laws.

    Raises:
        ValueError: naming the first particle, its row and what is allowed.
    """
    for name, names, w in (("w_e", field.elastic, field.w_e), ("w_p", field.plastic, field.w_p)):
        w = w.detach()
        good = (w >= -SIMPLEX).all(1) & ((w.sum(1) - 1.0).abs() <= SIMPLEX)
        if not bool(good.all()):
            p = int((~good).nonzero()[0])
            raise ValueError(
                f"{name} of particle {p} is {[float(f'{a:.6g}') for a in w[p].tolist()]} for {tuple(names)}; weights "
                f"must be at least 0 and sum to 1, these sum to {float(w[p].sum()):.6g}: divide rows by their sums, or "
                "make them by material.decoder.gate"
            )


def make_matter(
    field: MaterialField, vol: Tensor, params: tuple[str, ...], dtype: torch.dtype, grad: bool = True
) -> Matter:
    """The tensors of a field as the kernels read them; still part of the graph if ``grad``.

    Raises:
        ValueError: weights off the simplex, or a parameter that is missing.
    """
    check_weights(field)
    if missing := [p for p in params if p not in field.theta]:
        raise ValueError(
            f"the laws {(*field.elastic, *field.plastic)} need the parameter {missing[0]!r}; theta has "
            f"{sorted(field.theta)}"
        )
    theta = torch.stack([field.theta[p].to(dtype) for p in params], 1)
    vol = vol.detach().to(dtype)
    parts = [
        t.to(dtype) if grad else t.detach().to(dtype) for t in (field.w_e, field.w_p, theta, field.rho.to(dtype) * vol)
    ]
    return Matter(*(t.contiguous() for t in parts), vol.contiguous())


def placed(scene: Scene, x: Tensor, vol: Tensor) -> Tensor:
    """Particles lifted to the height at which a scene begins; a particle reaches half the side of its volume down."""
    if scene.lift is None:
        return x
    up = torch.zeros_like(x[0].detach())
    up[2] = scene.lift - (x[:, 2] - 0.5 * vol ** (1 / 3)).detach().min()
    return x + up


def initial_state(
    scene: Scene, x: Tensor, matter: Matter, mixture: Any, velocity: Tensor | None = None, scenes: int = 1
) -> State:
    """Particles lifted to their height and set in motion: v = V + ω × (x − x_cm), C = [ω]×, F = I."""
    x, m = placed(scene, x, matter.vol), matter.m
    w = x.new_tensor(scene.spin)
    each = (m[:, None] * x).reshape(scenes, -1, 3).sum(1) / m.reshape(scenes, -1).sum(1)[:, None]
    center = each.repeat_interleave(len(x) // scenes, 0)
    v = x.new_tensor(scene.velocity) + torch.linalg.cross(w.expand_as(x), x - center)
    C = x.new_zeros(len(x), 3, 3)
    C[:] = x.new_tensor([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
    H = x.new_zeros(len(x), 3, 3)
    return State(
        x,
        v if velocity is None else v + velocity.to(x),
        C,
        H,
        H.clone() if mixture.is_plastic else None,
        x.new_zeros(len(x), len(mixture.memory)) if mixture.memory else None,
        H.clone() if mixture.branches else None,
    )


def check_state(state: State, mixture: Any) -> None:
    """Refuse a state from which laws cannot go on.

    Raises:
        ValueError: naming the field and the first bad particle.
    """
    F = (state.He.detach() + torch.eye(3).to(state.He)).double()  # float32 loses the sign at a condition of 1e3
    if bool((bad := ~(torch.linalg.det(F) > 0)).any()):
        p = int(bad.nonzero()[0])
        raise ValueError(
            f"det F of particle {p} is {float(torch.linalg.det(F[p])):.4g} in the state to go on from; it must be "
            "positive: a body cannot be inside out"
        )
    needs = {"memory": bool(mixture.memory), "HN": bool(mixture.branches), "H": mixture.is_plastic}
    for name, need in needs.items():
        if need and getattr(state, name) is None:
            raise ValueError(
                f"the laws {(*mixture.laws_p, *mixture.branches)} need {name} in the state to go on from, which has "
                "none; start from one of theirs"
            )
