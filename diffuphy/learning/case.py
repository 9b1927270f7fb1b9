"""What every way of finding a material starts from: the experiment, what the prior says of it, and what is known.

A rival of ``FitMaterial`` makes its ``Case``, trains a model of its own with ``descent.descend``, and hands the field
to ``verdict``: what it shares with the others is not its own code, and what differs is in the open.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal, Self

import torch
from torch import Tensor

from diffuphy.learning.appearance import appearance
from diffuphy.learning.probe import Bench, Probe, TableClips, parts_of, table_field, words_of
from diffuphy.losses.sds import Weight
from diffuphy.losses.takes import Take
from diffuphy.losses.video import video_sds
from diffuphy.material import ELASTIC, PLASTIC, Param
from diffuphy.material.encoder import Points
from diffuphy.material.patches import color_clusters
from diffuphy.types import Gaussians, Look, MaterialField, Motion, Particles, Trajectory

Segment = Literal["parts", "colour"]


class Conditions:
    """What the video prior is asked about takes of the probe."""

    def __init__(self, guidance: Any, motion: Motion, bench: Bench):
        self.guidance, self.motion, self.bench = guidance, motion, bench
        self._made: tuple[Take | None, Any] = (None, None)

    def prepare(self, take: Take) -> Any:
        """The prior's condition for a take; that of the last one is remembered."""
        if self._made[0] != take:
            self._made = (take, self._condition(take))
        return self._made[1]

    def _condition(self, take: Take) -> Any:
        guidance, references = self.guidance, getattr(self.guidance, "references", None)
        if isinstance(references, TableClips):
            guidance = dataclasses.replace(guidance, references=partial(references, take=take))
        camera = self.bench.camera_of(take)[[0] * len(take.frames)]
        background, generator = self.bench.background_of(take), torch.Generator().manual_seed(0)
        return guidance.condition(self.motion, camera, background, generator=generator)

    def score(self, trajectory: Trajectory, weight: Weight) -> float:
        """The loss of the whole clip at t = ½ with the same noise for every clip of one length: hypotheses are
        compared, not luck."""
        take, generator = Take.whole(len(trajectory.x) - 1), torch.Generator().manual_seed(1)
        with torch.no_grad():
            return float(self.distil(trajectory, take, t=0.5, generator=generator, weight=weight))

    def distil(self, trajectory: Trajectory, take: Take, *, t: float, **settings: Any) -> Tensor:
        """Score distillation of a take, frame by frame; its gradient is per pixel, so lengths compare.

        Args:
            t: diffusion time in (0, 1).
            settings: of ``video_sds``: noise or generator, weight, estimator.
        """
        frames, draw = list(take.frames), self.bench.drawing(take)
        operands, times = (trajectory.x[frames], trajectory.F[frames]), torch.tensor([t], device=trajectory.x.device)
        value = video_sds(self.guidance, draw, operands, self.prepare(take), t=times, **settings)
        return value.detach() + (value - value.detach()) / (3 * len(frames) * self.bench.probe.image**2)

    def target(self) -> Tensor | None:
        """The clip that the prior has in mind, shape (T, H, W, 3); None if it has none, as a network has."""
        if not isinstance(references := getattr(self.guidance, "references", None), TableClips):
            return None
        take = Take.whole(self.bench.probe.frames)
        camera = self.bench.camera_of(take)[[0] * len(take.frames)]
        return references(self.motion, camera, self.bench.background_of(take), take=take)[0][0, 0]


