"""Internal filling: the volume of the particles against that of the library's objects.

    python -m benchmarks filling                              # all objects; half a minute of fitting each
    python -m benchmarks filling --objects duck --steps 300
    python -m benchmarks filling --fits outputs/fits          # keeps the fitted Gaussians there, and reads them there

Every object is fitted as a run does it by default, and its Gaussians are sampled as a run does it. The true volume is
counted on a lattice of the object's signed distance, with all that it encloses; the share of it that is a hollow,
closed on all sides, is given beside. "On a mesh" are Gaussians on the object's own surface (``gaussians=mesh``), which
stand out of it. Writes docs/benchmarks/filling.{json,md}.
"""

import argparse
import dataclasses
import json
import tempfile
import time
from pathlib import Path
from typing import Any

import torch
import warp as wp
from warp.geometry import IsoSurfaceMarchingCubes

from diffuphy.losses.guidance.analytic import Analytic
from diffuphy.mpm.sampling.fill import outside
from diffuphy.mpm.sampling.filling import Rays
from diffuphy.mpm.sampling.sample import Sample
from diffuphy.text2gs.cameras import Orbits
from diffuphy.text2gs.fit import FitGaussians
from diffuphy.text2gs.shapes import Library
from diffuphy.text2gs.shapes.catalogue import RECIPES
from diffuphy.text2gs.shapes.shape import Shape, shape
from diffuphy.text2gs.surface import LoadMesh
from diffuphy.types import Gaussians, Look, Motion
from diffuphy.workspace import Workspace

OUT = Path(__file__).parent.parent / "docs" / "benchmarks"

BOX, CELLS = 2.6, 128
"""Side of the cube that holds every object [object units], and cells along it: volumes are right to about 0.3 %."""


def volume(body: Shape) -> tuple[float, float]:
    """Volume of an object with all that it encloses [object units³], and the share of it that is hollow."""
    at = (torch.arange(CELLS) + 0.5) / CELLS * BOX - BOX / 2
    solid = (body.sdf(torch.cartesian_prod(at, at, at))[0] < 0).reshape(CELLS, CELLS, CELLS)
    whole = int((~outside(solid, 0)).sum())
    return whole * (BOX / CELLS) ** 3, 1 - int(solid.sum()) / whole


def fitted(name: str, steps: int, fits: Path | None) -> tuple[Gaussians, float]:
    """Gaussians of the object, and the pixel they were fitted with."""
    cameras = Orbits()
    fit = FitGaussians(Analytic(Library()), cameras, steps=steps)
    if fits is not None and (fits / name / "result.json").exists():
        return Gaussians.load(fits / name), cameras.pixel
    gaussians = fit(Look(name, f"a {name}"))
    if fits is not None:
        (fits / name).mkdir(parents=True, exist_ok=True)
        gaussians.save(fits / name)
    return gaussians, cameras.pixel


def on_mesh(body: Shape) -> tuple[Gaussians, float]:
    """Gaussians on the surface of an object, as ``gaussians=mesh`` makes them, and their units over the object's."""
    import trimesh

    line = torch.linspace(-BOX / 2, BOX / 2, CELLS + 1)
    sdf = body.sdf(torch.cartesian_prod(line, line, line))[0].reshape(CELLS + 1, CELLS + 1, CELLS + 1)
    corner = wp.vec3(BOX / 2, BOX / 2, BOX / 2)
    vertices, faces = IsoSurfaceMarchingCubes.extract(
        wp.from_torch(sdf.float().contiguous()), 0.0, lower=-corner, upper=corner
    )
    mesh = trimesh.Trimesh(vertices.numpy(), faces.numpy().reshape(-1, 3))
    with tempfile.TemporaryDirectory() as scratch:
        file = Path(scratch) / "object.ply"
        mesh.export(file)
        gaussians = LoadMesh(path=str(file), up="z_up")(Look("object", "an object"))
    return gaussians, 2.0 / float(mesh.extents.max())


def measure(name: str, steps: int, fits: Path | None) -> dict[str, Any]:
    """One row."""
    true, hollow = volume(shape(RECIPES[name]))
    gaussians, pixel = fitted(name, steps, fits)
    sample = Sample(pixel=pixel, max_particles=10**6)

    def error(**settings: Any) -> tuple[float, int, float]:
        start = time.perf_counter()
        p = dataclasses.replace(sample, **settings)(gaussians, Motion("falling", ""), work=Workspace())
        seconds = time.perf_counter() - start
        return 100 * (float(p.vol.double().sum()) / p.scale**3 / true - 1), int((p.gaussian < 0).sum()), seconds

    flood, filler, seconds = error()
    meshed, unit = on_mesh(shape(RECIPES[name]))
    p = Sample(max_particles=10**6, pixel=0.0)(meshed, Motion("falling", ""), work=Workspace())
    return {
        "object": name,
        "volume": true,
        "hollow_%": 100 * hollow,
        "flood_%": flood,
        "rays_%": error(filling=Rays())[0],
        "shell_alone_%": error(filling=None)[0],
        "threshold_0.35_%": error(threshold=0.35)[0],
        "threshold_0.7_%": error(threshold=0.7)[0],
        "pixel_0_%": error(pixel=0.0)[0],
        "12000_particles_%": error(max_particles=12_000)[0],
        "on_a_mesh_%": 100 * (float(p.vol.double().sum()) / p.scale**3 / unit**3 / true - 1),
        "carry_none": filler,
        "seconds": seconds,
    }


def table(rows: list[dict[str, Any]]) -> str:
    columns = list(rows[0])
    lines = ["| " + " | ".join(c.replace("_", " ") for c in columns) + " |", "|" + "---|" * len(columns)]
    for row in rows:
        cells = [f"{v:+.1f}" if c.endswith("%") and c != "hollow_%" else f"{v:.3g}" if isinstance(v, float) else str(v)
                 for c, v in row.items()]  # fmt: skip
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def words(rows: list[dict[str, Any]]) -> str:
    """What the table says."""
    worst = max(rows, key=lambda r: abs(r["flood_%"]))
    mean = sum(abs(r["flood_%"]) for r in rows) / len(rows)
    return (
        f"Flood fill: {sum(abs(r['flood_%']) <= 5 for r in rows)} of {len(rows)} objects within 5 %, {mean:.1f} % in "
        f"the mean, {worst['flood_%']:+.1f} % at worst ({worst['object']}).\n"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--objects", nargs="+", default=sorted(RECIPES))
    parser.add_argument("--steps", type=int, default=FitGaussians.steps)
    parser.add_argument("--fits", type=Path)
    parser.add_argument("--out", type=Path, default=OUT)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    arguments.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for name in arguments.objects:
        rows.append(measure(name, arguments.steps, arguments.fits))
        print(table(rows[-1:]).splitlines()[-1], flush=True)
    made = {"torch": torch.__version__, "steps": arguments.steps, "rows": rows}
    (arguments.out / "filling.json").write_text(json.dumps(made, indent=1))
    page = arguments.out / "filling.md"
    text = page.read_text(encoding="utf-8") if page.exists() else f"# Filling\n\n{__doc__}\n<!-- table -->\n"
    head, mark, _ = text.partition("<!-- table -->")
    page.write_text(f"{head}{mark}\n{words(rows)}\n{table(rows)}", encoding="utf-8")


if __name__ == "__main__":
    main()
