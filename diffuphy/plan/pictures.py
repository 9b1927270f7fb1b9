"""What object and film ask for."""

import dataclasses
from collections.abc import Mapping
from typing import Any

from diffuphy.plan.line import Line


def object_lines(components: Mapping[str, Any]) -> list[Line]:
    """Colour, number and filling of the object's points."""
    fit, sample = components["gaussians"], components["particles"]
    how = f"Gaussians are a shell, the inside needs particles: {type(sample.filling).__name__}"
    filling = Line.kept("interior fill", sample.filling is not None, how, "sample.filling=null",
                        {"particles": dataclasses.replace(sample, filling=type(sample)().filling)})  # fmt: skip
    if hasattr(fit, "path"):
        return [*given_lines(fit), filling]
    degree = fit.sh_degree
    harmonics = (
        Line("spherical harmonics", f"degree {degree}", "view-dependent colour asked for")
        if degree
        else Line("spherical harmonics", "left out", "degree 0: colours do not depend on the view, nothing to rotate",
                  would={"gaussians": dataclasses.replace(fit, sh_degree=3)})
    )  # fmt: skip
    return [
        *distillation_lines(fit),
        *picture_lines(fit),
        harmonics,
        shape_line(fit),
        Line.kept("densification", fit.densify is not None, "more Gaussians where the loss still pulls",
                  "fit.densify=null"),
        filling,
    ]  # fmt: skip


def sized(components: Mapping[str, Any]) -> dict[str, Any]:
    """The particles' component, which knows how large the pixels were that the Gaussians are fitted to."""
    sample, cameras = components["particles"], getattr(components["gaussians"], "cameras", None)
    if getattr(sample, "pixel", 0.0) is not None:
        return {}
    return {"particles": dataclasses.replace(sample, pixel=getattr(cameras, "pixel", 0.0))}


def given_lines(given: Any) -> list[Line]:
    """An object that is read from a file instead of made."""
    parted = getattr(given, "parted", False)
    return [
        Line("score distillation", "left out", f"the object is given: {given.count} Gaussians from {given.path}"),
        Line("spherical harmonics", f"at most degree {given.sh_degree}", "as the file has them"),
        Line.kept("surroundings", parted, "what is not the object stands still", "all of it is the object"),
    ]


def shape_line(fit: Any) -> Line:
    """The prior of where points are."""
    shape = getattr(fit, "shape", None)
    if shape is None:
        return Line("shape prior", "left out", "fit.shape=null: pictures alone say where matter is")
    until = f"before step {shape.stop}" if isinstance(shape.stop, int) else f"in the first {shape.stop:.0%} of the run"
    return Line("shape prior", type(shape.guidance).__name__, f"weight {shape.weight:g}, {until}")


def distillation_lines(fit: Any) -> list[Line]:
    """What is taken from the prior's answers; nothing of a component of somebody else's making."""
    if not hasattr(fit, "estimator"):
        return []
    return [Line("score distillation", type(fit.estimator).__name__, f"w(t) = {fit.weight}, views a step: {fit.views}")]


def picture_lines(fit: Any) -> list[Line]:
    """Pictures of the user's own, if they are what is fitted."""
    pictures: Any = getattr(fit, "judge", None)
    if not hasattr(pictures, "held"):
        return []
    why = f"{pictures.held} of them are held out and compared with at the end" if pictures.held else "none is held out"
    return [Line("pictures", f"{pictures.bank + pictures.held} from {pictures.path}", why)]


def film_lines(components: Mapping[str, Any]) -> list[Line]:
    """Parts of a frame."""
    film, filled = components["clip"], getattr(components["particles"], "filling", None) is not None

    def other(**settings: Any) -> dict[str, Any]:
        return {"clip": dataclasses.replace(film, **settings)}

    return [
        *camera_lines(film),
        Line.kept("inside shown", film.fillers and filled, "where the body opens",
                  "film.fillers=false" if filled else "nothing is filled"),
        Line.kept("floor", film.floor, "the film shows it", "film.floor=false"),
        Line.kept("shadow", film.floor and film.shadow > 0, f"darkness {film.shadow:g}",
                  "film.shadow=0" if film.floor else "no floor that it could fall on", other(floor=True, shadow=0.5)),
        Line.kept("supersampling", film.supersample > 1, f"{film.supersample}² samples a pixel",
                  "splats are band-limited already", other(supersample=2)),
    ]  # fmt: skip


def camera_lines(film: Any) -> list[Line]:
    """Where the film is seen from, what it shows, and how fast it is played; nothing of a component of somebody else's
    making."""
    if not hasattr(film, "camera"):
        return []
    view = Line("view", film.view, "as seen" if film.view == "colour" else "painted by what it shows")
    lines = [
        Line("camera", type(film.camera).__name__, "camera=resting, turntable, follow, increments, captured"),
        view,
    ]
    also = ", ".join(film.also)
    lines.append(Line.kept("further views", bool(also), f"{also}: a film each", "film.also=[]: nothing is painted"))
    if film.slow != 1.0:
        lines.append(Line("slow motion", f"{film.slow:g} times", "the film's container and its report say so"))
    return lines
