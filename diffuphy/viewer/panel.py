"""The panel of the viewer's page."""

from typing import Any

from diffuphy.viewer.change import DRAFT, MATERIALS, SKETCH, Change, height_of
from diffuphy.viewer.session import REACH, Session
from diffuphy.viewer.shot import VIEWS

OWN = "as in the film"
"""The material that the run has found."""

LEGEND = 320
"""Height of the film for which legends are made [px]: it sets the size of their letters."""

SIZES = {"sketch": SKETCH, "draft": DRAFT, "film": None}
"""How finely to simulate again: particles at most."""

SIZED = f"{SKETCH}, {DRAFT} or all particles"


class Panel:
    """Buttons, sliders and what they do to a session.

    Args:
        session: what they act on.
        server: where they are.
    """

    def __init__(self, session: Session, server: Any):
        self.session, self.gui = session, server.gui
        self._painted: tuple[object, ...] = ()
        self._film()
        self._change()
        self._hand()
        self._take()

    def _film(self) -> None:
        gui, player = self.gui, self.session.player
        with gui.add_folder("Film"):
            self.title = gui.add_markdown("")
            self.play = gui.add_button("Pause")
            self.frame = gui.add_slider("frame", 0, max(1, player.frames - 1), 1, 0)
            self.speed = gui.add_slider("speed", 0.05, 2.0, 0.05, 1.0, hint="seconds of motion in a second")
            self.loop = gui.add_checkbox("loop", True)
            self.view = gui.add_dropdown("view", VIEWS, hint="what the colours show")
            self.legend = gui.add_image(_blank(), visible=False)
            self.said = gui.add_markdown("")
        self.play.on_click(lambda _: player.toggle())
        self.frame.on_update(self._seek)
        self.speed.on_update(lambda _: setattr(player, "speed", self.speed.value))
        self.loop.on_update(lambda _: setattr(player, "loop", self.loop.value))
        self.view.on_update(self._paint)

    def _seek(self, event: Any) -> None:
        if event.client is not None:  # a person, not the film itself
            self.session.player.playing = False
            self.session.player.seek(int(self.frame.value))

    def _paint(self, event: Any) -> None:
        if event.client is not None:
            _say(self.said, self.session.paint(self.view.value))

    # ------------------------------------------------------------------ change and simulate
    def _change(self) -> None:
        gui, run = self.gui, self.session.run
        scene = run.play.scene(run.motion, run.particles)
        with gui.add_folder("Simulate again"):
            self.material = gui.add_dropdown("material", (OWN, *MATERIALS))
            self.stiffness = gui.add_slider("stiffness, log₁₀ ×", -1.0, 1.0, 0.1, 0.0, hint="Young's modulus")
            self.height = gui.add_number("height [m]", round(height_of(scene, run.particles), 3), min=0.0, step=0.05)
            self.velocity = gui.add_vector3("velocity [m/s]", scene.velocity, step=0.1)
            self.gravity = gui.add_number("gravity [m/s²]", -scene.gravity[2], step=0.1)
            self.size = gui.add_dropdown("resolution", tuple(SIZES), initial_value="draft", hint=SIZED)
            self.go = gui.add_button("Simulate", color="blue")
            self.stop = gui.add_button("Stop", visible=False)
            self.back = gui.add_button("Back to the film")
            self.bar = gui.add_progress_bar(0.0, visible=False)
            self.news = gui.add_markdown("")
        self._start = {name: getattr(self, name).value for name in ("height", "velocity", "gravity")}
        self.go.on_click(self._simulate)
        self.stop.on_click(lambda _: self.session.job.stop())
        self.back.on_click(lambda _: (self.session.release(), self.session.show(self.session.film)))

    def change(self) -> Change:
        """What the widgets say; one that was not touched says nothing.

        Raises:
            ValueError: values that no change may have.
        """

        def touched(name: str) -> Any:
            value = getattr(self, name).value
            return None if value == self._start[name] else value

        return Change(
            material=None if self.material.value == OWN else self.material.value,
            stiffness=10.0**self.stiffness.value,
            height=touched("height"),
            velocity=touched("velocity"),
            gravity=touched("gravity"),
            particles=SIZES[self.size.value],
        )

    def _simulate(self, event: Any) -> None:
        try:
            change = self.change()
        except ValueError as error:
            self.session.job.message = str(error)
            return
        self.session.simulate(change)

    # ------------------------------------------------------------------ a hand in it
    def _hand(self) -> None:
        gui = self.gui
        with gui.add_folder("Touch it"):
            self.touch = gui.add_button("Start")
            self.strength = gui.add_slider("strength [weights]", 0.5, 10.0, 0.5, 3.0, hint="most force of the hand")
            self.radius = gui.add_slider("radius / size", 0.05, 0.5, 0.05, REACH, hint="of what the hand holds")
            self.rate = gui.add_markdown("a simulation that runs on, with a hand in it")
        self.touch.on_click(self._toggle)
        self.strength.on_update(self._grip)
        self.radius.on_update(self._grip)

    def _toggle(self, event: Any) -> None:
        if self.session.live is not None:
            self.session.release()
            return
        try:
            self.session.job.message = self.session.hold(self.change())
        except ValueError as error:
            self.session.job.message = str(error)
        self._grip(event)

    def _grip(self, event: Any) -> None:
        if (live := self.session.live) is not None:
            live.hand.strength = self.strength.value
            live.hand.radius = self.radius.value * self.session.run.motion.size

    # ------------------------------------------------------------------ to take home
    def _take(self) -> None:
        gui = self.gui
        with gui.add_folder("Export"):
            film = gui.add_button("Film (mp4)", hint="what is played, with the camera of the run")
            ply = gui.add_button("This frame (ply)")
        film.on_click(lambda _: self.session.export_film())
        ply.on_click(lambda _: setattr(self.session.job, "message", self.session.export_ply()))

    # ------------------------------------------------------------------ what it says
    def update(self) -> None:
        """Let the widgets say what is so now; nothing is sent for one that says so already."""
        session, player, job, live = self.session, self.session.player, self.session.job, self.session.live
        _say(self.title, session.title)
        _set(self.play, "label", "Pause" if player.playing else "Play")
        _set(self.frame, "max", max(1, player.frames - 1))
        self.frame.value = player.frame
        self.view.value = session.view
        _set(self.bar, "visible", job.running)
        _set(self.stop, "visible", job.running)
        _set(self.go, "disabled", job.running)
        if job.running:
            _set(self.bar, "value", round(100.0 * job.share, 1))
        _say(self.news, job.message)
        _set(self.touch, "label", "Start" if live is None else "End")
        if live is not None:
            _say(self.rate, live.message or _rates(live.rates))
        self._legend()

    def _legend(self) -> None:
        name = (self.session.view, id(self.session.shot), id(self.session.live))
        if name == self._painted:
            return
        self._painted = name
        card = self.session.legend(LEGEND)
        _set(self.legend, "visible", card is not None)
        if card is not None:
            self.legend.image = (255.0 * (1 - card[..., 3:] + card[..., :3] * card[..., 3:])).byte().numpy()


def _set(widget: Any, name: str, value: Any) -> None:
    if getattr(widget, name) != value:
        setattr(widget, name, value)


def _say(widget: Any, text: str) -> None:
    """As plain text: what an error quotes is not to be read as markdown."""
    _set(widget, "content", "".join(f"\\{c}" if c in "\\`*_{}[]<>#|" else c for c in text))


def _rates(rates: tuple[float, float] | None) -> str:
    if rates is None:
        return "starting ..."
    return f"{rates[0]:.0f} frames/s shown; simulates {rates[1]:.2g} s in a second"


def _blank() -> Any:
    import numpy as np

    return np.full((8, 8, 3), 255, dtype=np.uint8)
