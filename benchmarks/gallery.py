"""Films of the README, three moments each: docs/images/gallery/*.png, and all together docs/images/gallery.png.

    python -m benchmarks gallery                     # all; what is in the store is not computed again
    python -m benchmarks gallery burger sway

What a film is made with is the command under its picture; estimates and scores are left out, they change nothing in it.
"""

import argparse
import importlib.util
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import torch
from PIL import Image, ImageDraw, ImageFont

ROOT = Path(__file__).resolve().parents[1]
SIDE = 176
"""Height of a picture [px]."""
ACROSS = 2
"""Strips side by side in the sheet."""


@dataclass(frozen=True)
class Film:
    """A film by the command line."""

    name: str
    caption: str
    prompt: str
    settings: tuple[str, ...] = ()
    moments: tuple[float, ...] = (0.0, 0.5, 1.5)
    """Times that are shown [s]."""
    file: tuple[str, str, str] | None = None
    """An example, the function of it that writes the file that the film needs, and that file."""

    @property
    def command(self) -> str:
        """What a reader can type; the example, where it brings the file."""
        if self.file is not None:
            return f"python examples/{self.file[0]}.py experiment=fast"
        given = [f'prompt="{self.prompt}"', *(shlex.quote(s) for s in self.settings), "experiment=fast"]
        return " ".join(["python train.py", *given])

    def strip(self, store: Path, settings: Sequence[str]) -> Image.Image:
        import diffuphy

        if self.file is not None:
            script, function, path = self.file
            getattr(example(script), function)(ROOT / path)
        quiet = ("report.error=off", "evaluate.score=off", f"store={store}")
        clip = diffuphy.film(self.prompt, *self.settings, *settings, *quiet).result("clip")
        chosen = [min(round(t * clip.fps), len(clip.rgb) - 1) for t in self.moments]
        return beside([picture(clip.rgb[t]) for t in chosen])


