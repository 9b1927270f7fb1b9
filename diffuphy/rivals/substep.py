"""The gradient of the last substep before each frame: what a tape round one substep knows."""

import dataclasses
from dataclasses import dataclass
from typing import Any

import torch

from diffuphy.learning.probe import Bench
from diffuphy.mpm import Scene, simulate
from diffuphy.mpm.engine.solver import State
from diffuphy.types import MaterialField, Trajectory

SHARE = 0.9
"""Length h of the last substep, in substeps of the frame: a full one might take two where waves have become faster."""


@dataclass(frozen=True)
class LastSubstep(Bench):
    """The experiment, with gradients that reach back one substep from each frame.

        ∂(x_f, F_f)/∂θ at the state h before frame f, that state held fixed

    h is nearly one substep. The motion is the same; of what a material does to it, the gradient sees what it does in h.
    """

    @classmethod
    def like(cls, bench: Bench) -> "LastSubstep":
        """The same experiment."""
        return cls(**{f.name: getattr(bench, f.name) for f in dataclasses.fields(Bench)})

    def simulate(
        self,
        field: MaterialField,
        frames: int | None = None,
        *,
        scene: Scene | None = None,
        gate_time: float | None = None,
        **options: Any,
    ) -> Trajectory:
        """As ``Bench.simulate``; where gradients are enabled they are those of the last substeps."""
        if not torch.is_grad_enabled():
            return super().simulate(field, frames, scene=scene, gate_time=gate_time, **options)
        if options.pop("gather", ()):
            raise ValueError("the sums of a frame have no meaning where its gradient is that of one substep")
        options.pop("report", None)
        scene = scene or self.scene
        run = {"dt_ref": gate_time if "identity" in field.plastic else None} | options
        T = 1.0 / scene.fps
        state, h = self._begun(scene, field, run)
        shots = [state]
        for _ in range(scene.frames if frames is None else frames):
            reports: list = []
            with torch.no_grad():
                most = dataclasses.replace(scene, fps=1.0 / (T - h))
                state = self._after(most, field, state, {"report": reports} | run)
            state = self._after(
                dataclasses.replace(scene, fps=1.0 / h), field, state, {"grad": True, "keep": True} | run
            )
            shots.append(state)
            state = detached(state)
            h = min(SHARE * reports[-1].dt, 0.5 * T)
        x, v, F = (torch.stack([getattr(s, name) for s in shots]) for name in ("x", "v", "F"))
        return Trajectory(x, v, F, scene.fps)

    def _begun(self, scene: Scene, field: MaterialField, run: dict[str, Any]) -> tuple[State, float]:
        """The initial state, and the substep of the first frame [s]."""
        reports: list = []
        with torch.no_grad():
            first, _ = simulate(scene, self.draft.x, self.draft.vol, field, frames=1, report=reports, **run)
        return first, min(SHARE * reports[0].dt, 0.5 / scene.fps)

    def _after(self, scene: Scene, field: MaterialField, state: State, run: dict[str, Any]) -> State:
        """The state one frame of ``scene`` later."""
        *_, end = simulate(scene, self.draft.x, self.draft.vol, field, frames=1, state=state, **run)
        return end


def detached(state: State) -> State:
    """The same state as a constant."""
    return State(*(None if t is None else t.detach() for t in state.tensors()), state.time)  # type: ignore[arg-type]
