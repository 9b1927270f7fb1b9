"""Which frame is shown when."""


class Player:
    """A position in a film that moves with time.

        t ← t + speed · fps · Δ,    back to 0 at the end if it is to be shown again and again

    Args:
        frames: how many there are.
        fps: frames per second of physical time [1/s].
    """

    def __init__(self, frames: int, fps: float):
        self.frames, self.fps = frames, fps
        self.position = 0.0
        """Between 0 and ``frames``; its whole part is the frame shown."""
        self.playing = True
        self.loop = True
        self.speed = 1.0
        """Seconds of physical time shown in a second [-]."""

    @property
    def frame(self) -> int:
        """The frame shown."""
        return min(int(self.position), self.frames - 1)

    def load(self, frames: int, fps: float) -> None:
        """Begin another film."""
        self.frames, self.fps, self.position = frames, fps, 0.0

    def seek(self, frame: int) -> None:
        """Show a frame, and go on from there."""
        self.position = float(min(max(frame, 0), self.frames - 1))

    def toggle(self) -> None:
        """Play or pause; from the beginning, if the end has been reached."""
        if not self.playing and self.frame == self.frames - 1:
            self.position = 0.0
        self.playing = not self.playing

    def advance(self, seconds: float) -> int:
        """The frame to show ``seconds`` later."""
        if self.playing:
            self.position += self.speed * self.fps * seconds
            if self.position >= self.frames:
                if self.loop:
                    self.position %= self.frames
                else:
                    self.position, self.playing = self.frames - 1.0, False
        return self.frame
