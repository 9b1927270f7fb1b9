"""What a step of video score distillation keeps and takes, frame by frame against as one graph.

    python -m benchmarks video_memory                        # 4, 8, 16, 32 frames
    python -m benchmarks video_memory --frames 4 8 --repeat 1

A burger of 4000 Gaussians on 1500 particles falls; the step goes from positions and deformations of its frames to
pixels, latents, the prior's score, and back. Priors: the embedded one, and a ModelScope of the real classes with random
weights and few channels, so that its *ratios* mean something and its megabytes do not; those of the full-size
autoencoder are counted on torch's meta device, which computes nothing. Writes docs/benchmarks/video_memory.*.
"""

import argparse
import contextlib
import ctypes
import gc
import importlib.util
import json
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from benchmarks._draw import Curve, Plot, plots
from benchmarks.identify.takes import dressed
from benchmarks.speed.body import describe
from diffuphy.learning.probe import Probe, table_field
from diffuphy.losses.guidance.analytic import Analytic, Variants
from diffuphy.losses.guidance.modelscope import ModelScope
from diffuphy.losses.sds import sds
from diffuphy.losses.takes import Take
from diffuphy.losses.video import video_sds
from diffuphy.mpm.sampling.sample import Sample
from diffuphy.types import Motion
from diffuphy.workspace import Workspace

ROOT = Path(__file__).parents[1]
MB = 1e6
Row = dict[str, Any]
Step = Callable[[tuple[Tensor, ...]], Tensor]


# ---------------------------------------------------------------------- what is kept
class Saved:
    """Bytes of the tensors that graphs keep for their backward pass, each storage counted once."""

    def __init__(self, weights: Iterable[Tensor]) -> None:
        self.now, self.peak = 0, 0
        self._weights = {w.untyped_storage()._cdata for w in weights}
        self._uses: dict[int, int] = {}

    def keep(self, tensor: Tensor) -> "_Kept":
        return _Kept(self, tensor)

    def use(self, tensor: Tensor, change: int) -> None:
        """One node more or less keeps a tensor."""
        storage = tensor.untyped_storage()
        key = storage._cdata
        if key in self._weights:
            return
        before = self._uses.get(key, 0)
        self._uses[key] = before + change
        self.now += storage.nbytes() * (bool(before + change) - bool(before))
        self.peak = max(self.peak, self.now)


class _Kept:
    """A saved tensor; counted until its node lets it go."""

    def __init__(self, saved: Saved, tensor: Tensor):
        self.saved, self.tensor = saved, tensor
        saved.use(tensor, 1)

    def __del__(self) -> None:
        self.saved.use(self.tensor, -1)


@contextlib.contextmanager
def saved_activations(weights: Iterable[Tensor] = ()) -> Iterator[Saved]:
    """Watch what graphs keep inside the block, forward and backward, on a CPU; ``weights`` are there anyway."""
    saved = Saved(weights)
    with torch.autograd.graph.saved_tensors_hooks(saved.keep, lambda kept: kept.tensor):
        yield saved


def resident(what: str) -> float | None:
    """``VmRSS`` or ``VmHWM`` of this process [MB]; None where the system does not tell."""
    with contextlib.suppress(OSError), open("/proc/self/status", encoding="ascii") as status:
        return next(float(line.split()[1]) * 1024 / MB for line in status if line.startswith(what))
    return None


def growth(run: Callable[[], object]) -> float | None:
    """Most memory that the process has while ``run`` runs, over what it had before [MB]. Sees what hooks do not: what
    nodes hold beside saved tensors, and what is made on the way."""
    gc.collect()
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL("libc.so.6").malloc_trim(0)
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")  # the high-water mark starts again
    before = resident("VmRSS")
    run()
    after = resident("VmHWM")
    return None if before is None or after is None else after - before


# ---------------------------------------------------------------------- what is run
class OneGraph(ModelScope):
    """Frames encoded alone, in one graph."""

    def encode(self, sample: Tensor) -> Tensor:
        return torch.cat([self.latents(frame[None]) for frame in sample[0]]).movedim(0, 1)[None]

    def latents(self, frames: Tensor) -> Tensor:
        """z of frames (n, H, W, 3) in one batch, shape (n, 4, h, w)."""
        vae = self.networks(frames.device).vae
        return (
            vae.encode(2 * frames.permute(0, 3, 1, 2).contiguous() - 1).latent_dist.mode() * vae.config.scaling_factor
        )


