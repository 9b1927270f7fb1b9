"""The six materials of a scene file as ours: laws, and parameters in the measures that ours are stated in."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from diffuphy.material.plastic import PLASTIC
from diffuphy.material.stated import Piece, StatedMaterial
from diffuphy.physgaussian.frame import Frame
from diffuphy.physgaussian.scene_file import SceneFile

SNOW_FRICTION = 30.0
"""Friction angle of snow where the file has none [deg], as of the material word "snow"."""


@dataclass(frozen=True)
class Substance:
    """One of the six materials."""

    elastic: str
    """Elastic law."""
    plastic: str
    """Plastic law."""
    theta: dict[str, float]
    """Its parameters besides E and ν [SI]."""
    remark: str
    """What its numbers mean here, and what differs on purpose."""
    uses: tuple[str, ...] = ()
    """Keys of the file that it reads, besides E, nu and density."""


def _jelly(file: SceneFile) -> Substance:
    return Substance("fixed_corotated", "identity", {}, "fixed corotated elasticity, as there")


def _uniaxial(norm: float) -> float:
    """σ_Y of |dev τ| = √(2/3) σ_Y from the norm [Pa]."""
    return math.sqrt(1.5) * norm


def _metal(file: SceneFile) -> Substance:
    """There |dev τ|_F = y + 2μ ξ Σ δγ, δγ the norm of the plastic strain; here √(2/3) (σ_Y + H √(2/3) Σ δγ)."""
    mu = file["E"] / (2 * (1 + file["nu"]))
    theta = {"yield_stress": _uniaxial(file["yield_stress"])}
    remark = "Hencky elasticity without the factor of one stretch too many; σ_Y = √(3/2) yield_stress, their norm"
    if file["hardening"]:
        theta |= {"hardening": 3 * mu * file["xi"], "residual": 0.0}
        law, remark = "von_mises_hardening", f"{remark}; H = 3μ xi"
    else:
        law = "von_mises"
    return Substance("hencky", law, theta, remark, ("yield_stress", "hardening", "xi"))


def _sand(file: SceneFile) -> Substance:
    theta = {"friction_angle": file["friction_angle"], "cohesion": 0.0}
    remark = "the same cone; grains remember their volume, there sand swells with every impact"
    return Substance("hencky", "drucker_prager", theta, remark, ("friction_angle",))


def _foam(file: SceneFile) -> Substance:
    """There s' = s − y/(1 + η/(2μ Δt)), here s − y μ Δt/(μ Δt + η): the same for half the number."""
    theta = {"yield_stress": file["yield_stress"], "viscosity": 0.5 * file["plastic_viscosity"]}
    remark = "Bingham; σ_Y = yield_stress, which is uniaxial there too; true shear viscosity η = plastic_viscosity/2"
    return Substance("hencky", "viscoplastic", theta, remark, ("yield_stress", "plastic_viscosity"))


def _snow(file: SceneFile) -> Substance:
    given = "friction_angle" in file.given
    own = {p.name: p.default for p in PLASTIC["cam_clay"].params if p.name not in ("E", "nu")}
    theta = own | {"friction_angle": file["friction_angle"] if given else SNOW_FRICTION}
    remark = (
        f"has stress: cohesive Cam-clay, p_Y = {own['preconsolidation']:g} Pa, ξ = {own['compaction']:g}, "
        f"β = {own['tension_ratio']:g}; there it has none"
    )
    return Substance("hencky", "cam_clay", theta, remark, ("friction_angle",))


def _plasticine(file: SceneFile) -> Substance:
    """There y falls by softening · δγ, so that (2/3) H = 2μ ξ − softening."""
    mu = file["E"] / (2 * (1 + file["nu"]))
    H = 3 * mu * file["xi"] * file["hardening"] - 1.5 * file["softening"]
    theta = {"yield_stress": _uniaxial(file["yield_stress"]), "hardening": H, "residual": 0.0}
    remark = (
        "fixed corotated; σ_Y = √(3/2) yield_stress, H = 3μ xi − (3/2) softening; with all strength lost it keeps its "
        "volume, there it is gone"
    )
    return Substance(
        "fixed_corotated", "von_mises_hardening", theta, remark, ("yield_stress", "softening", "hardening", "xi")
    )


SUBSTANCES: Mapping[str, Callable[[SceneFile], Substance]] = {
    "jelly": _jelly,
    "metal": _metal,
    "sand": _sand,
    "foam": _foam,
    "snow": _snow,
    "plasticine": _plasticine,
}
"""The value of ``material`` → what it is here."""

STRENGTHS = ("yield_stress", "hardening", "xi", "softening", "friction_angle", "plastic_viscosity")
"""Keys that only some materials read."""


def matter(file: SceneFile) -> StatedMaterial:
    """The material of a scene file: one for the whole body, with E, ν and density of its own in each region.

    Hardening follows the shear modulus of its region.
    """
    frame = Frame(file["mpm_space_vertical_upward_axis"])
    pieces = [_piece(file)]
    for region in file.regions:
        low, high = frame.corners(region["point"], region["size"])
        pieces.append(_piece(_with(file, region), low, high))
    return StatedMaterial(tuple(pieces))


def _with(file: SceneFile, region: Mapping[str, float]) -> SceneFile:
    """The file as if it were about one region."""
    own = {k: region[k] for k in ("E", "nu", "density")}
    return SceneFile({**file.values, **own}, file.given, file.conditions, file.regions, file.filling, file.unknown)


def _piece(file: SceneFile, low: tuple | None = None, high: tuple | None = None) -> Piece:
    substance = SUBSTANCES[file["material"]](file)
    theta = {"E": file["E"], "nu": file["nu"], **substance.theta}
    return Piece(substance.elastic, substance.plastic, file["density"], theta, low, high)
