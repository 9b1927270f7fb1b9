"""Masked pre-training of the material encoder on the procedural library, and whether it helps.

    python -m benchmarks pretrain train                     # a few minutes of one core; goes on where it was killed
    python -m benchmarks pretrain measure                   # fits with and without, docs/benchmarks/pretrain.*
    python train.py prompt=... material.net.pretrained=outputs/pretrain/encoder.safetensors

A masked autoencoder of points (Point-MAE, Pang et al. 2022): of each object 60 % of the patches are hidden, the encoder
sees the others, and a head that is thrown away afterwards says from tokens and places what the hidden ones look like.
"""

import argparse
import dataclasses
import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from benchmarks.identify.takes import dressed
from benchmarks.speed.body import describe
from diffuphy.learning.appearance import appearance
from diffuphy.learning.descent import descend
from diffuphy.learning.fit_material import FitMaterial
from diffuphy.learning.probe import Probe
from diffuphy.learning.scan import region_values, scan
from diffuphy.losses.guidance.analytic import Analytic
from diffuphy.material import presets
from diffuphy.material.encoder import N_FEATURES, Block, Encoder
from diffuphy.material.expert import Param
from diffuphy.material.net import Net
from diffuphy.mpm.sampling.coarse import coarsen
from diffuphy.mpm.sampling.sample import Sample
from diffuphy.text2gs.shapes import RECIPES, Library
from diffuphy.types import Gaussians, Look, Motion, Particles
from diffuphy.workspace import Workspace

OUT = Path(__file__).parents[1] / "docs" / "benchmarks"
FOLDER = Path("outputs") / "pretrain"
HELD_OUT = ("burger", "mushroom")
"""Objects that pre-training never sees."""
TRIALS = (("burger", "patty"), ("mushroom", "stalk"), ("ice cream", "cone"))
"""Objects that are fitted, and the part of each that is of another material."""
STIFF, SOFT = "rubber", "jelly"
"""4e5 and 3e4 Pa, both elastic: what differs between the parts is one number."""
GRID = (4.0, 4.7, 5.4, 6.1)
"""log10 E [Pa] of the scan, for each of two regions."""
CELLS = 16
"""Grid cells along an object: about 2000 particles, of which a draft keeps some."""
Groups = tuple[Tensor, Tensor]
"""Patches (S, G, M, C) and their centres (S, G, 3) of S bodies."""


# ---------------------------------------------------------------------- what is looked at
def body(subject: str, size: float = 0.5, seed: int = 0) -> tuple[Look, Gaussians, Particles]:
    """An object of the library, filled."""
    look, gaussians = dressed(subject, count=2000, seed=seed)
    gaussians = flattened(gaussians, Library().object(look).look(gaussians.means)[0], seed)
    motion = Motion("falling", "", {"": "rubber"}, size)
    return look, gaussians, Sample(cells=CELLS)(gaussians, motion, work=Workspace(progress=False))


def flattened(gaussians: Gaussians, normals: Tensor, seed: int) -> Gaussians:
    """Discs on the surface, as a fit to pictures leaves them, each of its own size and thickness."""
    n = normals * torch.where(normals[:, 2:] < 0, -1.0, 1.0)  # a disc has no front
    quats = torch.stack([1 + n[:, 2], -n[:, 1], n[:, 0], torch.zeros(len(n))], 1)
    generator = torch.Generator().manual_seed(seed)
    drawn = torch.randn(len(n), 3, generator=generator)
    log_scales = gaussians.log_scales + 0.3 * drawn + torch.tensor([0.0, 0.0, -1.0])
    return dataclasses.replace(gaussians, quats=quats / quats.norm(dim=1, keepdim=True), log_scales=log_scales)


def seen(gaussians: Gaussians, particles: Particles, n: int, seed: int) -> Groups:
    """What the encoder is shown of a draft of n particles: the patches that the network itself makes of it."""
    draft, _ = coarsen(particles, n=n, seed=seed)
    start = presets.field([presets.lookup("rubber")], torch.zeros(len(draft), dtype=torch.long))
    net = Net().build(appearance(gaussians, draft), start, [Param("E", "Pa", 1e3, 1e7, True, 1e5)])
    return net.groups[None], net.centres[None]


