"""Several materials for the same particles, in one launch."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from diffuphy.mpm.drive import Impulse
from diffuphy.mpm.rollout import rollout
from diffuphy.mpm.scene import Scene
from diffuphy.types import MaterialField, Trajectory


def rollout_batch(
    scene: Scene, x: Tensor, vol: Tensor, fields: Sequence[MaterialField], **options: Any
) -> list[Trajectory]:
    """The films of the same particles with each of several materials; for sweeps and starts from many points.

    The scenes do not touch: each has a grid of its own. What is found from the material is found for all of them
    together: the substep is the shortest that any needs, retention and elastic contact go by the fastest wave of all,
    and all use one block of nodes. Alone, with that ``dt`` and the same fastest wave, each is the same film to
    rounding of its place in the block. On a GPU K small scenes take the time of one large one; on a CPU they take
    that of K, less what launches cost.

    Args:
        x: positions at rest, shape (N, 3) [m]; of every scene.
        vol: rest volumes, shape (N,) [m³].
        fields: one material a scene: the same laws in the same order, other weights, parameters and densities.
        options: of :func:`simulate`; ``velocity`` and ``body`` are those of one scene, (N, 3); no ``gather``.

    Raises:
        ValueError: no field, fields of different laws, or an option that has no meaning for a batch.
    """
    if not fields:
        raise ValueError("fields must have at least one material, got none")
    first = fields[0]
    laws = [(tuple(f.elastic), tuple(f.plastic), tuple(f.branches)) for f in fields]
    for k, its in enumerate(laws):
        if its != laws[0]:
            raise ValueError(f"fields[{k}] has the laws {its}, fields[0] has {laws[0]}; a batch shares them in order")
        if missing := set(first.theta) ^ set(fields[k].theta):
            raise ValueError(f"fields[{k}] and fields[0] must have the same parameters, they differ in {missing}")
    for name in ("state", "scenes", "gather", "diagnose"):
        if options.get(name):
            raise ValueError(f"a batch takes no {name}; run its scenes one by one for that")
    if any(isinstance(d, Impulse) for d in scene.drives):
        raise ValueError("an Impulse is shared out by the mass of all it reaches; give a batch a velocity instead")
    K, N = len(fields), len(x)
    field = dataclasses.replace(
        first,
        w_e=torch.cat([f.w_e for f in fields]),
        w_p=torch.cat([f.w_p for f in fields]),
        theta={k: torch.cat([f.theta[k] for f in fields]) for k in first.theta},
        rho=torch.cat([f.rho for f in fields]),
    )
    velocity, body = options.pop("velocity", None), options.pop("body", None)
    if velocity is not None:
        velocity = velocity.expand(N, 3).repeat(K, 1)
    if body is not None:
        options["body"] = lambda t: body(t).repeat(K, 1)
    film = rollout(scene, x.repeat(K, 1), vol.repeat(K), field, scenes=K, velocity=velocity, **options)
    parts = zip(*(t.split(N, dim=1) for t in (film.x, film.v, film.F)), strict=True)
    Fe = [None] * K if film.Fe is None else film.Fe.split(N, dim=1)
    return [Trajectory(*part, film.fps, elastic) for part, elastic in zip(parts, Fe, strict=True)]
