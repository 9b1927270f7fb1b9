"""``python -m diffuphy.viewer RUN``, or ``diffuphy-view RUN`` when installed."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from diffuphy.composing import conf_dir, device, set_threads
from diffuphy.viewer.server import LOCAL, PORT, directions, serve


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(prog="diffuphy-view", description="A finished run in a browser.")
    p.add_argument("run", type=Path, help="folder of the run, such as outputs/runs/NAME")
    p.add_argument("--host", default=LOCAL, help=f"address to listen at ({LOCAL}: this machine only)")
    p.add_argument("--port", type=int, default=PORT, help=f"first port to try ({PORT})")
    p.add_argument("--device", default="auto", help="where simulations run: auto, cpu, cuda, cuda:1, ...")
    p.add_argument("--threads", type=int, default=1, help="of torch on the CPU (1)")
    return p


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Returns:
        Exit status: 0 done, 2 an error the user can mend.
    """
    options = parser().parse_args(argv)
    try:
        set_threads(options.threads)
        from diffuphy.viewer.opened import Run
        from diffuphy.viewer.page import Page
        from diffuphy.viewer.session import Session

        session = Session(Run.open(options.run, device(options.device)))
        server = serve(options.host, options.port, title=options.run.resolve().name)
        page = Page(session, server)
    except KeyboardInterrupt:
        return 130
    except Exception as error:
        from diffuphy.explain import explain

        line = explain(error, [], conf_dir())
        if line is None:
            raise
        print(f"error: {line}", file=sys.stderr)
        return 2
    print(directions(options.host, options.port, server.get_port()), flush=True)
    page.run()
    return 0


if __name__ == "__main__":
    sys.exit(main())
