"""The experiment that materials are learnt from, counted: a drop, simulated, filmed, scored, and its gradient."""

from typing import Any, Literal

from diffuphy.cost import rollouts
from diffuphy.cost.body import Body
from diffuphy.cost.counted import pictures
from diffuphy.cost.rollouts import Laws, Work, add
from diffuphy.cost.substeps import rounds

DRAFT = 0.9
"""Share of the particles it asks for that the probe's coarse copy has [-]: the finest lattice that gives no more."""

ROW = 3 + 9
"""Numbers of a particle that a frame is drawn from: x, F."""

SKIN, SPLAT = 24, 60
"""Numbers that the graph of a picture keeps of a Gaussian: for each particle that it follows (x, F, arm, and what they
become), and for itself (covariance, footprint, colour, operands)."""

Gradient = Literal["none", "full", "substep"]


class Drop:
    """The probe with its coarse copy.

    Args:
        takes: what a step looks at (``losses.takes``).
        degree: of the spherical harmonics of its Gaussians.
    """

    def __init__(self, probe: Any, takes: Any, body: Body, degree: int):
        self.probe, self.takes, self.body, self.degree = probe, takes, body, degree
        self.n = DRAFT * min(probe.particles, body.particles)
        """Particles of the copy."""
        dx = body.spacing(self.n) * probe.particles_per_cell ** (1 / 3)
        self.scene = probe.scene(dx, body.size)
        self.nodes = rollouts.block(body.extent, dx)

    def rounds(self, frames: int, wave: float) -> float:
        """Rounds of so many frames."""
        return rounds(self.scene, wave, 0.0) * frames / self.scene.frames

    def clip(self, frames: int, laws: Laws, wave: float, grad: Gradient = "none") -> Work:
        """A simulated and filmed drop, with its gradient if asked: then some frames, each drawn a second time.

        ``substep``: the gradient of the last substep before each frame alone. It is a rollout of its own, so that a
        closing half comes on top, and there is a frame to find the first substep (``rivals.substep``).
        """
        R, scheme, G, played = self.rounds(frames, wave), self.scene.scheme, self.body.gaussians, frames
        gone_back = R
        if grad == "substep":
            gone_back = frames * (1.0 + scheme.half_kick)
            R, played = R + frames * scheme.half_kick + R / frames, 2 * frames + 1
        shown, side = frames if grad == "none" else self.takes.shown(frames), self.probe.image
        work = [
            rollouts.forward(self.n, R, played, self.nodes, laws, scheme),
            pictures(shown, G, side, degree=self.degree),
            {"skin": shown * G * self.probe.skin * (1 if grad == "none" else 4), "score.pixel": shown * side**2},
        ]
        if grad != "none":
            work.append(pictures(shown, G, side, back=True, degree=self.degree))
            work.append(rollouts.backward(self.n, gone_back, self.nodes, laws, scheme, kept=True))
            work.append({"back.frame": frames})
        return add(*work)

    def states(self, frames: int, laws: Laws, wave: float, grad: Gradient) -> float:
        """Memory of the states that a gradient keeps [byte]: of every round and the last of each frame, or before and
        after a substep and its closing half."""
        rows = self.rounds(frames, wave) / frames + 1 if grad == "full" else 3
        return frames * rows * self.n * rollouts.row_bytes(laws, False)

    def graph(self) -> float:
        """Memory of one frame's graph at a time, and of all of them the rows they are drawn from, latents, noise, and
        gradients of these [byte]."""
        probe, shown = self.probe, self.takes.shown(self.probe.frames)
        frame = self.body.gaussians * (SKIN * probe.skin + SPLAT)
        return 4 * (frame + shown * (3 * ROW * self.n + 10 * probe.image**2))
