"""What the laws of a scene ask for."""

import dataclasses
from collections.abc import Mapping
from typing import Any

from diffuphy.material import PLASTIC, make_mixture
from diffuphy.material.presets import candidates
from diffuphy.plan.line import Line
from diffuphy.types import MaterialField, Motion


def experts(material: Any, motion: Motion) -> tuple[tuple[str, ...], tuple[str, ...], str]:
    """Candidate experts: those the configuration names, else those the materials of the prompt may be; those of a rival
    are its own affair."""
    if hasattr(material, "experts"):
        return material.experts(motion)
    if hasattr(material, "words"):
        return material.elastic, material.plastic, f"what the labels are made of: {', '.join(material.words)}"
    words = sorted(set(motion.materials.values()))
    elastic, plastic = candidates(words, melting=motion.verb == "melting")
    chosen = (tuple(material.elastic) or elastic, tuple(material.plastic) or plastic)
    why = "named in the configuration" if material.elastic or material.plastic else f"what {', '.join(words)} may be"
    return (*chosen, why)


def mixture_lines(components: Mapping[str, Any]) -> list[Line]:
    """Parts of a mixture that only some laws need."""
    fit = components["material"]
    elastic, plastic = fit.elastic, fit.plastic
    mixture = make_mixture(elastic, plastic)
    flows = [p for p in plastic if p != "identity"]
    remember = [p for p in plastic if PLASTIC[p].memory]
    gradients = (
        Line("deformation gradients", "two", "the elastic part makes stress, the total one moves the Gaussians")
        if mixture.is_plastic
        else Line("deformation gradients", "one", "without plasticity the elastic part is the total one")
    )

    def other(**laws: tuple[str, ...]) -> dict[str, Any]:
        if hasattr(fit, "experts") or hasattr(fit, "expected"):
            return {}  # its laws are its own affair: there is no run of it that had others
        return {"material": dataclasses.replace(fit, **laws)}

    more = next(e for e in ("neo_hookean", "fixed_corotated") if e not in elastic or len(elastic) > 1)
    return [
        Line.kept("return mapping", bool(flows), f"{', '.join(flows)} may flow", "nothing flows",
                  other(plastic=(*plastic, "von_mises"))),
        gradients,
        Line.kept("principal decomposition", mixture.decomposes, "some expert works in principal stretches",
                  "every expert has a direct form", other(elastic=("hencky",))),
        Line.kept("mixture weights", len(elastic) * len(plastic) > 1,
                  f"{len(elastic)} elastic, {len(plastic)} plastic experts", "one law",
                  other(elastic=(*elastic, more) if more not in elastic else elastic)),
        Line.kept("memory", bool(remember), f"{', '.join(remember)} hardens or heats", "no law remembers",
                  other(plastic=(*(p for p in plastic if p != "von_mises"), "von_mises_hardening"))),
        Line.kept("viscous branch", bool(getattr(fit, "branches", ())), "each particle has a Maxwell branch",
                  "no material of the table relaxes; MaterialField.branches adds one"),
    ]  # fmt: skip


def pruned_lines(
    field: MaterialField, candidates: Mapping[str, tuple[str, ...]], numbers: Mapping[str, float]
) -> list[Line]:
    """What the training has left of the candidates.

    Args:
        field: the trained material.
        candidates: names of the experts before it, ``elastic`` and ``plastic``.
        numbers: the summary of the material stage.
    """
    lines = []
    for kind, names in candidates.items():
        gone = [name for name in names if name not in getattr(field, kind)]
        left = ", ".join(getattr(field, kind))
        if gone:
            moved = numbers.get("pruning_change")
            said = "" if moved is None else f"; a drop moves by {moved:.1e} of its size"
            lines.append(Line(f"{kind} experts of the film", left, f"{', '.join(gone)}: no particle follows it{said}"))
    return lines