@dataclass(frozen=True)
class Case:
    """One object on the bench."""

    bench: Bench
    """The experiment with the coarse copy of the object."""
    cond: Conditions
    """The prior, asked about this experiment."""
    table: MaterialField
    """What the table says of the draft particles, with a column for each candidate expert."""
    points: Points
    """What the draft particles look like."""
    labels: Tensor
    """Region of each draft particle, 0 … R − 1, none empty, shape (N,)."""
    names: tuple[str, ...]
    """What the parts of the object are called."""
    part: Tensor
    """Part of each draft particle, an index of ``names``, shape (N,)."""

    @classmethod
    def make(
        cls,
        probe: Probe,
        guidance: Any,
        library: Any,
        look: Look,
        motion: Motion,
        gaussians: Gaussians,
        particles: Particles,
        *,
        elastic: Sequence[str] = (),
        plastic: Sequence[str] = (),
        override: Mapping[str, float | None] | None = None,
        regions: int = 1,
        segment: Segment = "parts",
    ) -> Self:
        """Set up the experiment on an object.

        Args:
            guidance: video prior; one without references, as the embedded one, is given clips of the probe,
                simulated with the table's material and another draw of particles.
            library: knows the parts of an object; None: one material for the whole object.
            elastic, plastic: candidate experts; () takes those of the table.
            override: parameters that all parts take instead of the table's [SI].
            regions: most regions; never more than the prompt has materials.
            segment: what makes a region, see ``segments``.
        """

        def table(bench: Bench) -> MaterialField:
            field = table_field(library, look, motion, bench.draft, override)
            return with_columns(field, elastic or field.elastic, plastic or field.plastic)

        words, of = words_of(library, look, motion, particles)
        most = min(regions, len(set(motion.materials.values())))
        labels = torch.zeros_like(of)
        if most > 1:
            labels = segments(appearance(gaussians, particles), words, of, most, segment)
        kind = _pairs(labels, torch.tensor([words.index(w) for w in words], device=of.device)[of])
        bench = probe.bench(gaussians, particles, motion.size, kind)
        if getattr(guidance, "references", 0) is None:
            other = dataclasses.replace(probe, seed=probe.seed + 1).bench(gaussians, particles, motion.size, kind)
            guidance = dataclasses.replace(guidance, references=TableClips(other, table(other)))
        points, labels = appearance(gaussians, bench.draft), labels[bench.kept]
        names, part = parts_of(library, look, bench.draft)
        if library is None and int(labels.max()):
            names, part = tuple(f"region {r + 1}" for r in range(int(labels.max()) + 1)), labels
        return cls(bench, Conditions(guidance, motion, bench), table(bench), points, labels, names, part)


def _pairs(a: Tensor, b: Tensor) -> Tensor:
    """A number for each pair that occurs, shape (N,), int64: what differs in either is of another kind."""
    return torch.unique(torch.stack([a, b], 1), dim=0, return_inverse=True)[1]


def segments(points: Points, words: Sequence[str], part: Tensor, most: int, segment: Segment) -> Tensor:
    """Regions that may have materials of their own, shape (N,), int64.

    ``parts``: those parts of the object to which the prompt gives the same word, whatever that word is, wherever the
    library knows the parts and their words are no more than ``most``; a look at the surface cannot tell what lies
    inside. ``colour``, and otherwise: clusters of the colours.
    """
    found = sorted({words[i] for i in part.unique().tolist()})
    if segment == "parts" and 1 < len(found) <= most:
        return torch.tensor([found.index(w) if w in found else 0 for w in words], device=part.device)[part]
    return color_clusters(points.color, most)[0]


def with_columns(table: MaterialField, elastic: Sequence[str], plastic: Sequence[str]) -> MaterialField:
    """The same field with one column for each of these experts and every parameter they read.

    Raises:
        ValueError: an expert that the field uses is not among them.
    """

    def columns(names: Sequence[str], have: Sequence[str], w: Tensor) -> Tensor:
        missing = [n for n in have if n not in names and bool((w[:, have.index(n)] > 0).any())]
        if missing:
            raise ValueError(f"the table needs expert {missing[0]!r}, which is not among the candidates {tuple(names)}")
        zero = torch.zeros_like(w[:, 0])
        return torch.stack([w[:, have.index(n)] if n in have else zero for n in names], 1)

    theta = dict(table.theta)
    for p in parameters(elastic, plastic):
        theta.setdefault(p.name, torch.full_like(table.rho, p.default))
    w_e, w_p = columns(elastic, table.elastic, table.w_e), columns(plastic, table.plastic, table.w_p)
    return MaterialField(tuple(elastic), tuple(plastic), w_e, w_p, theta, table.rho)


def parameters(elastic: Sequence[str], plastic: Sequence[str]) -> list[Param]:
    """Parameters of these experts, each name once."""
    found = {p.name: p for law in (*(ELASTIC[n] for n in elastic), *(PLASTIC[n] for n in plastic)) for p in law.params}
    return list(found.values())
