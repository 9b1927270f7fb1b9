"""What one can do with a run: play it, paint it, change it, pull at it, take it home. Knows no browser."""

import dataclasses
import threading
import time
from dataclasses import dataclass
from itertools import count
from pathlib import Path

from torch import Tensor

from diffuphy.formats.run import said
from diffuphy.mpm import Scene
from diffuphy.mpm.trajectory import Play
from diffuphy.render.film.video import playback, write_mp4
from diffuphy.render.scenes.ply import write as write_ply
from diffuphy.types import Motion, Particles
from diffuphy.viewer.change import Change
from diffuphy.viewer.hand import Hand, pick
from diffuphy.viewer.job import Job, Progress, Watched, line_of
from diffuphy.viewer.live import Live
from diffuphy.viewer.opened import Run
from diffuphy.viewer.player import Player
from diffuphy.viewer.shot import COARSE, Figure, Shot, Splats, Stage

OUT = "viewer"
"""Folder within a run for what is exported here."""

REACH = 0.25
"""Radius of a hand over the longest side of the body [-]."""

Point = tuple[float, float, float]


@dataclass(frozen=True)
class Replay(Play):
    """The simulation of a given scene."""

    stated: Scene | None = None

    def scene(self, motion: Motion, particles: Particles) -> Scene:
        assert self.stated is not None
        return self.stated


class Session:
    """One run and what has become of it here.

    Args:
        run: what was opened.
    """

    def __init__(self, run: Run):
        self.run = run
        figure = self._figure(run.particles)
        self.film = Shot(str(Change(particles=None)), figure, run.particles, run.field, run.trajectory)
        """As the run left it."""
        self.shot = self.film
        """What is played now."""
        self.player = Player(len(self.shot), run.trajectory.fps)
        self.view = "colour"
        self.job = Job()
        self.live: Live | None = None
        self._stage: Stage | None = None
        self._lock = threading.RLock()

    def _neighbours(self, particles: Particles) -> int:
        """Particles each Gaussian follows: more when there are fewer than in the film."""
        k = self.run.film.neighbours
        return k if len(particles) == len(self.run.particles) else max(COARSE, k)

    def _figure(self, particles: Particles) -> Figure:
        film = self.run.film
        return Figure.of(self.run.gaussians, particles, self._neighbours(particles), film.stretch, film.around)

    @property
    def title(self) -> str:
        """What is shown."""
        stage = self._stage
        return self.shot.title if stage is None else f"live: {stage.title}"

    # ------------------------------------------------------------------ what is seen
    def tick(self, seconds: float) -> tuple[object, ...]:
        """Go on by ``seconds``; a name of what is seen then, which changes when the picture does."""
        with self._lock:
            if self.live is not None:
                return ("live", id(self.live), self.live.number, self.view)
            return ("film", id(self.shot), self.player.advance(seconds), self.view)

    def splats(self) -> Splats:
        """The picture of now."""
        figure, seen = self._now()
        return figure(*seen)

    def _now(self) -> tuple[Figure, tuple[Tensor, Tensor, Tensor | None]]:
        with self._lock:
            live, stage, shot, frame, view = self.live, self._stage, self.shot, self.player.frame, self.view
        if live is not None and stage is not None and live.latest is not None:
            return stage.figure, stage.seen(live.latest, view)
        return shot.figure, shot.seen(frame, view)

    def legend(self, height: int) -> Tensor | None:
        """What the colours mean, rgba (h, w, 4); None where they are its own."""
        with self._lock:
            paint = (self._stage or self.shot).painter(self.view)
        return None if paint is None else paint.legend(height)

    def paint(self, view: str) -> str:
        """Colour by another quantity; why not, or an empty line."""
        try:
            self.shot.painter(view)
        except Exception as error:
            return line_of(error)
        with self._lock:
            self.view = view
        return ""

    def show(self, shot: Shot) -> None:
        """Play another shot from its beginning."""
        with self._lock:
            self.shot = shot
            self.player.load(len(shot), shot.trajectory.fps)
            self.player.playing = True

    # ------------------------------------------------------------------ another motion
    def simulate(self, change: Change) -> bool:
        """Simulate again with a change, in the background; whether nothing else was running."""
        return self.job.start("simulation", lambda progress: self._simulate(change, progress))

    def _simulate(self, change: Change, progress: Progress) -> str:
        began = time.perf_counter()
        setup = change(self.run)
        settings = {f.name: getattr(self.run.play, f.name) for f in dataclasses.fields(Play)}
        replay = Replay(**settings, stated=setup.scene)
        trajectory = replay(self.run.motion, setup.particles, setup.field, work=Watched(progress)).to("cpu")
        self.release()
        self.show(Shot(str(change), self._figure(setup.particles), setup.particles, setup.field, trajectory))
        seconds, clock = (len(trajectory.x) - 1) / trajectory.fps, time.perf_counter() - began
        return f"{len(setup.particles)} particles: {seconds:.3g} s of motion in {clock:.1f} s"

    # ------------------------------------------------------------------ a hand
    def hold(self, change: Change) -> str:
        """Begin a live simulation with a change; the line to show."""
        self.release()
        try:
            setup = change(self.run)
            m = setup.field.rho * setup.particles.vol
            live = Live(setup, Hand(m, REACH * self.run.motion.size))
            stage = Stage(str(change), self._figure(setup.particles), setup.field.to("cpu"), self.shot)
        except Exception as error:
            return f"live simulation: {line_of(error)}"
        with self._lock:
            self.live, self._stage = live, stage
        live.start()
        return f"{len(setup.particles)} particles; drag the body to pull at it, click it to poke it"

    def release(self) -> None:
        """End the live simulation, if there is one."""
        with self._lock:
            live, self.live, self._stage = self.live, None, None
        if live is not None:
            live.stop()

    def touch(self, origin: Point, direction: Point) -> Point | None:
        """The point of the body that a ray meets [m], where the live simulation is now."""
        live = self.live
        if live is None or live.latest is None:
            return None
        return pick(live.latest.x, origin, direction, 0.5 * live.setup.particles.spacing)

    # ------------------------------------------------------------------ to take home
    def export_film(self) -> bool:
        """Film what is played, in the view that is shown, in the background; whether nothing else was running."""
        shot, view = self.shot, self.view
        return self.job.start("film", lambda progress: self._film(shot, view, progress))

    def _film(self, shot: Shot, view: str, progress: Progress) -> str:
        film = dataclasses.replace(self.run.film, neighbours=self._neighbours(shot.particles), view=view)
        made_of = (t.to("cpu") for t in (self.run.gaussians, shot.particles, shot.trajectory, shot.field))
        clip = film(*made_of, work=Watched(progress))
        path = self._new("film", "mp4")
        comment = said(self.run.motion.text, clip.fps, clip.slow, view)
        write_mp4(path, clip.rgb, playback(clip), title=shot.title, comment=comment)
        return f"wrote {path}"

    def export_ply(self) -> str:
        """Write the Gaussians of now; the line to show."""
        try:
            path = self._new("frame", "ply")
            figure, seen = self._now()
            write_ply(path, figure.gaussians(*seen))
        except Exception as error:
            return f"ply: {line_of(error)}"
        return f"wrote {path}"

    def _new(self, name: str, suffix: str) -> Path:
        """A file that is not there yet."""
        folder = self.run.folder / OUT
        folder.mkdir(exist_ok=True)
        return next(p for k in count(1) if not (p := folder / f"{name}_{k:03d}.{suffix}").exists())

    def close(self) -> None:
        """End whatever runs."""
        self.job.stop(timeout=10.0)
        self.release()
