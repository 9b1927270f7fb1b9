"""Gaussians of one's own in the place of fitted ones: read, set upright, cut out, and brought to size."""

import dataclasses
import logging
import math
from dataclasses import dataclass, field
from typing import ClassVar, Literal

import torch
from torch import Tensor

from diffuphy.render.scenes import capture
from diffuphy.render.scenes.ground import UP, Ground, find_ground, given_ground
from diffuphy.render.scenes.marks import marks, marks_file
from diffuphy.render.scenes.placement import Axis, Placement
from diffuphy.render.scenes.ply import Up, upright_turn
from diffuphy.text2gs.normalise import check_turns, normalised
from diffuphy.types import N_SH, Camera, Gaussians, Look
from diffuphy.workspace import Workspace

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class LoadGaussians:
    """Gaussians of a file, as the object of the film.

    What the header of the file promises is checked when the component is made, before any stage runs. Then, in this
    order: read, turned upright (``up``, then ``turns``), the broken and the transparent ones removed, the object
    cut out by ``region``, ``mask``, ``materials`` and ``ground``, centred and scaled to a longest side of 2. How many
    metres that is, the prompt says; what is left of the scene stands still around the object (``rest``).
    """

    VERSION: ClassVar[int] = 1

    path: str = field(metadata={"content": capture.source})
    """A .ply, .splat or .spz file of Gaussians, or the folder of a scene trained by the original code, whose newest
    iteration is taken. The result depends on what the file holds, not on what it is called."""
    up: Up | Literal["ground"] = "y_down"
    """Which way is up in the file; y_down is what cameras have and what trained scenes mostly follow. "ground": away
    from the ground that is found."""
    turns: tuple[tuple[Axis, float], ...] = ()
    """Further rotations about the then upright axes, [axis, angle [deg]], the first one first: [[x, 90], [z, -30]]."""
    region: tuple[float, float, float, float, float, float] | None = None
    """Box [xmin, xmax, ymin, ymax, zmin, zmax] around the object, in lengths of the file after all rotations; Gaussians
    outside stand still. None takes all of them as the object."""
    mask: str | None = field(default=None, metadata={"content": marks_file})
    """A .npy file of booleans, or a .ply file with a property ``label`` that is 0 or 1: which Gaussians of the file are
    the object, beside the region. None: all."""
    labels: str | None = field(default=None, metadata={"content": marks_file})
    """The same with a whole number for each: which thing it belongs to. None: there is one."""
    materials: dict[int, str] | None = None
    """Material word of each label that moves, {1: rubber, 2: sand}; with labels, those without a word stand still.
    None: there are no labels."""
    ground: float | Literal["found"] | None = None
    """The ground: found as the plane that many Gaussians lie in, and made level; or its height in lengths of the file
    after all rotations. What lies in it or below is not the object, and the floor of the film is there. None: the floor
    is where the object ends below."""
    seed: int = 0
    """Of the search for the ground."""
    min_opacity: float = 0.02
    """Gaussians more transparent than this are haze and are removed [-]; PhysGaussian's value."""
    anisotropy: float | None = None
    """Longest over shortest axis [-] beyond which Gaussians of the object are made rounder while its pictures stay
    (``text2gs.rounding``); None takes them as they are."""
    sh_degree: int = 3
    """Highest degree of spherical harmonics kept, 0 to 3; what the file has above it is not read."""
    max_gaussians: int = 10_000_000
    """A file with more of them is refused before they are read: ten million take 2.4 GB at degree 3, and about four
    times that while they are read."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "turns", check_turns(self.turns))
        if self.up != "ground":
            upright_turn(self.up)
        self._check_marks()
        if self.region is not None:
            object.__setattr__(self, "region", tuple(map(float, self.region)))
            low, high = self.region[::2], self.region[1::2]
            if len(self.region) != 6 or not all(a < b for a, b in zip(low, high, strict=True)):
                raise ValueError(
                    f"region must be [xmin, xmax, ymin, ymax, zmin, zmax] with min < max, got {list(self.region)}"
                )
        if self.anisotropy is not None and not self.anisotropy >= 1.0:
            raise ValueError(f"anisotropy must be at least 1, a ratio of axes, or null, got {self.anisotropy}")
        if not 0.0 <= self.min_opacity < 1.0:
            raise ValueError(f"min_opacity must be in [0, 1), got {self.min_opacity}")
        if self.sh_degree not in N_SH or self.max_gaussians < 1:
            raise ValueError(
                f"sh_degree must be 0, 1, 2 or 3 and max_gaussians at least 1, got {self.sh_degree} and "
                f"{self.max_gaussians}"
            )
        if (count := self.count) > self.max_gaussians:
            raise ValueError(
                f"{self.path} has {count} Gaussians, more than {self.max_gaussians}; raise max_gaussians or thin the "
                "scene out"
            )

    def _check_marks(self) -> None:
        if self.ground not in (None, "found") and not (
            isinstance(self.ground, float | int) and math.isfinite(self.ground)
        ):
            raise ValueError(f"ground must be 'found', a height or null, got {self.ground!r}")
        if self.up == "ground" and (self.ground != "found" or self.turns):
            raise ValueError("up=ground needs ground=found, and no turns: the ground says which way is up")
        if bool(self.labels) != bool(self.materials):
            raise ValueError(
                "labels and materials belong together: labels=labels.npy with materials={1: rubber}, the words of what "
                f"moves; got {self.labels!r} and {self.materials!r}"
            )
        for file in (self.mask, self.labels):
            marks_file(file)

    def __call__(self, look: Look, *, work: Workspace | None = None) -> Gaussians:
        """The object: centred, longest side 2, z up.

        Raises:
            ValueError: a file that cannot be read, or in which no object is left.
        """
        work = work or Workspace()
        scene = self._read()
        inside = scene.inside
        subject = self._placed(scene.g, inside, inside).to(work.device)
        if self.anisotropy is not None:
            from diffuphy.text2gs.rounding import Rounding

            subject = Rounding(self.anisotropy)(subject, work=work)
        counts = {**scene.removed, "around": int((~inside).sum())}
        if scene.ground is not None:
            counts |= {"ground_share": scene.ground.share}
            log.info("ground: %.0f %% of the Gaussians lie in it", 100 * scene.ground.share)
        work.log(0, gaussians=int(inside.sum()), **counts)
        log.info(
            "%d Gaussians of %s; removed %d broken and %d transparent ones; %d stand around the object",
            int(inside.sum()), capture.source(self.path), counts["broken"], counts["transparent"], counts["around"],
        )  # fmt: skip
        return subject

    @property
    def parted(self) -> bool:
        """Whether something of the scene may stand still."""
        return any(part is not None for part in (self.region, self.mask, self.labels, self.ground))

    def rest(self) -> Gaussians | None:
        """What stands around the object and does not move, in the object's frame; None where there is nothing."""
        if not self.parted:
            return None
        scene = self._read()
        return self._placed(scene.g, scene.inside, ~scene.inside) if bool((~scene.inside).any()) else None

    def floor(self) -> float | None:
        """Height of the ground in the object's frame; None where the object's underside is the floor."""
        if self.ground is None:
            return None
        scene = self._read()
        assert scene.ground is not None
        place = normalised(scene.g.means[scene.inside], self.path)
        return place.scale * scene.ground.height + float(place.shift[2])

    def kinds(self) -> Tensor:
        """Label of each Gaussian of the object, shape (G,), int64.

        Raises:
            ValueError: no labels.
        """
        scene = self._read()
        if scene.labels is None:
            raise ValueError("the scene has no labels: gaussians.labels=labels.npy 'gaussians.materials={1: rubber}'")
        return scene.labels[scene.inside]

    def cameras(self) -> tuple[Camera, ...]:
        """The cameras of a scene's folder in the object's frame; see ``capture.cameras``."""
        scene = self._read()
        place = normalised(scene.g.means[scene.inside], self.path)
        quarter = Placement.turns([("x", 90.0 * upright_turn(self._axes))])
        turns = (quarter, Placement.turns(self.turns), scene.level, place)
        found = capture.cameras(self.path)
        for turn in turns:
            found = tuple(turn.camera(c) for c in found)
        return found

    def longest(self) -> float:
        """Longest side of the object, in lengths of the file."""
        scene = self._read()
        return 2.0 / normalised(scene.g.means[scene.inside], self.path).scale

    @property
    def count(self) -> int:
        """Gaussians in the file."""
        return capture.count(self.path)

    @property
    def _axes(self) -> Up:
        """The convention in which the file is read: as it is, if the ground says which way is up."""
        return "z_up" if self.up == "ground" else self.up

    def _read(self) -> "_Scene":
        """Sound Gaussians of the file, upright, and which of them are the object."""
        g = capture.read(self.path, up=self._axes, degree=self.sh_degree)
        whole = sound(g)
        solid = torch.sigmoid(g.logit_opacities) >= self.min_opacity
        keep = whole & solid
        if not bool(keep.any()):
            raise ValueError(
                f"{self.path}: none of {len(g)} Gaussians is left: {int((~whole).sum())} have numbers that are not "
                f"finite, {int((whole & ~solid).sum())} an opacity below {self.min_opacity}"
            )
        removed = {"broken": int((~whole).sum()), "transparent": int((whole & ~solid).sum())}
        mask, labels = (marks(file, len(g))[keep] if file else None for file in (self.mask, self.labels))
        g = Placement.turns(self.turns)(taken(g, keep))
        level, ground = Placement.turns(()), None
        if self.ground == "found":
            ground = find_ground(g.means, seed=self.seed, upright=self.up != "ground")
            level = Placement(ground.quat)
            g = level(g)
            ground = dataclasses.replace(ground, normal=UP)
        elif self.ground is not None:
            ground = given_ground(g.means, float(self.ground))
        return _Scene(g, self._inside(g, mask, labels, ground), removed, labels, ground, level)

    def _inside(self, g: Gaussians, mask: Tensor | None, labels: Tensor | None, ground: Ground | None) -> Tensor:
        """True for the Gaussians of the object, shape (G,)."""
        inside = torch.ones(len(g), dtype=torch.bool)
        if self.region is not None:
            low, high = g.means.new_tensor(self.region[::2]), g.means.new_tensor(self.region[1::2])
            inside = ((g.means >= low) & (g.means <= high)).all(1)
            if not bool(inside.any()):
                first, last = ([round(v, 3) for v in t.tolist()] for t in (g.means.amin(0), g.means.amax(0)))
                raise ValueError(
                    f"no Gaussian lies in gaussians.region = {list(self.region)}; upright, the scene reaches from "
                    f"{first} to {last}"
                )
        if mask is not None:
            if not bool(((mask == 0) | (mask == 1)).all()):
                raise ValueError(f"{self.mask} must be 0 and 1, got {torch.unique(mask)[:5].tolist()}")
            inside = inside & (mask == 1)
        if labels is not None:
            for label in self.materials or {}:
                if not bool((inside & (labels == label)).any()):
                    there = torch.unique(labels[inside]).tolist()
                    raise ValueError(f"gaussians.materials names the label {label}; in the object are {there[:20]}")
            inside = inside & torch.isin(labels, torch.tensor(list(self.materials or {})))
        if ground is not None:
            inside = inside & ground.above(g.means)
        if not bool(inside.any()):
            raise ValueError(f"{self.path}: no Gaussian is in region and mask and above the ground at once")
        return inside

    def _placed(self, g: Gaussians, inside: Tensor, which: Tensor) -> Gaussians:
        """The Gaussians ``which``, in the frame of the object, those ``inside``."""
        placed = normalised(g.means[inside], self.path)(taken(g, which))
        if not bool((whole := sound(placed)).all()):
            raise ValueError(
                f"{self.path}: {int((~whole).sum())} Gaussians are so large or far away that at the object's scale "
                "float32 does not hold them; remove them from the file, or cut the object out with a larger region"
            )
        return placed


@dataclass(frozen=True)
class _Scene:
    """A file, read."""

    g: Gaussians
    """Upright."""
    inside: Tensor
    """True for those of the object, shape (G,)."""
    removed: dict[str, float]
    """How many were removed, and why."""
    labels: Tensor | None
    """Of each, shape (G,)."""
    ground: Ground | None
    """Level."""
    level: Placement
    """What made it level."""


def sound(g: Gaussians) -> Tensor:
    """True where every number of a Gaussian is finite, its sizes too, and its orientation is one, shape (G,)."""
    size, norm = g.log_scales.exp(), torch.linalg.vector_norm(g.quats, dim=1)
    finite = [t.flatten(1).isfinite().all(1) for t in (g.means, g.log_scales, size, g.sh)]
    return torch.stack([*finite, g.logit_opacities.isfinite(), norm > 0.0, norm.isfinite()]).all(0)


def taken(g: Gaussians, keep: Tensor) -> Gaussians:
    """The Gaussians where ``keep`` is true."""
    return Gaussians(g.means[keep], g.quats[keep], g.log_scales[keep], g.logit_opacities[keep], g.sh[keep])
