"""What was found, in words and as JSON."""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from diffuphy.doctor.machine import Machine
from diffuphy.doctor.needs import Need, gib
from diffuphy.models import Model, command, hub_cache
from diffuphy.models.cache import shown
from diffuphy.models.weights import size


@dataclass(frozen=True)
class Report:
    """A machine, the models that are known, and what the choices of the configuration need."""

    machine: Machine
    models: tuple[Model, ...]
    """In order of role and preference."""
    missing: Mapping[str, Sequence[str]]
    """Files of each id that are not on this machine."""
    reach: Mapping[str, str]
    """What the server of each id said; of none that was not asked."""
    broken: Mapping[str, Sequence[str]]
    """Files of each id whose bytes are not those that their names promise."""
    needs: tuple[Need, ...]

    def __str__(self) -> str:
        return "\n\n".join(
            f"{title}\n" + "\n".join(f"  {line}" for line in lines)
            for title, lines in (
                ("machine", self._machine()),
                ("models, by role, the preferred first; * from memory, read its card", self._models()),
                ("choices", self._choices()),
                ("to fetch what is not here", self._commands()),
            )
            if lines
        )

    def asdict(self) -> dict[str, Any]:
        """For programs."""
        return {
            "machine": dataclasses.asdict(self.machine),
            "models": [
                dataclasses.asdict(m)
                | {"bytes": m.bytes, "missing": list(self.missing[m.id]), "reach": self.reach.get(m.id)}
                | {"broken": list(self.broken.get(m.id, ())), "command": command(m.id)}
                for m in self.models
            ],
            "choices": [
                {
                    "choice": n.choice,
                    "models": [m.id for m in n.models],
                    "scores": [m.id for m in n.scores],
                    "also": list(n.also),
                    "bytes": n.bytes,
                    "verdict": n.verdict(self.machine),
                    "ready": not n.asks and not any(m.id in n.missing for m in n.models),
                }
                for n in self.needs
            ],
        }

    def present(self, wanted: str) -> bool:
        """Whether the preferred model of a role, or a model by its id, is whole on this machine."""
        model = next(m for m in self.models if wanted in (m.id, m.role))
        return not self.missing[model.id] and not self.broken.get(model.id)

    # ------------------------------------------------------------------ words
    def _machine(self) -> list[str]:
        m = self.machine
        built = f"built for CUDA {m.torch_cuda}" if m.torch_cuda else "built for CPUs"
        rows = [
            ("Python", m.python),
            ("torch", f"{m.torch}, {built}"),
            ("Warp", f"{m.warp}, built for CUDA {m.warp_cuda}" if m.warp_cuda else f"{m.warp}, built for CPUs"),
            ("driver", f"CUDA {m.driver}" if m.driver else "none"),
            ("CPU", f"{m.cores} cores, {gib(m.bytes)} of memory, {gib(m.free)} free"),
            *(("GPU", f"{g.name}, {gib(g.bytes)}, {gib(g.free)} free, compute {g.capability}") for g in m.gpus),
            *([] if m.gpus else [("GPU", "none")]),
            ("disk", f"{gib(m.disk)} free for weights in {shown(hub_cache())}"),
            ("packages", ", ".join(f"{name} {v}" for name, v in m.packages.items() if v)),
            ("absent", ", ".join(name for name, v in m.packages.items() if not v) or "none"),
        ]
        return [f"{what:<9} {said}" for what, said in rows]

    def _models(self) -> list[str]:
        rows = []
        for m in self.models:
            rows.append((m.role, self._state(m), m.id, size(m.bytes), terms(m), self.reach.get(m.id, "")))
        return table(rows)

    def _state(self, model: Model) -> str:
        if self.broken.get(model.id):
            return "broken"
        lacks = self.missing[model.id]
        needed = sum(part.kind != "file" for part in model.parts.values())
        return "here" if not lacks else "absent" if not needed or len(lacks) >= needed else "in part"

    def _choices(self) -> list[str]:
        """Scores that are left out are told where they are not those of the default."""
        rows, usual = [], {m.id for m in self.needs[0].scores}
        for n in self.needs:
            absent = [m.id for m in n.models if m.id in n.missing]
            scores = [m.id for m in n.scores if m.id in n.missing]
            said = [
                f"needs {', '.join(absent)}" if absent else "all is here" if n.models else "",
                n.verdict(self.machine),
                *n.also,
                f"without {', '.join(scores)} some scores are left out"
                if scores and (not n.choice or set(scores) - usual)
                else "",
            ]
            rows.append((n.choice or "(the default)", "; ".join(filter(None, said))))
        return table(rows)

    def _commands(self) -> list[str]:
        """Of each role the preferred model; one that several roles share once."""
        first = {m.role: m for m in reversed(self.models)}
        lines = {command(m.id): size(m.bytes) for m in reversed(first.values()) if self.missing[m.id]}
        return [f"{line}   # {amount}" for line, amount in lines.items()]


def terms(model: Model) -> str:
    """Licence, with a star where it was not read on the model's card."""
    star = "*" if "licence" in model.unverified else ""
    return f"{model.licence}{star}" + (" (non-commercial)" if model.noncommercial else "")


def table(rows: Sequence[Sequence[str]]) -> list[str]:
    """Rows in columns."""
    width = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join(f"{cell:<{w}}" for cell, w in zip(row, width, strict=True)).rstrip() for row in rows]
