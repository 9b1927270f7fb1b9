"""Timings of the simulator: a table of throughput, and rows of work from which prices are made."""

import gc
from functools import partial
from typing import Any

import torch

from benchmarks.speed.body import CASES, N_SUB, SCHEMES, Body, Laws, body, cube, material, timed
from benchmarks.speed.prices import Row
from diffuphy.cost import rollouts
from diffuphy.material import ELASTIC, PLASTIC
from diffuphy.material.branch import BRANCHES
from diffuphy.mpm import FrameReport, HalfSpace, Scene, Scheme, simulate
from diffuphy.mpm.state import state_bytes


def best(what: Any, repeat: int) -> float:
    """The fastest of some turns after one that compiles: on a shared machine it is the least disturbed."""
    what()
    gc.disable()
    try:
        return min(what() for _ in range(repeat))
    finally:
        gc.enable()


def throughput(case: str, scheme: str, n: int, dtype: torch.dtype, repeat: int, device: str) -> dict[str, Any]:
    """Forward throughput, time of backward relative to forward, launches and bytes. A frame with half kicks has one
    round more than it has substeps, which is part of its price."""
    b = body(case, SCHEMES[scheme], n, dtype, device=device)
    alone = body(case, SCHEMES[scheme], n, dtype, grad=False, device=device)
    forward = best(alone.forward, repeat)
    again, kept = best(lambda: b.backward(kept=False), repeat), best(lambda: b.backward(kept=True), repeat)
    row = state_bytes(b.state)
    return {
        "case": case,
        "scheme": scheme,
        "particles": n,
        "precision": str(dtype).split(".")[1],
        "forward_M_per_s": round(n * N_SUB / forward / 1e6, 3),
        "backward_over_forward": round(again / forward, 2),
        "backward_over_forward_kept": round(kept / forward, 2),
        "launches": alone.launches(),
        **alone.bytes(),
        "MB_kept": round((b.span.steps + 1) * row / 1e6, 1),
        "MB_again": round((b.solver._segment(b.state, b.span) + b.span.steps // b.solver._segment(b.state, b.span))
                          * row / 1e6, 1),
    }  # fmt: skip


def large(case: str, scheme: str, n: int, device: str) -> dict[str, Any]:
    """Forward throughput of a body too large to go back through here."""
    alone = body(case, SCHEMES[scheme], n, torch.float32, grad=False, device=device)
    seconds = best(alone.forward, 2)
    return {"case": case, "scheme": scheme, "particles": n, "precision": "float32",
            "forward_M_per_s": round(n * N_SUB / seconds / 1e6, 3), "launches": alone.launches(),
            **alone.bytes()}  # fmt: skip


def occupied(n: int, fill: float, repeat: int, device: str) -> dict[str, Any]:
    """Throughput when the body fills a share of its box only."""
    b = body("neo-Hookean", Scheme(), n, torch.float32, grad=False, device=device, fill=fill)
    seconds = best(b.forward, repeat)
    part = b.solver.active(b.state, b.span)
    return {
        "particles": n,
        "fill": fill,
        "nodes": b.span.grid.nodes,
        "worked": b.span.grid.nodes if part is None else len(part.nodes),
        "forward_M_per_s": round(n * N_SUB / seconds / 1e6, 3),
    }


def families(quick: bool) -> list[Laws]:
    """Sets of laws from which every law gets its price: alone where it has a direct form, and beside a partner that
    decomposes."""
    if quick:
        return [(("neo_hookean",), ("identity",), ()), (("hencky",), ("von_mises",), ())]
    direct = [((e,), ("identity",), ()) for e, law in ELASTIC.items() if law.is_direct]
    decomposed = [((e,), ("von_mises",), ()) for e in ELASTIC]
    flows = [(("hencky",), (p,), ()) for p in PLASTIC if p != "von_mises"]
    viscous = [(("neo_hookean",), ("identity",), (branch,)) for branch in BRANCHES]
    return [*direct, *decomposed, *flows, *viscous]


def row(b: Body, laws: Laws, scheme: Scheme, double: bool, *, back: bool = False) -> rollouts.Work:
    """The work of a frame of ``b``."""
    args = b.particles, b.span.steps, b.span.grid.nodes, rollouts.Laws.of(*laws), scheme
    if back:
        return rollouts.backward(*args, kept=True, double=double)
    return rollouts.forward(args[0], args[1], 0.0, *args[2:], double=double)


def rows(repeat: int, device: str, quick: bool) -> tuple[list[Row], list[Row]]:
    """Timed work, forward and backward."""
    forward, backward = [], []
    sizes = (2000, 8000) if quick else (1000, 20_000)
    plain: Laws = (("neo_hookean",), ("identity",), ())
    settings = [(laws, Scheme(), torch.float32, False) for laws in families(quick)]
    settings += [(plain, Scheme.mls(), torch.float32, False), (plain, Scheme(contact="elastic"), torch.float32, True)]
    if not quick:
        settings += [(plain, Scheme(order=3), torch.float32, False), (plain, Scheme(), torch.float64, False)]
        settings += [(plain, Scheme(order=3), torch.float64, False), (plain, Scheme.mls(), torch.float64, False)]
    for laws, scheme, dtype, floor in settings:
        double = dtype == torch.float64
        for n in sizes if laws == plain else sizes[1:]:
            alone = body(laws, scheme, n, dtype, grad=False, device=device, floor=floor)
            work = row(alone, laws, scheme, double)
            if floor:
                work["contact.particle"] = float(n * alone.span.steps)
            forward.append((work, best(alone.forward, repeat)))
            if not floor:
                b = body(laws, scheme, n, dtype, device=device)
                seconds = best(partial(b.backward, kept=True), repeat)
                backward.append((row(b, laws, scheme, double, back=True), seconds))
    return forward, backward


def frames(repeat: int, device: str) -> list[Row]:
    """Frames of a single substep: what is done once a frame."""
    return [_frames(n, repeat, device) for n in (1000, 20_000)]


def _frames(n: int, repeat: int, device: str) -> Row:
    x, vol, dx = (t.to(device) if isinstance(t, torch.Tensor) else t for t in cube(n, torch.float32))
    laws = CASES["neo-Hookean"]
    field = material(laws, n, torch.float32).to(device)
    scene = Scene(dx=dx, boundaries=(HalfSpace(friction=0.5),), fps=3000.0, frames=10, lift=1.0)
    reports: list[FrameReport] = []

    def run() -> float:
        reports.clear()
        return timed(lambda: list(simulate(scene, x, vol, field, threads=1, report=reports)), device)

    seconds = best(run, repeat)
    rounds, nodes = sum(r.n_sub + 1 for r in reports), rollouts.block((0.5, 0.5, 0.5), dx)
    return rollouts.forward(n, rounds, 10, nodes, rollouts.Laws.of(*laws), Scheme()), seconds
