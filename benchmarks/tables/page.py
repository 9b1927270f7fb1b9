"""Tables as Markdown, and the figure of the errors."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from benchmarks._draw import INK, LINES, PALE, Sheet
from benchmarks.tables.gather import Mean, Row, across, ahead, cells
from benchmarks.tables.protocol import ANOTHER, GIVEN, OURS, WHOLE

Best = Callable[..., Any]
"""``min`` or ``max``."""

MEASURES = {
    "physical error [%]": ("error", 100),
    "of the centre of mass [%]": ("com", 100),
    "of the shape [%]": ("shape", 100),
    "clip loss": ("hardened_loss", 1),
    "held-out clip": ("held_out_motion", 1),
    "energy created": ("energy created", 1),
    "penetration [%]": ("penetration", 1),
    "inverted [%]": ("inverted", 1),
}
"""What is averaged over prompts, and its scale; lower is better in all of them."""

WEIGHTS = ("CLIPSIM", "Diff_SSIM", "Diff_SSIM (object)", "Diff_CLIP", "FVD", "KVD", "LAION")
"""What the paper reports, where films were made and their weights are there."""


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table, its first column to the left."""
    lines = ["| " + " | ".join(head) + " |", "|---" + "|---:" * (len(head) - 1) + "|"]
    return "\n".join([*lines, *("| " + " | ".join(r) + " |" for r in rows)]) + "\n"


def names(rows: Sequence[Row], key: str) -> list[str]:
    """Values of a column in the order in which they come."""
    return list(dict.fromkeys(r[key] for r in rows))


def by_prompt(rows: Sequence[Row], metric: str = "error", scale: float = 100, *, better: Best = min) -> str:
    """Mean ± spread for every prompt and variant, the best of those that were not told in bold."""
    found, variants = cells(rows, metric), names(rows, "variant")
    lines = []
    for prompt in names(rows, "prompt"):
        rivals = [v for v in variants if v != GIVEN and found[v, prompt].count]
        best = better(rivals, key=lambda v: found[v, prompt].value, default=None)
        shown = [found[v, prompt].shown(scale) if (v, prompt) in found else "–" for v in variants]
        lines.append([prompt, *(f"**{s}**" if v == best else s for v, s in zip(variants, shown, strict=True))])
    means = [across(rows, metric, v).shown(scale) for v in variants]
    return table(["prompt", *variants], [*lines, ["*mean*", *means]])


def lead(rows: Sequence[Row], ours: str = OURS, metric: str = "error") -> str:
    """Prompts, of those with several seeds, at which ours is ahead, behind, or neither by more than the spread."""
    found, prompts = cells(rows, metric), names(rows, "prompt")
    lines = []
    for rival in names(rows, "variant"):
        if rival == ours:
            continue
        pairs = {p: (found[ours, p], found[rival, p]) for p in prompts if {(ours, p), (rival, p)} <= set(found)}
        seen = {p: ahead(*pair) for p, pair in pairs.items() if min(m.count + m.failed for m in pair) > 1}
        signs, behind = list(seen.values()), [p for p, sign in seen.items() if sign < 0]
        lines.append([rival, *(str(signs.count(s)) for s in (1, 0, -1)), "; ".join(behind) or "–"])
    return table([f"{ours} against", "ahead", "neither", "behind", "behind at"], lines)


def measures(rows: Sequence[Row]) -> str:
    """Means over prompts of everything that needs no weights."""
    had = {n: m for n, m in MEASURES.items() if any(m[0] in r for r in rows)}
    lines = [[v, *(across(rows, m, v).shown(s) for m, s in had.values())] for v in names(rows, "variant")]
    return table(["", *had], lines)


def by_look(rows: Sequence[Row]) -> str:
    """PSNR for every prompt and variant."""
    return by_prompt(rows, "psnr", 1, better=max)


