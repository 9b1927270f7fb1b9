"""Films as others play them: mp4, webm, gif, and single pictures."""

from collections.abc import Callable
from pathlib import Path

from torch import Tensor

from diffuphy.formats.options import Options
from diffuphy.formats.run import Run, said
from diffuphy.render.film.video import playback, straight, write_gif, write_mp4, write_pngs, write_webm
from diffuphy.types import Clip


def films(run: Run) -> dict[str, Clip]:
    """All films of a run by the name of their file."""
    views = run.views
    return {"film": run.clip} | ({} if views is None else {f"film_{name}": views.clip(name) for name in views.rgb})


def _about(run: Run, name: str, clip: Clip) -> dict[str, str]:
    view = name.removeprefix("film").removeprefix("_") or "colour"
    return {"title": run.title, "comment": said(run.title, clip.fps, clip.slow, view)}


def _each(run: Run, place: Callable[[str], Path], write: Callable[[Path, Clip, dict[str, str]], None]) -> list[Path]:
    """One file a film."""
    files = []
    for name, clip in films(run).items():
        files.append(place(name))
        write(files[-1], clip, _about(run, name, clip))
    return files


def mp4(run: Run, options: Options) -> list[Path]:
    """H.264, 4:2:0: plays everywhere; a transparent background is white."""

    def write(path: Path, clip: Clip, about: dict[str, str]) -> None:
        write_mp4(path, clip.rgb, playback(clip), **about)

    return _each(run, lambda name: options.folder / f"{name}.mp4", write)


def webm(run: Run, options: Options) -> list[Path]:
    """VP9: plays in browsers, also with a transparent background."""

    def write(path: Path, clip: Clip, about: dict[str, str]) -> None:
        write_webm(path, pictures(clip), playback(clip), **about)

    return _each(run, lambda name: options.folder / f"{name}.webm", write)


def gif(run: Run, options: Options) -> list[Path]:
    """256 colours in a loop, at most 50 frames a second."""

    def write(path: Path, clip: Clip, about: dict[str, str]) -> None:
        write_gif(path, clip.rgb, playback(clip), comment=about["comment"])

    return _each(run, lambda name: options.folder / f"{name}.gif", write)


def png(run: Run, options: Options) -> list[Path]:
    """One picture a frame, with coverage where the background is transparent."""

    def write(path: Path, clip: Clip, about: dict[str, str]) -> None:
        frames = pictures(clip)
        write_pngs(path, [frames[t] for t in options.frames(len(frames))], **about)

    return _each(run, lambda name: options.folder / f"{name}_png", write)


def pictures(clip: Clip) -> Tensor:
    """Frames (T, H, W, 3), or with coverage (T, H, W, 4)."""
    return clip.rgb if clip.alpha is None else straight(clip)
