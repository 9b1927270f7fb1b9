"""The web server of the viewer (viser): where it listens, and what to type to see it."""

import contextlib
import io
import logging
import socket
from typing import Any

LOCAL = "127.0.0.1"
"""The address that only this machine reaches."""

PORT = 8080
"""Where it listens unless told otherwise."""


def serve(host: str = LOCAL, port: int = PORT, *, title: str = "diffuphy") -> Any:
    """Start a server, on the next free port if this one is taken.

    Args:
        host: address to listen at; others than ``LOCAL`` are reached from outside.
        port: first port to try.

    Returns:
        The ``viser.ViserServer``.

    Raises:
        ValueError: a port that there is not.
        ModuleNotFoundError: viser is not installed.
    """
    if not 1024 <= port <= 65535:
        raise ValueError(f"port must be between 1024 and 65535, got {port}")
    import viser

    logging.getLogger("websockets").setLevel(logging.WARNING)
    with contextlib.redirect_stdout(io.StringIO()):  # it greets with the address alone
        server = viser.ViserServer(host=host, port=port, label=title, verbose=False)
    server.gui.configure_theme(show_share_button=False, show_logo=False, control_width="medium")
    server.scene.set_up_direction("+z")
    return server


def directions(host: str, asked: int, port: int) -> str:
    """How to get to the page."""
    lines = [f"port {asked} is taken, took {port}"] if port != asked else []
    lines += [
        f"open     http://localhost:{port}",
        f"by ssh   ssh -L {port}:localhost:{port} {socket.gethostname()}",
        "end      Ctrl-C",
    ]
    if host != LOCAL:
        lines.append(f"warning: listening at {host}: whoever reaches this machine can run simulations and write files")
    return "\n".join(lines)
