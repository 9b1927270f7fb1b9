"""The results of the pipeline, and the camera that looks at them.

A result is a frozen dataclass of tensors and plain data that saves and loads itself: tensors go to
``tensors.safetensors``, everything else to ``result.json``; nothing is ever unpickled. One frame of reference
throughout: right-handed, z up, metres, seconds, kilograms. Cameras follow OpenCV (x right, y down, z forward);
quaternions are wxyz.
"""

import dataclasses
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import torch
from safetensors import safe_open
from safetensors.torch import save_file
from torch import Tensor

N_SH = {0: 1, 1: 4, 2: 9, 3: 16}
"""Spherical-harmonic coefficients per colour channel, by degree."""


class SimulationDiverged(RuntimeError):
    """The simulation left the range in which its answer means anything; the message names particle, time and remedy."""


def _flatten(value: Any, path: str, tensors: dict[str, Tensor]) -> Any:
    """Move the tensors of a nested structure into ``tensors``; return what is left as plain JSON data."""
    if isinstance(value, Tensor):
        tensors[path] = value.detach().cpu().contiguous()
        return {"tensor": path}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {
            f.name: _flatten(getattr(value, f.name), f"{path}.{f.name}", tensors) for f in dataclasses.fields(value)
        }
    if isinstance(value, dict):
        return {k: _flatten(v, f"{path}.{k}", tensors) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_flatten(v, f"{path}.{i}", tensors) for i, v in enumerate(value)]
    return value


def _restore(value: Any, tensors: dict[str, Tensor]) -> Any:
    if isinstance(value, dict):
        if set(value) == {"tensor"}:
            return tensors[value["tensor"]]
        return {k: _restore(v, tensors) for k, v in value.items()}
    if isinstance(value, list):
        return tuple(_restore(v, tensors) for v in value)
    return value


class Result:
    """Mixin of every result: ``save(directory)``, ``load(directory)``, ``to(device)``."""

    def save(self, directory: Path) -> None:
        """Write ``result.json`` and, if there are tensors, ``tensors.safetensors``."""
        tensors: dict[str, Tensor] = {}
        data = {f.name: _flatten(getattr(self, f.name), f.name, tensors) for f in dataclasses.fields(self)}  # type: ignore[arg-type]
        if tensors:
            save_file(tensors, directory / "tensors.safetensors")
        (directory / "result.json").write_text(json.dumps(data, indent=1, ensure_ascii=False), encoding="utf-8")

    @classmethod
    def load(cls, directory: Path) -> Self:
        tensors: dict[str, Tensor] = {}
        if (file := directory / "tensors.safetensors").exists():
            with safe_open(file, framework="pt") as f:
                tensors = {k: f.get_tensor(k) for k in f.keys()}
        data = _restore(json.loads((directory / "result.json").read_text(encoding="utf-8")), tensors)
        return cls._from_data(data)

    @classmethod
    def _from_data(cls, data: dict[str, Any]) -> Self:
        return cls(**data)

    def to(self, device: torch.device | str) -> Self:
        """The same result with every tensor on ``device``."""

        def move(v: Any) -> Any:
            if isinstance(v, Tensor):
                return v.to(device)
            return {k: move(x) for k, x in v.items()} if isinstance(v, dict) else v

        return dataclasses.replace(self, **{f.name: move(getattr(self, f.name)) for f in dataclasses.fields(self)})  # type: ignore[type-var, arg-type]


@dataclass(frozen=True)
class Look:
    """What the scene looks like; all that the Gaussians depend on."""

    subject: str
    """The object, a noun or noun phrase ("burger")."""
    text: str
    """Refined sentence for a text encoder, without motion ("a DSLR photo of a rubber burger, ...")."""
    surface: str = ""
    """Material word that changes the colours ("sand", "gold"); empty when the object keeps its own."""
    negative: str = ""
    """What the image must not show."""


@dataclass(frozen=True)
class Motion:
    """What the scene is made of and what happens to it.

    All that material and trajectory depend on besides the particles.
    """

    verb: str
    """One of the motion words the scene table knows ("falling", "bouncing", "melting", ...)."""
    text: str
    """Refined sentence for a video model ("a rubber burger falling on a surface")."""
    materials: dict[str, str] = field(default_factory=dict)
    """Material word of each part ({"bun": "bread"}); the key "" is the whole object."""
    size: float = 0.5
    """Longest side of the object [m]."""
    negative: str = ""
    """What the clip must not show."""


@dataclass(frozen=True)
class Turn:
    """One turn of prompt refinement: a prompt, how good its picture is, what was said about it."""

    prompt: str
    """The words for an image encoder that were tried."""
    scores: dict[str, float] = field(default_factory=dict)
    """Similarity of the picture to this prompt ("current") and to the first one ("original"); empty without a score."""
    reply: dict[str, str] = field(default_factory=dict)
    """The refiner's chain of thought, step by step, the next prompt last; empty where it was not asked."""
    failure: str = ""
    """Why refinement ended here before its time."""


@dataclass(frozen=True)
class Prompt(Result):
    """A sentence, understood."""

    look: Look
    motion: Motion
    turns: tuple[Turn, ...] = ()
    """How a language model came to ``look.text``; empty if none was asked. No later stage depends on it."""

    @classmethod
    def _from_data(cls, data: dict[str, Any]) -> Self:
        turns = tuple(Turn(**t) for t in data.get("turns", ()))
        return cls(look=Look(**data["look"]), motion=Motion(**data["motion"]), turns=turns)


