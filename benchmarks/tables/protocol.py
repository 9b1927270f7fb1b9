"""What is run for each table: prompts, methods, sizes, as settings of ``train.py``."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

PAPER = (
    "a rubber burger falling on a surface",
    "a gravel pile falling then collapsing",
    "pancakes melting",
    "a jelly bouncing",
)
"""Prompts of the paper's table 2."""

PROMPTS = (
    *PAPER,
    "a sand snowman collapsing",
    "a clay duck falling",
    "a butter cube being squashed",
    "a jelly burger with clay patty falling",
)
"""And four more: grains and a plastic body, a moving plate, two materials in one object."""

METHODS: Mapping[str, tuple[str, ...]] = {
    "PhysGaussian": ("method=physgaussian",),
    "DreamPhysics": ("method=dreamphysics",),
    "Physics3D": ("method=physics3d",),
    "PhysDreamer": ("method=physdreamer",),
    "OmniPhysGS": ("method=omniphysgs",),
    "DiffuPhyGS": ("method=diffuphygs",),
    "given": ("method=physgaussian", "rival.values=table"),
}
"""Settings by the name in a table. ``given`` is told what the prior knows of the whole object: what is left is mostly
the error of the simulation, and of an object with parts what one material cannot be."""

OURS, GIVEN = "DiffuPhyGS", "given"

ABLATIONS: Mapping[str, tuple[str, ...]] = {
    "full": (),
    "w/o mixture": ("ablation=mixture",),
    "w/o velocity loss": ("ablation=velocity",),
    "printed velocity loss": ("material.velocity.form=literal", "material.velocity.weight=0.2"),
    "w/o video prior": ("ablation=video_prior",),
    "w/o prompt refinement": ("ablation=refinement",),
    "w/o scan": ("ablation=scan",),
    "w/o patches": ("ablation=patches",),
    "w/o DAS": ("ablation=densification",),
    "w/o shape prior": ("ablation=shape_prior",),
}
"""The four of the paper's table 4, then others. Our velocity loss is weak by default, so beside its absence stands the
paper's, in its printed form and weight."""

WHOLE = "full"
"""The row that others are compared with."""

ANOTHER = ("w/o prompt refinement", "w/o DAS", "w/o shape prior")
"""Rows that make an object of their own."""

OBJECTS: Mapping[str, tuple[str, ...]] = {
    "full": (),
    "w/o DAS": ABLATIONS["w/o DAS"],
    "w/o DAS, its last number": (*ABLATIONS["w/o DAS"], "fit.init.count=8000"),
    "w/o shape prior": ABLATIONS["w/o shape prior"],
}
"""What acts on the object alone. Splitting is two things, places and a number: with the number of its end from the
start, only the places are left."""

FUZZY: Mapping[str, str] = {
    "a tiny duck made of clay tumbling down": "a tiny clay duck falling",
    "a burger with a jelly patty, made of rubber, dropped": "a rubber burger with jelly patty falling",
    "a snowman with a wooden hat, all of sand, crumbles": "a sand snowman with wooden hat collapsing",
    "a 30 cm jelly cube that hops around": "a 30 cm jelly cube bouncing",
}
"""Sentences as people write them, and what they mean."""

REFINEMENT: Mapping[str, tuple[str, ...]] = {"refined": (), "as written": ("ablation=refinement",)}

SIZES: Mapping[str, tuple[str, ...]] = {"small": ("experiment=table",), "default": ()}
"""How much work a run is."""


@dataclass(frozen=True)
class Task:
    """One object, and what is done with it: runs that share their first stages."""

    prompt: str
    seed: int
    variants: Mapping[str, tuple[str, ...]]
    """Settings of each run by its name."""
    meant: str = ""
    """The sentence whose object and motion were meant, as it is read with nothing left out: everything that changes the
    object is compared with these as well. Empty where all variants share their object."""

    def overrides(self, variant: str, size: str, device: str) -> list[str]:
        """Settings of one run, in the order in which ``train.py`` takes them."""
        return [
            f"prompt={self.prompt}", f"seed={self.seed}", f"device={device}", "report.error=off",
            *SIZES[size], *self.variants[variant],
        ]  # fmt: skip


def tasks(
    prompts: Sequence[str], seeds: Sequence[int], variants: Mapping[str, tuple[str, ...]], meant: Mapping[str, str]
) -> list[Task]:
    """Every prompt with every seed."""
    return [Task(p, s, variants, meant.get(p, "")) for p in prompts for s in seeds]
