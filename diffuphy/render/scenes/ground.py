"""The ground of a captured scene: the plane that many Gaussians lie in and few below."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

THICKNESS = 0.01
"""Half the thickness of the ground as a share of the scene's extent: trained floors are no thinner."""

OUTERMOST = 0.01
"""Share of the points at each end of an axis that its extent leaves out."""

CONVINCING = 0.1
"""Share of the Gaussians that the ground must hold."""

BELOW = 0.05
"""Share of the Gaussians that may lie below it: floaters, and what leaks through a floor."""

TRIALS = 1000
"""Planes that are tried. One in ten points on the plane gives three of them in 1 − (1 − 10⁻³)^1000 = 63 % of all
searches, three in ten in all but 10⁻¹²; the more the ground holds the surer."""

SAMPLE = 4000
"""Most points that vote; their shares are good to √(0.1 · 0.9/4000) = 0.5 %."""

LEVEL = math.cos(math.radians(30.0))
"""Where up is known, a ground is at most 30° from level."""


UP = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)


@dataclass(frozen=True)
class Ground:
    """The plane normal · x = height."""

    normal: Tensor
    """Unit vector towards the side of the scene, shape (3,), float64."""
    height: float
    """Distance from the origin along the normal [lengths of the scene]."""
    tolerance: float
    """Half its thickness [lengths of the scene]."""
    share: float
    """Of the Gaussians in it [-]."""

    def above(self, x: Tensor) -> Tensor:
        """True for the points (n, 3) that are neither in it nor below."""
        return x.double() @ self.normal > self.height + self.tolerance

    @property
    def quat(self) -> Tensor:
        """The smallest rotation that takes the normal to z, wxyz, float64."""
        x, y, z = self.normal.tolist()
        if z < -1 + 1e-12:
            return torch.tensor([0.0, 1.0, 0.0, 0.0], dtype=torch.float64)
        q = torch.tensor([1 + z, y, -x, 0.0], dtype=torch.float64)  # 1 + n·z, n × z
        return q / q.norm()


def find_ground(x: Tensor, *, seed: int = 0, upright: bool = True) -> Ground:
    """The ground among points (n, 3): random planes through three of them, of which the one that holds most and has
    little below wins, fitted to what it holds.

    Fischler & Bolles, "Random sample consensus" (1981).

    Args:
        seed: of the planes.
        upright: z is up, so that steep planes are none; else any direction may be, and the scene lies on its side where
            more of it is.

    Raises:
        ValueError: no plane is convincing.
    """
    g = torch.Generator().manual_seed(seed)
    x = x.detach().cpu().double()
    some = x[torch.randperm(len(x), generator=g)[:SAMPLE]]
    tolerance = thickness(some)
    best = Ground(UP, 0.0, tolerance, 0.0)
    if len(some) >= 3 and tolerance > 0:
        a, b, c = some[torch.randint(len(some), (3, TRIALS), generator=g)]
        normals = torch.linalg.cross(b - a, c - a)
        sound = normals.norm(dim=1) > 1e-9 * tolerance**2
        normals, a = torch.nn.functional.normalize(normals[sound], dim=1), a[sound]
        normals = torch.where(normals[:, 2:] < 0, -normals, normals)
        both = (normals,) if upright else (normals, -normals)
        for n in both:
            level = n[:, 2] >= LEVEL if upright else torch.ones(len(n), dtype=torch.bool)
            found = _best(some, n[level], (n * a).sum(1)[level], tolerance)
            best = max(best, found or best, key=lambda plane: plane.share)
    for _ in range(3 if best.share else 0):
        best = _fitted(some, best)
    if best.share < CONVINCING:
        raise ValueError(
            f"no ground found: the best plane with at most {BELOW:.0%} of the Gaussians below it holds "
            f"{best.share:.1%} of them, {CONVINCING:.0%} would do; say its height in the file, gaussians.ground=-0.3, "
            "or gaussians.ground=null"
        )
    return best


def given_ground(x: Tensor, height: float) -> Ground:
    """A level ground at a height, as thick as one that is found among points (n, 3)."""
    tolerance = thickness(x)
    return Ground(UP, height, tolerance, float(((x[:, 2].double() - height).abs() <= tolerance).double().mean()))


def thickness(x: Tensor) -> float:
    """Half the thickness of a ground among points (n, 3): a share of the extent of all but the outermost."""
    k = 1 + int(OUTERMOST * (len(x) - 1))
    spans = x.double().kthvalue(len(x) + 1 - k, dim=0).values - x.double().kthvalue(k, dim=0).values
    return THICKNESS * float(spans.amax())


def _best(x: Tensor, normals: Tensor, heights: Tensor, tolerance: float) -> Ground | None:
    """The plane that holds most of those with little below; None if all have more below."""
    if not len(normals):
        return None
    d = x @ normals.mT - heights  # (n, planes)
    share = (d.abs() <= tolerance).double().mean(0)
    share = torch.where((d < -3 * tolerance).double().mean(0) <= BELOW, share, 0.0)
    k = int(share.argmax())
    return Ground(normals[k], float(heights[k]), tolerance, float(share[k])) if share[k] > 0 else None


def _fitted(x: Tensor, plane: Ground) -> Ground:
    """Least squares of the points that a plane holds: through their mean, across their least spread."""
    held = x[(x @ plane.normal - plane.height).abs() <= plane.tolerance]
    mean = held.mean(0)
    normal = torch.linalg.eigh((held - mean).mT @ (held - mean)).eigenvectors[:, 0]
    normal = normal * torch.sign(normal @ plane.normal)
    height = float(normal @ mean)
    share = float(((x @ normal - height).abs() <= plane.tolerance).double().mean())
    return Ground(normal, height, plane.tolerance, share) if share >= plane.share else plane