@dataclass(frozen=True)
class Camera:
    """C pinhole cameras of one image size."""

    viewmats: Tensor
    """World to camera, shape (C, 4, 4) [m]."""
    Ks: Tensor
    """Intrinsics, shape (C, 3, 3) [px]."""
    width: int
    height: int

    def __len__(self) -> int:
        return self.viewmats.shape[0]

    def __getitem__(self, index: Any) -> "Camera":
        """Cameras chosen by a slice, a list or an index tensor."""
        return Camera(self.viewmats[index], self.Ks[index], self.width, self.height)

    def to(self, device: torch.device | str) -> "Camera":
        return Camera(self.viewmats.to(device), self.Ks.to(device), self.width, self.height)


@dataclass(frozen=True)
class Gaussians(Result):
    """G anisotropic 3D Gaussians, in the frame of the object: centred near 0, longest side 2, z up, unitless."""

    means: Tensor
    """Centres, shape (G, 3)."""
    quats: Tensor
    """Orientations wxyz, not necessarily normalised, shape (G, 4)."""
    log_scales: Tensor
    """Logarithms of the three standard deviations, shape (G, 3)."""
    logit_opacities: Tensor
    """Logits of the opacities, shape (G,)."""
    sh: Tensor
    """Spherical-harmonic colour coefficients in the 3DGS basis, shape (G, (degree+1)², 3).

    At degree 0, rgb = 0.5 + sh / √(4π).
    """

    def __len__(self) -> int:
        return self.means.shape[0]


@dataclass(frozen=True)
class Particles(Result):
    """N material points at rest, in metres, centred on the origin of the object, resting on nothing yet."""

    x: Tensor
    """Positions, shape (N, 3) [m]."""
    vol: Tensor
    """Rest volumes, shape (N,) [m³]."""
    gaussian: Tensor
    """Index of the Gaussian each particle carries, −1 for interior filler, shape (N,), int64."""
    scale: float
    """Metres per object unit: x = scale · means + offset."""
    offset: tuple[float, float, float]
    """Shift from object frame to metres [m]."""
    spacing: float
    """Mean particle spacing [m]: (total volume / N)^⅓."""

    def __len__(self) -> int:
        return self.x.shape[0]


@dataclass(frozen=True)
class MaterialField(Result):
    """A mixture of constitutive laws for each of N particles."""

    elastic: tuple[str, ...]
    """Names of the elastic experts, columns of ``w_e``."""
    plastic: tuple[str, ...]
    """Names of the plastic experts, columns of ``w_p``."""
    w_e: Tensor
    """Elastic weights, rows on the simplex, shape (N, Ke)."""
    w_p: Tensor
    """Plastic weights, rows on the simplex, shape (N, Kp)."""
    theta: dict[str, Tensor]
    """Parameters by name (the union over the experts), each of shape (N,), SI units."""
    rho: Tensor
    """Density, shape (N,) [kg/m³]."""
    branches: tuple[str, ...] = ()
    """Names of the viscous branches beside the elastic experts; their parameters are in ``theta``."""

    def __len__(self) -> int:
        return self.rho.shape[0]


@dataclass(frozen=True)
class Trajectory(Result):
    """The motion of N particles over T frames; frame 0 is the initial state."""

    x: Tensor
    """Positions, shape (T, N, 3) [m]."""
    v: Tensor
    """Velocities, shape (T, N, 3) [m/s]."""
    F: Tensor
    """Total deformation gradients (they move the Gaussians), shape (T, N, 3, 3)."""
    fps: float
    """Frames per second of physical time [1/s]."""
    Fe: Tensor | None = None
    """Elastic deformation gradients (they make the stress), shape (T, N, 3, 3); None where nothing flows: then F."""


@dataclass(frozen=True)
class Clip(Result):
    """A film."""

    rgb: Tensor
    """Frames, values in [0, 1], shape (T, H, W, 3)."""
    fps: float
    """Frames per second of physical time [1/s]."""
    slow: float = 1.0
    """Seconds in which a second of physical time is played [-]: 4 is slow motion, four times."""
    alpha: Tensor | None = None
    """Coverage, shape (T, H, W), where the background is transparent; ``rgb`` then stands on white."""


@dataclass(frozen=True)
class Errors(Result):
    """How wrong a film is, estimated frame by frame; see ``errors.Estimate``."""

    com: Tensor
    """Error of the centre of mass, shape (T,) [m]."""
    shape: Tensor
    """Root mean square error of positions about the centre of mass, shape (T,) [m]."""
    pixels: Tensor
    """Root mean square error of where things are seen, shape (T,) [px]."""
    parts: dict[str, Tensor]
    """Root mean square differences of positions by cause, each (T,) [m]: ``grid`` (twice the grid spacing and time
    step), of which ``time`` (half the time step), and ``precision`` (float32 against float64) if asked for."""
    size: float
    """Longest side of the object [m]."""
    fps: float
    """Frames per second of physical time [1/s]."""
    order: float = 1.0
    """Order of convergence that the estimate supposes [-]."""
    why: str = ""
    """Why there is no estimate; empty if there is one."""

    @classmethod
    def missing(cls, frames: int, size: float, fps: float, why: str) -> "Errors":
        """No estimate: every number is NaN."""
        none = torch.full((frames,), float("nan"))
        return cls(none, none.clone(), none.clone(), {}, size, fps, why=why)

    @property
    def total(self) -> Tensor:
        """Root mean square error of positions, shape (T,) [m]."""
        return torch.hypot(self.com, self.shape)
