"""A trained scene: one thing in it moves, the rest stands around.

    python examples/own_scene.py gaussians.path=scene.ply            # yours: .ply, .splat, or the folder of a training
    python examples/own_scene.py experiment=tiny                     # without one, a duck between mushrooms is written

``gaussians.region`` is the box of what moves, in lengths of the file. Writes outputs/examples/duck.ply and
outputs/examples/runs/a-30-cm-clay-duck-squashed-…/. 18 seconds of one core, with experiment=tiny.
"""

import math
import sys
from pathlib import Path

import torch

import diffuphy
from diffuphy.making import Made
from diffuphy.render.scenes import ply
from diffuphy.render.sh import from_rgb
from diffuphy.text2gs.shapes import Library
from diffuphy.types import Gaussians, Look

DUCK = "gaussians.region=[-1.02,1.02,-1.02,1.02,-0.995,1.2]"


def write_duck(file: Path, balls: int = 6000) -> None:
    """A duck between three mushrooms on a lawn, in the layout of 3D Gaussian splatting, degree 0, y down."""
    shelf, seed = Library(), torch.Generator().manual_seed(0)
    parts = []
    for name, angle, size in (
        ("duck", 0.0, 1.0),
        ("mushroom", 0.6, 0.8),
        ("mushroom", 2.4, 0.5),
        ("mushroom", 4.9, 0.3),
    ):
        x, rgb = shelf.object(Look(name, "")).surface(balls, seed)
        x = (x - torch.tensor([0.0, 0.0, x[:, 2].min()])) * size
        away = 0.0 if name == "duck" else 2.2
        parts.append((x + torch.tensor([away * math.cos(angle), away * math.sin(angle), -0.99]), rgb))
    lawn = (torch.rand(3 * balls, 3, generator=seed) - 0.5) * torch.tensor([6.2, 6.2, 0.02]) - torch.tensor(
        [0, 0, 1.01]
    )
    lawn = lawn[lawn[:, :2].norm(dim=1) < 3.1]
    parts.append((lawn, torch.tensor([0.30, 0.48, 0.16]) * (0.7 + 0.5 * torch.rand(len(lawn), 1, generator=seed))))
    x, rgb = (torch.cat(t) for t in zip(*parts, strict=True))
    n = len(x)
    file.parent.mkdir(parents=True, exist_ok=True)
    ply.write(
        file,
        Gaussians(
            x, torch.tensor([[1.0, 0, 0, 0]]).repeat(n, 1), torch.full((n, 3), 0.025).log(), torch.full((n,), 4.0),
            from_rgb(rgb.clamp(0, 1)),
        ),
    )  # fmt: skip


def main(*settings: str) -> Made:
    given = list(settings)
    if not any(s.startswith("gaussians.path=") for s in given):
        scene = Path("outputs/examples/duck.ply")
        write_duck(scene)
        given += [f"gaussians.path={scene}", DUCK, "film.floor=false"]
    made = diffuphy.film("a 30 cm clay duck squashed", "gaussians=ply", "store=outputs/examples", *given)
    print(made.folder)
    return made


if __name__ == "__main__":
    main(*sys.argv[1:])
