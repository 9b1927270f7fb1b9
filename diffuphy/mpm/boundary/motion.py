"""How walls and held particles move: constant velocities, or a schedule of places and turns.

    constant    c(t) = c₀ + (t − start) V,            R(t) = exp((t − start) [ω]×) R₀
    schedule    c(t) = c₀ + offset(t),                R(t) = exp([r(t)]×) R₀,    V = d offset/dt,  ω = J(r) dr/dt

offset and r are piecewise linear; J(r) = 1 + (1 − cos θ)/θ² [r]× + (θ − sin θ)/θ³ [r]×², θ = |r|, is the left Jacobian
of the rotation group, so that ω is exactly the angular velocity of R(t).
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

Vec = tuple[float, float, float]


def vector(name: str, value: Sequence[float]) -> Vec:
    """Three finite numbers as a tuple.

    Raises:
        ValueError: naming the field and what was got.
    """
    if len(value) != 3 or not all(math.isfinite(c) for c in value):
        raise ValueError(f"{name} must be three finite numbers, got {tuple(value)}")
    return (float(value[0]), float(value[1]), float(value[2]))


def direction(name: str, value: Sequence[float]) -> Vec:
    """A vector of any length but 0 as one of length 1.

    Raises:
        ValueError: naming the field and what was got.
    """
    v = vector(name, value)
    length = math.hypot(*v)
    if length == 0.0:
        raise ValueError(f"{name} must not be zero, got {value}")
    return (v[0] / length, v[1] / length, v[2] / length)


def cross_matrix(r: np.ndarray) -> np.ndarray:
    """[r]× with [r]× a = r × a, shape (..., 3) → (..., 3, 3)."""
    out = np.zeros((*r.shape, 3))
    out[..., 2, 1], out[..., 0, 2], out[..., 1, 0] = r[..., 0], r[..., 1], r[..., 2]
    return out - np.swapaxes(out, -1, -2)


def rotation_increment(r: np.ndarray) -> np.ndarray:
    """exp [r]× − 1 to its own digits (Rodrigues), rotation vectors r [rad], shape (..., 3) → (..., 3, 3).

    (sin θ/θ) [r]× + ½ (sin(θ/2)/(θ/2))² [r]×², which has no division at θ = 0.
    """
    theta, K = np.linalg.norm(r, axis=-1)[..., None, None], cross_matrix(r)
    return np.sinc(theta / np.pi) * K + 0.5 * np.sinc(theta / (2 * np.pi)) ** 2 * (K @ K)


def rotation_matrix(r: np.ndarray) -> np.ndarray:
    """exp [r]×, shape (..., 3) → (..., 3, 3)."""
    return np.eye(3) + rotation_increment(r)


def left_jacobian(r: np.ndarray) -> np.ndarray:
    """J(r) with ω = J(r) dr/dt for R = exp [r]×, shape (..., 3) → (..., 3, 3)."""
    theta, K = np.linalg.norm(r, axis=-1)[..., None, None], cross_matrix(r)
    square = np.where(theta > 0, theta**2, 1.0)  # where θ = 0 so is [r]×²
    return np.eye(3) + 0.5 * np.sinc(theta / (2 * np.pi)) ** 2 * K + (1 - np.sinc(theta / np.pi)) / square * (K @ K)


@dataclass(frozen=True, kw_only=True)
class Schedule:
    """Places and turns at given times; straight in between, at rest before the first and after the last."""

    times: tuple[float, ...]
    """Times of the film, increasing, at least two [s]."""
    offsets: tuple[Vec, ...] = ()
    """Where the centre is then, from where its own field says [m]; empty: it stays."""
    rotations: tuple[Vec, ...] = ()
    """Rotation vectors then, on top of its own orientation: axis times angle [rad]; more than a turn is allowed. Empty:
    it keeps its orientation."""

    def __post_init__(self) -> None:
        times = tuple(float(t) for t in self.times)
        if len(times) < 2 or not all(a < b for a, b in itertools.pairwise(times)):
            raise ValueError(f"times of a schedule must be at least two and increase, got {self.times}")
        if not all(math.isfinite(t) for t in times):
            raise ValueError(f"times of a schedule must be finite, got {self.times}")
        object.__setattr__(self, "times", times)
        if not self.offsets and not self.rotations:
            raise ValueError("a schedule without offsets and without rotations moves nothing; give one of them")
        for name in ("offsets", "rotations"):
            values = tuple(vector(f"{name}[{k}]", v) for k, v in enumerate(getattr(self, name)))
            if values and len(values) != len(times):
                raise ValueError(
                    f"{name} must have one entry for each of the {len(times)} times, got {len(values)}; or leave it out"
                )
            object.__setattr__(self, name, values)

    def at(self, name: str, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """``offsets`` or ``rotations`` at times of shape (T,), and their rates there, each of shape (T, 3)."""
        values, knots = np.asarray(getattr(self, name)), np.asarray(self.times)
        if not len(values):
            return np.zeros((len(t), 3)), np.zeros((len(t), 3))
        slopes = np.zeros((len(knots) + 1, 3))
        slopes[1:-1] = np.diff(values, axis=0) / np.diff(knots)[:, None]
        value = np.stack([np.interp(t, knots, column) for column in values.T], axis=1)
        return value, slopes[np.searchsorted(knots, t, side="right")]

    @property
    def rates(self) -> tuple[float, float]:
        """Largest speed of the centre [m/s] and largest angular speed [rad/s]; |J(r) ṙ| ≤ |ṙ|."""
        mid = (np.asarray(self.times)[1:] + np.asarray(self.times)[:-1]) / 2
        speed, spin = (float(np.linalg.norm(self.at(n, mid)[1], axis=1).max()) for n in ("offsets", "rotations"))
        return speed, spin


@dataclass(frozen=True)
class Pose:
    """Where something is and how it moves, at T times."""

    place: np.ndarray
    """Its centre, shape (T, 3) [m]."""
    rotation: np.ndarray
    """From its orientation at first to that now, shape (T, 3, 3)."""
    velocity: np.ndarray
    """Of the centre, shape (T, 3) [m/s]."""
    angular_velocity: np.ndarray
    """Shape (T, 3) [rad/s]."""


def pose(
    place: Vec, velocity: Vec, angular_velocity: Vec, schedule: Schedule | None, start: float, times: np.ndarray
) -> Pose:
    """The motion of the equations above at ``times`` (T,) [s]: the schedule's, or the constant one from ``start``."""
    since = (times - start)[:, None]
    if schedule is None:
        V, w = np.asarray(velocity), np.asarray(angular_velocity)
        turn = rotation_matrix(since * w) if w.any() else np.broadcast_to(np.eye(3), (len(times), 3, 3))
        still = np.zeros((len(times), 1))
        return Pose(np.asarray(place) + since * V, turn, still + V, still + w)
    offset, V = schedule.at("offsets", times)
    r, rate = schedule.at("rotations", times)
    return Pose(np.asarray(place) + offset, rotation_matrix(r), V, np.einsum("tij,tj->ti", left_jacobian(r), rate))
