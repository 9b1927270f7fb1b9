"""One object, two materials: the buns of a burger are rubber, all between them is honey. Nothing is fitted.

    python examples/two_materials.py
    python examples/two_materials.py experiment=tiny

Every Gaussian has a label, and every label the word of a material; in a scene of one's own labels come from a
segmentation. That a sentence names two materials, ``prompt="a rubber burger with a clay patty falling"``, is enough
too: then the material stage finds which particle is what, as well as clips show it. Writes outputs/examples/burger.ply,
labels.npy and the run's folder, outputs/examples/runs/a-burger-falling-…/, with a film of the laws beside the film.
"""

import sys
from pathlib import Path

import numpy as np
import torch

import diffuphy
from diffuphy.making import Made
from diffuphy.render.scenes import ply
from diffuphy.render.sh import from_rgb
from diffuphy.text2gs.shapes import Library
from diffuphy.types import Gaussians, Look

BUN, BETWEEN = 1, 2
"""Labels."""


def write_burger(file: Path, balls: int = 12000) -> None:
    """The burger of the library as a scene, and a label for every Gaussian of it."""
    burger = Library().object(Look("burger", ""))
    x, rgb = burger.surface(balls, torch.Generator().manual_seed(0))
    bread = [k for k, part in enumerate(burger.parts) if part.name in ("bun", "sesame")]
    label = torch.where(torch.isin(burger.part_of(x), torch.tensor(bread)), BUN, BETWEEN)
    n = len(x)
    file.parent.mkdir(parents=True, exist_ok=True)
    quats = torch.tensor([[1.0, 0, 0, 0]]).repeat(n, 1)
    ply.write(file, Gaussians(x, quats, torch.full((n, 3), 0.02).log(), torch.full((n,), 4.0), from_rgb(rgb)))
    np.save(file.with_name("labels.npy"), label.numpy())


def main(*settings: str) -> Made:
    scene = Path("outputs/examples/burger.ply")
    write_burger(scene)
    labels = (f"gaussians.path={scene}", f"gaussians.labels={scene.with_name('labels.npy')}")
    matter = ("material=labels", f"gaussians.materials={{{BUN}: rubber, {BETWEEN}: honey}}", "film.also=[material]")
    made = diffuphy.film("a burger falling", "gaussians=ply", *labels, *matter, "store=outputs/examples", *settings)
    field = made.result("material")
    for law, weight in zip(field.plastic, field.w_p.T, strict=True):
        print(f"{law}: {weight.mean():.0%} of the particles")
    print(made.folder)
    return made


if __name__ == "__main__":
    main(*sys.argv[1:])