class OneBatch(OneGraph):
    """All frames in one batch."""

    def encode(self, sample: Tensor) -> Tensor:
        return self.latents(sample[0]).movedim(0, 1)[None]


def tiny_modelscope(folder: Path) -> Path:
    """Random weights of the real classes, as the tests make them."""
    spec = importlib.util.spec_from_file_location("tiny_models", ROOT / "tests" / "tiny_models.py")
    assert spec is not None and spec.loader is not None
    tiny_models = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tiny_models)
    return tiny_models.modelscope(folder)


def steps(prior: str, frames: int, folder: Path) -> tuple[dict[str, Step], tuple[Tensor, ...], list[Tensor]]:
    """Each way to make the step, a function of the operands; the operands; the weights of the autoencoders."""
    look, gaussians = dressed("burger", count=4000)
    motion = Motion("falling", "a jelly burger falling", {"": "jelly"})
    particles = Sample()(gaussians, motion, work=Workspace())
    probe = Probe(frames=frames, image=64 if prior == "embedded" else 128)
    bench = probe.bench(gaussians, particles, motion.size)
    with torch.no_grad():
        drop = bench.simulate(table_field(None, look, motion, bench.draft))
        film = bench.film(drop)
    draw, t, g = bench.drawing(Take.whole(frames)), torch.tensor([0.5]), torch.Generator().manual_seed(0)

    def as_one(guidance: Any, cond: Any, noise: Tensor) -> Step:
        return lambda rows: sds(
            guidance, torch.stack([draw(x, F) for x, F in zip(*rows, strict=True)])[None], cond, t=t, noise=noise
        )

    def by_frames(guidance: Any, cond: Any, noise: Tensor) -> Step:
        return lambda rows: video_sds(guidance, draw, rows, cond, t=t, noise=noise)

    rows = (drop.x[1:].contiguous(), drop.F[1:].contiguous())
    if prior == "embedded":
        guidance, noise = Analytic(layout="clip", s=0.0), torch.randn(1, *film.shape, generator=g)
        cond = Variants(film.flip(0)[None, None])
        return (
            {"one graph": as_one(guidance, cond, noise), "frame by frame": by_frames(guidance, cond, noise)},
            rows,
            [],
        )
    known: dict[str, Any] = {"model": str(folder), "size": 128, "dtype": "float32", "local_files_only": True}
    guidance = ModelScope(**known)
    cond = guidance.condition(motion, bench.camera, torch.ones(3))
    noise = torch.randn(1, 4, frames, 16, 16, generator=g)
    priors = OneBatch(**known), OneGraph(**known), guidance
    ways = {
        "one graph, one batch": as_one(priors[0], cond, noise),
        "one graph": as_one(priors[1], cond, noise),
        "frame by frame": by_frames(guidance, cond, noise),
    }
    return ways, rows, [w for p in priors for w in p.networks(film.device).vae.parameters()]


