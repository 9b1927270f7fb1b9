"""What a cost is."""

from dataclasses import dataclass, field


@dataclass(frozen=True)
class StageCost:
    """Predicted price of one stage, or of one rollout."""

    seconds: float
    """Time on a machine that does nothing else [s]."""
    bytes: int
    """Peak resident memory of the process [byte]; of a single rollout: what its tensors take."""
    processor: float = 0.0
    """The same work as processor time of all threads together [s]."""
    work: dict[str, float] = field(default_factory=dict)
    """How often each unit of ``coefficients.json`` is done."""


@dataclass(frozen=True)
class Cost:
    """Predicted price of a run."""

    stages: dict[str, StageCost]
    """By stage, in the order in which they run."""
    machine: str = ""
    """The machine on which the coefficients were measured, and how much faster this one is."""

    @property
    def seconds(self) -> float:
        """All stages [s]."""
        return sum(s.seconds for s in self.stages.values())

    @property
    def processor(self) -> float:
        """Processor time of all stages [s]."""
        return sum(s.processor for s in self.stages.values())

    @property
    def bytes(self) -> int:
        """The largest peak of a stage [byte]."""
        return max((s.bytes for s in self.stages.values()), default=0)
