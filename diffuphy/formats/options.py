"""What one may say about files."""

from dataclasses import dataclass
from pathlib import Path

from diffuphy.render.scenes.ply import QUARTER_TURNS, Up


@dataclass(frozen=True)
class Options:
    """Where files go and how fine they are."""

    folder: Path
    """Where files are written."""
    up: Up = "y_down"
    """Axes of .ply and of what is compressed from it: y_down is what splat viewers expect, z_up keeps the simulation's.
    Meshes are y_up in .glb, as that format says, and z_up in .obj and .ply."""
    every: int = 1
    """Write every so many frames, the first always."""
    gaussians: int = 20_000
    """Most Gaussians of the page that plays in a browser, of the object and of what stands around it each."""
    page_frames: int = 60
    """Most frames of it."""
    resolution: int = 96
    """Cells along the longest side of the object, for its surface."""
    around: bool = True
    """Write what stands around the object too, where a format holds Gaussians."""

    def __post_init__(self) -> None:
        if self.up not in QUARTER_TURNS:
            raise ValueError(f"up must be one of {', '.join(QUARTER_TURNS)}, got {self.up!r}")
        if self.every < 1 or self.gaussians < 1 or self.page_frames < 1:
            raise ValueError(
                "every, gaussians and page_frames must be at least 1, "
                f"got {self.every}, {self.gaussians} and {self.page_frames}"
            )
        if not 8 <= self.resolution <= 512:
            raise ValueError(f"resolution must be between 8 and 512 cells, got {self.resolution}")

    def frames(self, count: int) -> list[int]:
        """Frames that are written of ``count``."""
        return list(range(0, count, self.every))