def measure(prior: str, frames: int, folder: Path, repeat: int) -> list[Row]:
    """A row for each way: what is saved, how much the process grows, processor time, and how far gradients differ."""
    ways, operands, weights = steps(prior, frames, folder)
    gradients: dict[str, list[Tensor]] = {}
    rows: list[Row] = []

    def step(name: str) -> None:
        leaves = tuple(o.clone().requires_grad_() for o in operands)
        ways[name](leaves).backward()
        gradients[name] = [leaf.grad for leaf in leaves if leaf.grad is not None]

    for name in reversed(ways):  # the leanest first: it must not find memory that another has left
        step(name)  # loads weights and kernels
        grown = growth(lambda name=name: step(name))
        with saved_activations(weights) as saved:
            step(name)
        seconds = []
        for _ in range(repeat):
            start = time.process_time()
            step(name)
            seconds.append(time.process_time() - start)
        row = {"prior": prior, "frames": frames, "way": name, "saved": saved.peak / MB, "grown": grown}
        rows.append(row | {"seconds": sorted(seconds)[repeat // 2]})
    whole = gradients["one graph"]
    for row in rows:
        pairs = zip(gradients[row["way"]], whole, strict=True)
        row["differs"] = max(float((a - b).norm() / b.norm()) for a, b in pairs)
        print(json.dumps(row), flush=True)
    return rows


def full_size(side: int = 256) -> float:
    """What the encoder of Stable Diffusion's and ModelScope's autoencoder saves of one frame in float32 [MB]."""
    from diffusers import AutoencoderKL

    channels = [128, 256, 512, 512]
    with torch.device("meta"):
        vae = AutoencoderKL(
            block_out_channels=channels,
            down_block_types=["DownEncoderBlock2D"] * 4,
            up_block_types=["UpDecoderBlock2D"] * 4,
            latent_channels=4,
            layers_per_block=2,
        ).requires_grad_(False)
        frame = torch.empty(1, 3, side, side, requires_grad=True)
        with saved_activations(vae.parameters()) as saved:
            vae.encode(frame, return_dict=False)
    return saved.peak / MB


# ---------------------------------------------------------------------- page
def page(results: dict[str, Any]) -> str:
    """Tables, and what they say of 16 frames."""
    rows: list[Row] = results["rows"]
    text = f"# Memory of video score distillation\n\n{results['machine']}.\n\n"
    text += "![Saved activations by frames](video_memory.png)\n\n"
    text += (
        "*saved*: most bytes of tensors that graphs keep at a time, each storage once, no weights;\n"
        "*process*: most resident memory over that before the step; *time*: of one thread, median; *differs*: norm of\n"
        "the difference of the gradient with respect to positions or deformations, over that of one graph.\n\n"
        "| prior | frames | way | saved [MB] | process [MB] | time [s] | differs |\n|---|--:|---|--:|--:|--:|--:|\n"
    )
    for r in rows:
        grown = "" if r["grown"] is None else f"{r['grown']:.1f}"
        text += f"| {r['prior']} | {r['frames']} | {r['way']} | {r['saved']:.2f} | {grown} "
        text += f"| {r['seconds']:.2f} | {r['differs']:.1e} |\n"
    one = results["full_size"]
    text += (
        f"\nThe encoder of the full-size autoencoder saves {one:.0f} MB of a frame of 256 px in float32 (counted on\n"
        f"the meta device): one graph of 16 keeps {16 * one / 1e3:.1f} GB, frame by frame {one / 1e3:.2f} GB.\n\n"
        "To measure again: `python -m benchmarks video_memory`.\n"
    )
    return text


def draw(path: Path, rows: Sequence[Row]) -> None:
    priors, ways = (list(dict.fromkeys(r[k] for r in rows)) for k in ("prior", "way"))

    def curves(prior: str, what: str) -> list[Curve]:
        return [
            Curve(way, [(r["frames"], r[what] or 0.0) for r in rows if (r["prior"], r["way"]) == (prior, way)], k)
            for k, way in enumerate(ways)
            if any((r["prior"], r["way"]) == (prior, way) for r in rows)
        ]

    words = {"saved": "saved tensors [MB]", "grown": "process grows by [MB]"}
    several = [Plot(f"{p}: {words[w]}", "frames", "MB", curves(p, w)) for p in priors for w in words]
    plots(path, "A step of video score distillation", several)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, nargs="+", default=[4, 8, 16, 32])
    parser.add_argument("--repeat", type=int, default=3, help="times each step is timed")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "benchmarks")
    options = parser.parse_args()
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as models:
        folder = tiny_modelscope(Path(models) / "modelscope")
        rows = [
            row
            for prior in ("embedded", "tiny ModelScope")
            for frames in options.frames
            for row in measure(prior, frames, folder, options.repeat)
        ]
    results = {"machine": describe(), "rows": rows, "full_size": full_size()}
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "video_memory.json").write_text(json.dumps(results, indent=1))
    (options.out / "video_memory.md").write_text(page(results), encoding="utf-8")
    draw(options.out / "video_memory.png", rows)


if __name__ == "__main__":
    main()