def bodies(subjects: Sequence[str], drafts: int, seed: int) -> Groups:
    """Several drafts of each object, of 400 to 1500 particles."""
    found, generator = [], torch.Generator().manual_seed(seed)
    for subject in subjects:
        _, gaussians, particles = body(subject, seed=seed)
        for i in range(drafts):
            n = int(torch.randint(400, 1500, (), generator=generator))
            found.append(seen(gaussians, particles, min(n, len(particles)), seed * drafts + i))
    groups, centres = zip(*found, strict=True)
    return torch.cat(groups), torch.cat(centres)


# ---------------------------------------------------------------------- what is trained
class Masked(nn.Module):
    """Encoder of the patches that are shown, and a head that says what the hidden ones look like."""

    def __init__(self, net: Net, seed: int, hidden: float = 0.6):
        super().__init__()
        self.members, self.hidden = net.group_size, round(hidden * net.groups)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.encoder = Encoder(3 + N_FEATURES, net.width, net.depth, net.heads)
            self.position = nn.Sequential(nn.Linear(3, net.width), nn.GELU(), nn.Linear(net.width, net.width))
            self.blank = nn.Parameter(0.02 * torch.randn(net.width))
            self.block = Block(net.width, net.heads)
            self.says = nn.Linear(net.width, 3 * self.members + 2 * N_FEATURES)

    def told(self, groups: Tensor, centres: Tensor, order: Tensor) -> Tensor:
        """What is said of the hidden patches, their places and the shown patches being known, shape (B, hidden,
        3 M + 22)."""
        row = torch.arange(len(groups))[:, None]
        show = order[:, self.hidden :]
        tokens = torch.vmap(self.encoder)(groups[row, show], centres[row, show])
        blank = self.blank.expand(len(groups), self.hidden, -1)
        mixed = torch.vmap(self.block)(torch.cat([blank, tokens], 1) + self.position(centres[row, order]))
        return self.says(mixed[:, : self.hidden])

    def forward(self, groups: Tensor, centres: Tensor, order: Tensor) -> Tensor:
        """Loss of each body: Chamfer distance of the hidden patches' points, and the squared error of what their
        features are, mean and spread.

            L = ½ [mean_a min_b |a − b|² + mean_b min_a |a − b|²] + (|μ − μ̂|² + |s − ŝ|²)/11

        Args:
            groups: (B, G, M, C). centres: (B, G, 3). order: a permutation of the patches of each body, shape (B, G);
                its first ``hidden`` are hidden.
        """
        truth = groups[torch.arange(len(groups))[:, None], order[:, : self.hidden]]
        points, looks = self.told(groups, centres, order).split([3 * self.members, 2 * N_FEATURES], -1)
        apart = torch.cdist(points.unflatten(-1, (self.members, 3)), truth[..., :3]).square()
        chamfer = (apart.amin(-1).mean(-1) + apart.amin(-2).mean(-1)) / 2
        f = truth[..., 3:]
        wanted = torch.cat([f.mean(-2), f.std(-2, correction=0)], -1)
        return (chamfer + 2 * (looks - wanted).square().mean(-1)).mean(-1)


def shuffled(bodies: int, groups: int, generator: torch.Generator) -> Tensor:
    """A permutation for each body."""
    return torch.rand(bodies, groups, generator=generator).argsort(1)


