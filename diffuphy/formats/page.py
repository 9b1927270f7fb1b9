"""One HTML file that plays the motion in 3D: nothing is fetched, it opens from a disk or an attachment."""

import contextlib
import io
import logging
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from diffuphy.formats.options import Options
from diffuphy.formats.run import Run
from diffuphy.geometry import covariances
from diffuphy.render.sh import to_rgb
from diffuphy.types import Gaussians

log = logging.getLogger(__name__)

ROUND = 2.0**-11
"""Centres are rounded to this share of the object's size [-], about a tenth of what one sees of it on a screen; it
halves the file."""


def html(run: Run, options: Options) -> list[Path]:
    """``play.html``, one file that plays in 3D in a browser, by viser's recorder.

    At most ``options.gaussians`` Gaussians of the object, the most visible ones, in at most ``options.page_frames``
    frames, and as many of what stands around it, once; the time line keeps the speed of the film.

    Colours are those of degree 0, covariances half precision: both are viser's.

    Raises:
        ValueError: viser is not installed.
    """
    try:
        import viser
    except ModuleNotFoundError:
        raise ValueError(
            "the page that plays in a browser is written by viser, which is not installed: "
            "pip install 'diffuphy[viewer]'"
        ) from None
    keep = thinned(run.skin.gaussians, options.gaussians)
    frames = len(run.trajectory.x)
    step = max(options.every, -(-frames // options.page_frames))
    slow = run.clip.slow if "clip" in run.results else 1.0
    with contextlib.redirect_stdout(io.StringIO()):  # it says where it serves, which nobody is to know
        server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
        try:
            if options.around and run.still is not None:
                _add(server, "around", run.still, thinned(run.still, options.gaussians))
            text = _recorded(server, run, keep, range(0, frames, step), slow * step / run.trajectory.fps)
        finally:
            server.stop()
    file = options.folder / "play.html"
    file.write_text(text, encoding="utf-8")
    log.info(
        "play.html: %d of %d Gaussians in %d of %d frames, %.1f MB",
        len(keep), len(run.skin.gaussians), len(range(0, frames, step)), frames, file.stat().st_size / 1e6,
    )  # fmt: skip
    return [file]


def thinned(g: Gaussians, count: int) -> Tensor:
    """Indices of the ``count`` Gaussians that cover most: the largest opacity times area of the middle section,
    in their order."""
    weight = g.logit_opacities.sigmoid() * torch.sort(g.log_scales, dim=1).values[:, 1:].sum(1).exp()
    return torch.topk(weight, min(count, len(g))).indices.sort().values


def _add(server: Any, name: str, g: Gaussians, keep: Tensor) -> None:
    """Gaussians that stay where they are."""
    sigma = covariances(g.quats[keep], g.log_scales[keep].exp())
    server.scene.add_gaussian_splats(
        name,
        g.means[keep].numpy(),
        sigma.numpy(),
        to_rgb(g.sh[keep]).clamp(0, 1).numpy(),
        g.logit_opacities[keep, None].sigmoid().numpy(),
    )


def _recorded(server: Any, run: Run, keep: Tensor, frames: range, seconds: float) -> str:
    """The page, frames ``seconds`` apart."""
    rest = run.skin.gaussians
    rgb = to_rgb(rest.sh[keep]).clamp(0, 1).numpy()
    opacity = rest.logit_opacities[keep, None].sigmoid().numpy()
    x = run.trajectory.x
    low, high = x.amin((0, 1)), x.amax((0, 1))
    size = float((high - low).amax())
    middle = ((low + high) / 2).numpy()
    server.scene.set_up_direction("+z")
    server.scene.add_grid("floor", width=4 * size, height=4 * size, plane="xy", position=(*map(float, middle[:2]), 0.0))
    server.initial_camera.look_at = middle
    server.initial_camera.position = middle + size * np.array([0.9, -1.5, 0.5])
    handle, recording = None, server.get_scene_serializer()
    for t in frames:
        means, F = run.moved(t)
        centres = ((means[keep] / (ROUND * size)).round() * (ROUND * size)).numpy()
        sigma = covariances(rest.quats[keep], rest.log_scales[keep].exp(), F[keep]).numpy()
        if handle is None:
            handle = server.scene.add_gaussian_splats("object", centres, sigma, rgb, opacity)
        else:
            handle.set_gaussians(centres, sigma, rgb, opacity)
        recording.insert_sleep(seconds)
    return recording.as_html()
