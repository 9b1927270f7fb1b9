"""How wrong a film is: the difference to the same film with cells of twice the size.

Let u_h be the motion on a grid of spacing h. With an error C hᵖ the draft with 2 h differs from the film by

    u_2h − u_h = (2ᵖ − 1) C hᵖ,   so   error of the film ≈ |u_2h − u_h| / (2ᵖ − 1)

(Richardson 1911). Films have contact, whose order is one: p = 1, and the difference is the estimate. From two grids the
true error is bounded by three times the estimate, Fs = 3 (Roache, J. Fluids Eng. 116:405, 1994); ``docs/numerics/
errors.md`` holds how often it is. Bodies that bounce or tumble magnify what is small before, without a bound: there
the difference is as large as it can be, and so is the estimate.

The draft is the restriction of the film's own first frame, see ``mpm.restrict``: an eighth of the particles, half of
the substeps, a sixteenth of the work.
"""

import dataclasses
import itertools
import logging
from dataclasses import dataclass
from typing import ClassVar, Literal

import torch
from torch import Tensor

from diffuphy.mpm.restrict import Restriction, restrict
from diffuphy.mpm.rollout import simulate
from diffuphy.mpm.scene import Scene
from diffuphy.mpm.trajectory import Simulate, paced
from diffuphy.render.film.clip import Film
from diffuphy.types import Camera, Errors, MaterialField, Motion, Particles, SimulationDiverged, Trajectory
from diffuphy.workspace import Workspace

log = logging.getLogger(__name__)

ORDER = 1.0
"""Order p of films with contact; free flight has two, and is overestimated."""

WINDOW = 0.1
"""Frames this far apart share the largest difference [s]: two motions that swing against each other meet now and then,
which says nothing about either."""

FEWEST = 3
"""Cells along the longest side of a draft: a quadratic spline spans as many [-]."""


@dataclass(frozen=True)
class Estimate:
    """Estimates the error of a film from coarse drafts of it."""

    VERSION: ClassVar[int] = 1

    error: Literal["on", "off"] = "on"
    """``off`` leaves the estimate out."""
    time: bool = True
    """Repeat the draft with half the time step: what of the error is due to time [twice the cost of the draft]."""
    precision: bool = False
    """Repeat the draft in the other precision: what of the error is rounding [once to twice the cost of the draft, and
    kernels of its own, which take a while to compile]."""
    scene: Simulate | None = None
    """How the film was simulated; left open: as the run does it."""
    film: Film | None = None
    """The camera that pixels are meant of; left open: that of the run."""

    def __call__(
        self, motion: Motion, particles: Particles, field: MaterialField, trajectory: Trajectory, *, work: Workspace
    ) -> Errors:
        """Errors of every frame.

        A draft that cannot be simulated (a body of too few cells, a state that means nothing) makes no estimate; the
        result says why, and the log warns.
        """
        if self.scene is None or self.film is None:
            raise ValueError("scene and film are left open: give those that made the trajectory and the clip")
        fine = self.scene.scene(motion, particles)
        coarse = restrict(
            trajectory.x[0], particles.vol, field.rho, spacing=particles.spacing, side=2 * particles.spacing
        )
        try:
            check_size(motion.size, 2 * fine.dx)
            drafts = self._drafts(fine, coarse, coarse.field(field), trajectory, work)
        except (ValueError, SimulationDiverged) as trouble:
            log.warning("no error estimate: the draft with twice the grid spacing failed: %s", trouble)
            return Errors.missing(len(trajectory.x), motion.size, trajectory.fps, str(trouble))
        x = torch.stack([coarse(frame) for frame in trajectory.x])
        camera, s = self.film.cameras(trajectory, particles), self.film.supersample
        weight = coarse.mass / coarse.mass.sum()
        seen = project(x, camera)
        com, shape, pixels = zip(
            *(
                (*split(d.double() - x, weight), rms(project(d.double(), camera) - seen, weight) / s)
                for d in drafts.values()
            ),
            strict=True,
        )  # every draft is one of this film; the farthest counts, as one may be near by chance
        parts = {
            name: rms(d.double() - (x if name == "grid" else drafts["grid"].double()), weight)
            for name, d in drafts.items()
        }
        reach = round(WINDOW * trajectory.fps)
        return Errors(
            *(envelope(torch.stack(of).amax(0), reach).float() for of in (com, shape, pixels)),
            {name: envelope(values, reach).float() for name, values in parts.items()},
            motion.size, trajectory.fps, ORDER,
        )  # fmt: skip

    def _drafts(
        self, fine: Scene, coarse: Restriction, field: MaterialField, trajectory: Trajectory, work: Workspace
    ) -> dict[str, Tensor]:
        """Positions of the coarse particles in each draft, shape (T, M, 3); a finished one is kept in a checkpoint."""
        assert self.scene is not None
        usual, other = (torch.float64, torch.float32) if self.scene.double else (torch.float32, torch.float64)
        scene = dataclasses.replace(fine, dx=2 * fine.dx, lift=None, frames=len(trajectory.x) - 1)
        wanted: dict[str, tuple[Scene, torch.dtype]] = {"grid": (scene, usual)}
        if self.time:
            wanted["time"] = (dataclasses.replace(scene, cfl=scene.cfl / 2), usual)
        if self.precision:
            wanted["precision"] = (scene, other)
        done: dict[str, Tensor] = dict(work.load() or {})
        with work.bar(len(wanted) * (scene.frames + 1), "errors", initial=len(done) * (scene.frames + 1)) as bar:
            for name, (its, dtype) in wanted.items():
                if name in done:
                    continue
                frames = []
                its, parts = paced(its)
                states = simulate(its, coarse.x.to(dtype), coarse.vol.to(dtype), field)
                for state in itertools.islice(states, 0, None, parts):
                    frames.append(state.x)
                    bar.update()
                done[name] = torch.stack(frames)
                work.save(dict(done))
        return done


def check_size(size: float, dx: float) -> None:
    """Refuse a draft of a body that its grid does not see."""
    if FEWEST * dx > size * (1 + 1e-6):  # a spacing is a rounded quotient
        raise ValueError(
            f"the longest side, {size:.3g} m, must span at least {FEWEST} cells of the draft, {dx:.3g} m each; "
            "take more particles for the film, or leave the estimate out with report.error=off"
        )


def split(e: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
    """Error of the centre of mass, and that of the shape: root mean square of what is left, each (T,) [m].

    Args:
        e: difference of positions, shape (T, M, 3) [m].
        weight: shares in the mass, shape (M,).
    """
    center = (weight[:, None] * e).sum(1)
    return center.norm(dim=1), rms(e - center[:, None], weight)


def rms(e: Tensor, weight: Tensor) -> Tensor:
    """√Σ_k w_k |e_k|², (T, M, d) → (T,)."""
    return (weight * e.square().sum(-1)).sum(-1).sqrt()


def envelope(values: Tensor, reach: int) -> Tensor:
    """The largest of the frames up to ``reach`` away, (T,) → (T,)."""
    return torch.nn.functional.max_pool1d(values[None, None], 2 * reach + 1, stride=1, padding=reach)[0, 0]


def project(x: Tensor, camera: Camera) -> Tensor:
    """Where a camera, or that of each of T frames, sees points, (T, n, 3) [m] → (T, n, 2) [px]."""
    view, K = camera.viewmats.to(x), camera.Ks.to(x)
    seen = (x @ view[:, :3, :3].mT + view[:, None, :3, 3]) @ K.mT
    return seen[..., :2] / seen[..., 2:]
