"""Draw every object of the library from four sides, to look at.

    python benchmarks/library_sheet.py [names...]

Writes docs/images/library.png (or --out) and prints the milliseconds a view takes.
"""

import argparse
import time
from pathlib import Path

import torch
from PIL import Image

from diffuphy.render import orbit
from diffuphy.text2gs.shapes import RECIPES, Library
from diffuphy.types import Look

AZIMUTHS, ELEVATIONS = (30.0, 115.0, -70.0, 10.0), (18.0, 30.0, 5.0, 75.0)
"""Of the four views [degrees]."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=list(RECIPES), help="objects; all by default")
    parser.add_argument("--out", type=Path, default=Path("docs/images/library.png"))
    parser.add_argument("--size", type=int, default=128, help="side of one picture [px]")
    parser.add_argument("--columns", type=int, default=3, help="objects side by side")
    parser.add_argument("--surface", default="", help="material or colour word over every object")
    parser.add_argument(
        "--variants", action="store_true", help="show the first view of four siblings instead of four views"
    )
    args = parser.parse_args()
    torch.set_num_threads(1)
    camera, library = (
        orbit(AZIMUTHS, torch.tensor(ELEVATIONS), 5.2, fov=34.0, width=args.size, height=args.size),
        Library(),
    )
    cells = []
    for name in args.names:
        look = Look(subject=name, text="", surface=args.surface)
        library.object(look, 0).render(camera[:1], 1)  # compile and measure the extent first
        start = time.process_time()
        if args.variants:
            views = [library.object(look, v).render(camera[:1]) for v in range(4)]
            rgb, alpha = (torch.cat(t) for t in zip(*views, strict=True))
        else:
            rgb, alpha = library.object(look, 0).render(camera)
        milliseconds = (time.process_time() - start) / 4 * 1e3
        print(f"{name:12s} {len(library.object(look, 0).primitives):4d} primitives {milliseconds:7.1f} ms a view")
        cells.append(torch.cat(list(rgb + (1 - alpha[..., None])), 1))
    cells += [torch.ones_like(cells[0])] * (-len(cells) % args.columns)
    rows = [torch.cat(cells[i : i + args.columns], 1) for i in range(0, len(cells), args.columns)]
    args.out.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray((torch.cat(rows) * 255).round().byte().numpy()).save(args.out)


if __name__ == "__main__":
    main()