@dataclass(frozen=True)
class Example:
    """What an example films, by its contact sheet."""

    name: str
    caption: str
    panels: tuple[int, ...] = (0, 3, 7)
    """Pictures of the sheet, four in a row."""

    @property
    def command(self) -> str:
        return f"python examples/{self.name}.py"

    def strip(self, store: Path, settings: Sequence[str]) -> Image.Image:
        """``settings`` are those of ``train.py``, which an example of the simulator has not."""
        out = store / "gallery"
        sheet_file = out / f"{self.name}.png"
        if not sheet_file.exists():
            example(self.name).main(out=str(out))
        sheet = Image.open(sheet_file)
        w, h = sheet.width // 4, sheet.height // 2
        corners = [(k % 4 * w, k // 4 * h) for k in self.panels]
        return beside([square(sheet.crop((x, y, x + w, y + h))) for x, y in corners])


DUCK = "gaussians.region=[-1.02,1.02,-1.02,1.02,-0.995,1.2]"
WRITTEN = ("duck.ply", "knot.glb", "sway.json", "burger.ply", "labels.npy")
SCENE, KNOT, SWAY, BURGER, LABELS = (f"outputs/examples/{name}" for name in WRITTEN)
FILMS: tuple[Film | Example, ...] = (
    Film("burger", "a rubber burger falls", "a rubber burger falling", moments=(0.0, 0.3, 1.5)),
    Film("castle", "a castle of sand collapses", "a sand castle collapsing", moments=(0.0, 0.2, 1.0)),
    Film("pancakes", "pancakes melt", "pancakes melting", moments=(0.0, 0.4, 1.5)),
    Film("jelly", "a jelly bounces, on a turntable", "a jelly bouncing", ("camera=turntable",), (0.2, 0.43, 0.63)),
    Film("cake", "a jelly cake is poked: stress", "a jelly cake poked", ("film.view=stress",), (0.2, 0.43, 0.63)),
    Film("mixed", "rubber buns, honey between them", "a burger falling",
         ("gaussians=ply", f"gaussians.path={BURGER}", f"gaussians.labels={LABELS}", "material=labels",
          "gaussians.materials={1: rubber, 2: honey}"), (0.0, 0.43, 1.5), ("two_materials", "write_burger", BURGER)),
    Film("snowman", "a snowman of snow falls", "a snow snowman falling", moments=(0.2, 0.33, 1.5)),
    Film("duck", "a thing of one's own scene is squashed, the rest stands around", "a 30 cm clay duck squashed",
         ("gaussians=ply", f"gaussians.path={SCENE}", DUCK, "film.floor=false"), (0.0, 0.7, 1.5),
         ("own_scene", "write_duck", SCENE)),
    Film("knot", "a mesh, in a stated material", "a rubber knot bouncing",
         ("gaussians=mesh", f"gaussians.path={KNOT}", "material=stated"), (0.2, 0.5, 0.63),
         ("mesh", "write_knot", KNOT)),
    Film("sway", "a scene file of PhysGaussian", "a cactus falling",
         ("scene=physgaussian", f"scene.file={SWAY}", "scene.particles=10000"), (0.0, 0.2, 0.64),
         ("physgaussian_scene", "write_sway", SWAY)),
    Example("moving_walls", "a pin rolls over dough", (1, 4, 7)),
    Example("sand_column", "a column of sand, in layers", (0, 1, 7)),
)  # fmt: skip


def example(name: str) -> ModuleType:
    """An example as a module."""
    spec = importlib.util.spec_from_file_location(f"example_{name}", ROOT / "examples" / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def picture(rgb: torch.Tensor) -> Image.Image:
    """A frame (H, W, 3) in [0, 1], square and ``SIDE`` high."""
    return square(Image.fromarray((rgb * 255).round().byte().cpu().numpy()))


def square(image: Image.Image) -> Image.Image:
    side, (w, h) = min(image.size), image.size
    box = ((w - side) // 2, (h - side) // 2, (w + side) // 2, (h + side) // 2)
    return image.convert("RGB").crop(box).resize((SIDE, SIDE), Image.Resampling.LANCZOS)


def beside(images: Sequence[Image.Image], gap: int = 2) -> Image.Image:
    strip = Image.new("RGB", (len(images) * (SIDE + gap) - gap, SIDE), "white")
    for k, image in enumerate(images):
        strip.paste(image, (k * (SIDE + gap), 0))
    return strip


def sheet(strips: Sequence[tuple[str, Image.Image]], gap: int = 14, text: int = 24) -> Image.Image:
    """All strips with their captions above them."""
    w, rows = strips[0][1].width, -(-len(strips) // ACROSS)
    page = Image.new("RGB", (ACROSS * (w + gap) + gap, rows * (SIDE + text + gap) + gap), "white")
    draw, font = ImageDraw.Draw(page), ImageFont.load_default(15)
    for k, (caption, strip) in enumerate(strips):
        x, y = gap + k % ACROSS * (w + gap), gap + k // ACROSS * (SIDE + text + gap)
        draw.text((x, y + text / 2), caption, fill="#222222", font=font, anchor="lm")
        page.paste(strip, (x, y + text))
    return page


def write(path: Path, image: Image.Image) -> None:
    """As a PNG of 256 colours: a third of the bytes, and no difference that one sees at this size."""
    path.parent.mkdir(parents=True, exist_ok=True)
    image.quantize(256, Image.Quantize.MEDIANCUT, dither=Image.Dither.FLOYDSTEINBERG).save(path, optimize=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", default=[], help="films; all, and the sheet, by default")
    parser.add_argument("--store", type=Path, default=Path("outputs"))
    parser.add_argument("--settings", nargs="*", default=["experiment=fast"], help="of every film")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images")
    options = parser.parse_args()
    if unknown := set(options.names) - {f.name for f in FILMS}:
        parser.error(f"no film is called {', '.join(sorted(unknown))}; there are {', '.join(f.name for f in FILMS)}")
    folder = options.out / "gallery"
    for film in (f for f in FILMS if not options.names or f.name in options.names):
        write(folder / f"{film.name}.png", film.strip(options.store, options.settings))
        print(f"{film.name}: {film.command}", flush=True)
    if all((folder / f"{f.name}.png").exists() for f in FILMS):
        strips = [(f.caption, Image.open(folder / f"{f.name}.png").convert("RGB")) for f in FILMS]
        sheet(strips).save(options.out / "gallery.png", optimize=True)


if __name__ == "__main__":
    main()
