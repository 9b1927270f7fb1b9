"""Frames follow the clock."""

import pytest

from diffuphy.viewer.player import Player


def test_the_frame_is_that_of_the_time_that_has_passed():
    """t = speed · fps · Σ Δ, however the time is cut into pieces."""
    player = Player(frames=60, fps=30.0)
    player.speed = 0.5
    for _ in range(7):
        player.advance(0.25)
    assert player.advance(0.25) == int(0.5 * 30 * 2.0)


def test_a_loop_goes_on_at_the_beginning_and_nothing_else_does():
    player = Player(frames=10, fps=10.0)
    assert player.advance(1.25) == 2
    player.loop = False
    assert player.advance(5.0) == 9 and not player.playing
    player.toggle()
    assert player.playing and player.frame == 0


@pytest.mark.parametrize(("asked", "got"), [(-3, 0), (4, 4), (99, 9)])
def test_a_frame_that_is_sought_is_one_that_there_is(asked, got):
    player = Player(frames=10, fps=10.0)
    player.seek(asked)
    assert player.frame == got


def test_a_pause_holds_the_frame():
    player = Player(frames=10, fps=10.0)
    player.advance(0.35)
    player.toggle()
    assert player.advance(100.0) == 3