@dataclass(frozen=True)
class Pretraining:
    """Settings of ``train``."""

    steps: int = 400
    """Optimiser steps."""
    batch: int = 12
    """Bodies of a step."""
    lr: float = 1e-3
    """AdamW's, four percent of the steps up, then a half cosine down (Point-MAE)."""
    drafts: int = 4
    """Drafts of each object."""
    seed: int = 0

    def rate(self, step: int) -> float:
        """Learning rate of a step."""
        warm = max(1, self.steps // 25)
        wave = 0.5 * (1 + torch.cos(torch.tensor(torch.pi * step / self.steps)).item())
        return self.lr * min(1.0, (step + 1) / warm) * wave

    def __call__(self, seen: Groups, work: Workspace) -> Masked:
        """Train on these bodies; goes on from the checkpoint of ``work``, to the same bits."""
        model, generator = Masked(Net(), self.seed), torch.Generator().manual_seed(self.seed)
        optimiser = torch.optim.AdamW(model.parameters(), lr=self.lr, weight_decay=0.05)
        first = 0
        if state := work.load():
            first = state["step"]
            model.load_state_dict(state["model"])
            optimiser.load_state_dict(state["optimiser"])
            generator.set_state(state["rng"])
        for step in range(first, self.steps):
            for group in optimiser.param_groups:
                group["lr"] = self.rate(step)
            pick = torch.randint(len(seen[0]), (self.batch,), generator=generator)
            groups, centres = (part[pick] for part in seen)
            loss = model(groups, centres, shuffled(self.batch, groups.shape[1], generator)).mean()
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(model.parameters(), 1.0)
            optimiser.step()
            if step % 50 == 0:
                work.log(step, loss=loss.item())
            if work.due():
                work.save({"step": step + 1, "model": model.state_dict(), "optimiser": optimiser.state_dict(),
                           "rng": generator.get_state()})  # fmt: skip
        return model


def train(settings: Pretraining, folder: Path) -> dict[str, Any]:
    """Pre-train, write ``encoder.safetensors`` at half precision, and say how well hidden patches are told: of objects
    that were seen, and of those that were not, beside what the mean over all patches would give."""
    from safetensors.torch import save_file

    begin = time.process_time()
    shown = bodies([n for n in RECIPES if n not in HELD_OUT], settings.drafts, settings.seed)
    others = bodies(HELD_OUT, 4, settings.seed + 1)
    made = time.process_time() - begin
    model = settings(shown, Workspace(folder, progress=False))
    file = folder / "encoder.safetensors"
    save_file({k: v.half().contiguous() for k, v in model.encoder.state_dict().items()}, file)
    numbers = {"bodies": len(shown[0]), "bytes": file.stat().st_size, "seconds_bodies": made}
    numbers["seconds"] = time.process_time() - begin
    untrained = Masked(Net(), settings.seed)
    for name, part in (("seen", shown), ("held out", others)):
        order = shuffled(len(part[0]), part[0].shape[1], torch.Generator().manual_seed(7))
        with torch.no_grad():
            numbers[name] = [float(m(*part, order).mean()) for m in (untrained, model)]
    (folder / "train.json").write_text(json.dumps(numbers, indent=1))
    return numbers


# ---------------------------------------------------------------------- does it help
def trial(subject: str, part: str, seed: int, file: str, *, scanned: bool, steps: int) -> list[dict[str, Any]]:
    """Two fits of a body of two stiffnesses, without and with: clip loss of the best hardened field, and the error.

    Without a scan the stiffness of all particles begins at the geometric mean, and the network has to find the part
    that is softer; with one, the regions are scanned jointly and the training begins at the best. Body, clip, start and
    noise are those of both fits, and so are the weights of the decoder.
    """
    look, gaussians, particles = body(subject, seed=100 + seed)
    motion = Motion("falling", "it falls", {"": STIFF, part: SOFT}, 0.5)
    truth = torch.tensor([presets.lookup(w).E for w in (STIFF, SOFT)]).log10()
    stage = FitMaterial(
        guidance=Analytic(layout="clip", s=0.0), library=Library(), net=Net(seed=seed), seed=seed, steps=steps,
        elastic=("neo_hookean",), plastic=("identity",), probe=Probe(particles=400, image=32, frames=8, seed=2 * seed),
        regions=2 if scanned else 1, stiffness_steps=0, start=float(truth.mean()), patience=0, curriculum=(8,),
    )  # fmt: skip
    case, work = stage.case(look, motion, gaussians, particles), Workspace(progress=False)
    start = [
        {"elastic": r["elastic"], "plastic": "identity", "theta": r["theta"] | {"E": 10**stage.start}, "rho": r["rho"]}
        for r in region_values(case.table, case.labels)
    ]
    if scanned:
        start = scan(case, GRID, frames=8, weight=stage.weight, work=work)[0]
    rows, wanted = [], case.table.theta["E"].log10()
    for pretrained in (None, file):
        stage = dataclasses.replace(stage, net=dataclasses.replace(stage.net, pretrained=pretrained))
        model, begin = stage.model(case, start), time.process_time()
        run = descend(case, model, stage.descent(), work)
        with torch.no_grad():
            error = float((model().theta["E"].log10() - wanted).square().mean().sqrt())
        rows.append({"object": subject, "seed": seed, "scanned": scanned, "pretrained": pretrained is not None,
                     "loss": run.score, "error": error, "seconds": time.process_time() - begin})  # fmt: skip
    return rows


def pairs(rows: Sequence[dict[str, Any]], key: str) -> Tensor:
    """ln(with / without) of each fit that was made both ways."""
    found = {(r["object"], r["seed"], r["scanned"], r["pretrained"]): r[key] for r in rows}
    change = [found[*k, True] / found[*k, False] for k in sorted({k[:3] for k in found})]
    return torch.tensor(change, dtype=torch.float64).log()


def page(result: dict[str, Any]) -> str:
    """What pre-training learnt, and what it changes, with standard errors over the pairs."""
    known, rows = result["train"], result["rows"]
    text = "# Masked pre-training of the encoder\n\n"
    text += f"{result['machine']}. `python -m benchmarks pretrain`. A masked autoencoder of points (Point-MAE, Pang et "
    text += f"al. 2022) sees {known['bodies']} drafts of the library's objects, of each 40 % of the patches, and says "
    text += f"what the others look like; {', '.join(HELD_OUT)} are held out. It took {known['seconds']:.0f} s of "
    text += f"processor time; the encoder is a file of {known['bytes'] / 1e3:.0f} kB at half precision.\n\n"
    text += "| loss of hidden patches | untrained | pre-trained |\n|---|--:|--:|\n"
    for name in ("seen", "held out"):
        text += f"| objects {name} | {known[name][0]:.3f} | {known[name][1]:.3f} |\n"
    text += "\n## Does it help a fit?\n\nBodies of two stiffnesses (rubber, one part jelly), 400 particles, 8 frames "
    text += f"of 32 × 32 px, {result['steps']} steps, the same seeds with and without. Without a scan all particles "
    text += "begin at the geometric mean and the network must find the softer part; with one, training begins at the "
    text += "best of the joint scan. *Clip loss* is of the best hardened field, *error* the root mean square of the "
    text += "error of log₁₀ E over the particles. *Change* is the mean of ln(with / without) ± its standard error over "
    text += "pairs: below zero is better.\n\n"
    text += "| scan | objects | pairs | clip loss, without | with | change | error, without | with | change |\n"
    text += "|---|---|--:|--:|--:|--:|--:|--:|--:|\n"
    names = [name for name, _ in TRIALS]
    for scanned in (False, True):
        for who, which in (*((n, [n]) for n in names), ("all", names)):
            mine = [r for r in rows if r["scanned"] == scanned and r["object"] in which]
            if not len(change := pairs(mine, "loss")):
                continue
            held = " (held out)" if who in HELD_OUT else ""
            text += f"| {'yes' if scanned else 'no'} | {who}{held} | {len(change)} "
            for key, form in (("loss", ".2e"), ("error", ".3f")):
                for with_it in (False, True):
                    values = [r[key] for r in mine if r["pretrained"] == with_it]
                    text += f"| {sum(values) / len(values):{form}} "
                change = pairs(mine, key)
                wide = f" ± {float(change.std() / len(change) ** 0.5):.2f}" if len(change) > 1 else ""
                text += f"| {float(change.mean()):+.2f}{wide} "
            text += "|\n"
    return text


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("train", "measure"))
    parser.add_argument("--steps", type=int, help="400 of pre-training, 15 of a fit")
    parser.add_argument("--drafts", type=int, default=4, help="of each object, in pre-training")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument("--folder", type=Path, default=FOLDER, help="of the encoder")
    parser.add_argument("--out", type=Path, default=OUT)
    options = parser.parse_args()
    torch.set_num_threads(1)
    if options.what == "train":
        settings = Pretraining(steps=400 if options.steps is None else options.steps, drafts=options.drafts)
        print(json.dumps(train(settings, options.folder)))
        return
    known = json.loads((options.folder / "train.json").read_text())
    steps, rows = 15 if options.steps is None else options.steps, []
    result = {"machine": describe("cpu"), "train": known, "steps": steps, "rows": rows}
    options.out.mkdir(parents=True, exist_ok=True)
    for seed in options.seeds:
        for scanned in (False, True):
            for subject, part in TRIALS:
                file = str(options.folder / "encoder.safetensors")
                rows += trial(subject, part, seed, file, scanned=scanned, steps=steps)
                print(*(json.dumps(row) for row in rows[-2:]), sep="\n", flush=True)
                (options.out / "pretrain.json").write_text(json.dumps(result, indent=1))
                (options.out / "pretrain.md").write_text(page(result))


if __name__ == "__main__":
    main()