def object_parts(rows: Sequence[Row]) -> str:
    """Likeness, and what it takes."""
    columns = {"PSNR [dB]": "psnr", "SSIM": "ssim", "Gaussians": "gaussians", "in all [s]": "seconds"}
    lines = [[v, *(across(rows, m, v).shown(1, 3) for m in columns.values())] for v in names(rows, "variant")]
    said = "SSIM where either object is seen; seconds of the stage. Means over prompts."
    return f"{said}\n\n" + table(["", *columns], lines)


def ablations(rows: Sequence[Row]) -> str:
    """What a part of the material is worth on one object, and a part of the object against what was meant."""
    material = [r for r in rows if r["variant"] not in ANOTHER]
    objects = [r for r in rows if r["variant"] in (WHOLE, *ANOTHER)]
    return "\n".join([
        "Parts of the material, all on the same object: physical error.\n", by_prompt(material),
        lead(material, WHOLE),
        "Parts of the object, each on its own: distance to the motion of what was meant, the object of the whole "
        "method, in the centre of mass and the three root mean square extents.\n", by_prompt(objects, "meant"),
        lead(objects, WHOLE, "meant"),
    ])  # fmt: skip


PARTS: dict[str, tuple[str, float]] = {
    "physical error [%]": ("error", 100),
    "floor [%]": ("floor", 100),
    "against what was meant [%]": ("meant", 100),
    "PSNR [dB]": ("psnr", 1),
    "SSIM": ("ssim", 1),
}
"""What a part left out does to material, motion and look: see ``parts``."""


def parts(rows: Sequence[Row]) -> str:
    """Material and motion, and the look."""
    lines = [[v, *(across(rows, m, v).shown(s, 3) for m, s in PARTS.values())] for v in names(rows, "variant")]
    return (
        "All of them. *Physical error* and *floor* are about the object that the row has made: the floor is the error "
        "that the prior's own material has on it, which the simulation leaves, so that only the two together say "
        "something of the material. *Against what was meant* sees another object too. *PSNR* and *SSIM* (where either "
        "object is seen): eight views that no fit saw, against the embedded prior's own object. Means over prompts.\n\n"
        + table(["", *PARTS], lines)
    )


def looks(rows: Sequence[Row]) -> str:
    """Likeness to the object that was meant."""
    lines = [[v, *(across(rows, m, v).shown(1, 3) for m in ("psnr", "ssim"))] for v in names(rows, "variant")]
    return (
        "Look: eight views that no fit saw, against the embedded prior's object for the sentence that was meant; SSIM "
        "where either object is seen. Means over prompts.\n\n" + table(["", "PSNR [dB]", "SSIM"], lines)
    )


def twins(rows: Sequence[Row]) -> str:
    """Runs that end in the same object and the same motion as the first variant, bit for bit: there the part did
    nothing."""
    first, *others = names(rows, "variant")
    made = {(r["variant"], r["prompt"], r["seed"]): r["digest"] for r in rows if "digest" in r}
    said = []
    for variant in others:
        runs = [key[1:] for key in made if key[0] == variant and (first, *key[1:]) in made]
        same = [key for key in runs if made[variant, *key] == made[first, *key]]
        if same:
            where = "; ".join(names([{"prompt": p} for p, _ in same], "prompt"))
            said.append(f"- *{variant}*: {len(same)} of {len(runs)} runs ({where})")
    if not said:
        return f"No run of another row ends in the same object and motion as *{first}*.\n"
    return f"Runs that end in the same object and motion as *{first}*, bit for bit:\n\n" + "\n".join(said) + "\n"


def weights(rows: Sequence[Row]) -> str:
    """Means over prompts of the paper's metrics; what is missing, and what it takes."""
    had = [m for m in WEIGHTS if any(m in r for r in rows)]
    missing = [m for m in WEIGHTS if m not in had]
    text = ""
    if had:
        lines = [[v, *(across(rows, m, v).shown(1, 3) for m in had)] for v in names(rows, "variant")]
        text = table(["", *had], lines)
    if missing:
        made = any("film" in r for r in rows)
        why = "their weights are not on this machine or no references were asked for" if made else "no films were made"
        text += f"\nMissing: {', '.join(missing)}; {why} (`--films`, [weights](../../weights.md)).\n"
    return text


