"""How good a film is, in numbers: words, structure, video statistics, pictures and physics; ``docs/metrics.md``."""

from diffuphy.metrics.score import Score, Scores, across, estimate

__all__ = ["Score", "Scores", "across", "estimate"]