def efficiency(rows: Sequence[Row]) -> str:
    """Seconds and memory of the material stage."""
    columns: dict[str, tuple[str, float]] = {
        "a step [s]": ("step_seconds", 1),
        "in all [s]": ("seconds", 1),
        "processor time [s]": ("cpu_seconds", 1),
        "peak memory [MB]": ("megabytes", 1),
        "of the device [MB]": ("device_megabytes", 1),
        "physical error [%]": ("error", 100),
    }
    lines = [[v, *(across(rows, m, v).shown(s) for m, s in columns.values())] for v in names(rows, "variant")]
    return table(["", *columns], lines)


ACROSS = 5
"""Names in a row of the legend."""


def figure(rows: Sequence[Row], path: Path, metric: str = "error", label: str = "physical error / size") -> None:
    """Every prompt a row, every variant a colour: the mean and, as a bar, the spread over seeds; logarithmic."""
    found, prompts, variants = cells(rows, metric), names(rows, "prompt"), names(rows, "variant")
    values = [m.value for m in found.values() if m.count and m.value > 0]
    if not values:
        return
    low, high = math.floor(2 * math.log10(min(values))) / 2, math.ceil(2 * math.log10(max(values))) / 2
    left, width, step = max(270.0, 30 + 5.6 * max(map(len, prompts))), 440.0, 12.0
    legend = -(-len(variants) // ACROSS)
    top = 22.0 + 18.0 * legend
    band = step * len(variants) + 10
    sheet = Sheet(left + width + 30, top + band * len(prompts) + 50)

    def at(value: float) -> float:
        return left + (min(max(math.log10(value), low), high) - low) / (high - low) * width

    ticks = [a * 10.0**e for e in range(math.floor(low), math.ceil(high) + 1) for a in (1, 2, 5)]
    bottom = top + band * len(prompts)
    for t in (t for t in ticks if low <= math.log10(t) <= high):
        sheet.line([(at(t), top - 6), (at(t), bottom)], PALE, 1.0)
        sheet.text(at(t), bottom + 12, f"{t:g}", anchor="mm", size=11)
    sheet.text(left + width / 2, bottom + 32, label, anchor="mm")
    for i, prompt in enumerate(prompts):
        sheet.text(left - 12, top + band * i + band / 2 - 9, prompt, anchor="rm", size=11)
        sheet.line([(20, top + band * i - 10), (left + width, top + band * i - 10)], PALE, 1.0)
        for j, variant in enumerate(variants):
            _dot(sheet, found.get((variant, prompt)), at, top + band * i + step * j, j)
    each = min(ACROSS, len(variants))
    for j, variant in enumerate(variants):
        x, y = 20 + j % each * (left + width - 10) / each, 12 + 18 * (j // each)
        _mark(sheet, x + 5, y, j)
        sheet.text(x + 15, y, variant, size=11, color=INK)
    sheet.image.save(path)


def _dot(sheet: Sheet, mean: Mean | None, at: Callable[[float], float], y: float, number: int) -> None:
    if mean is None or not mean.count or not mean.value > 0:
        return
    if mean.spread > 0:
        ends = max(mean.value - mean.spread, mean.value / 10), mean.value + mean.spread
        sheet.line([(at(ends[0]), y), (at(ends[1]), y)], LINES[number % len(LINES)], 2.0)
    _mark(sheet, at(mean.value), y, number)


def _mark(sheet: Sheet, x: float, y: float, number: int) -> None:
    """A colour for each variant, and another shape when the colours begin again."""
    sheet.mark(x, y, LINES[number % len(LINES)], 1 + number // len(LINES))
