"""``python -m diffuphy.doctor``, or ``diffuphy-doctor`` when installed."""

import argparse
import hashlib
import json
import re
import sys
from collections.abc import Iterator, Sequence
from typing import Any

from diffuphy.composing import conf_dir, make
from diffuphy.doctor.machine import Machine
from diffuphy.doctor.needs import Need, choices, need
from diffuphy.doctor.reach import reach
from diffuphy.doctor.report import Report
from diffuphy.models import Model, place, roles
from diffuphy.models.cache import kept


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(prog="diffuphy-doctor", description="What this machine can run, and what to fetch.")
    p.add_argument("--offline", action="store_true", help="do not ask whether the models can be reached")
    p.add_argument("--timeout", type=float, default=3.0, metavar="SECONDS", help="for an answer of a server (3)")
    p.add_argument("--verify", action="store_true", help="hash the files that are here: 1 to 2 GB a second")
    p.add_argument("--json", action="store_true", help="for programs")
    wanted = "exit with 1 unless the preferred model of this role, or the one of this id, is here"
    p.add_argument("--require", action="append", default=[], metavar="ROLE", help=wanted)
    return p


def examine(*, ask: bool, timeout: float = 3.0, verify: bool = False) -> Report:
    """Look at machine, weights and configuration.

    Args:
        ask: whether models can be reached.
        timeout: of each question [s].
        verify: hash the files that are here.
    """
    models = tuple(m for known in roles().values() for m in known)
    missing = {m.id: m.missing() for m in models}
    return Report(
        machine=Machine.this(),
        models=models,
        missing=missing,
        reach=reach(models, timeout) if ask else {},
        broken={m.id: list(broken(m)) for m in models if not missing[m.id]} if verify else {},
        needs=tuple(needs()),
    )


def needs() -> Iterator[Need]:
    """Of every choice of the configuration. Its components are made, and are settings: nothing is loaded."""
    from hydra import compose, initialize_config_dir
    from hydra.errors import InstantiationException
    from omegaconf import OmegaConf

    with initialize_config_dir(str(conf_dir()), version_base="1.3"):
        for choice in choices(conf_dir()):
            cfg = compose("train", overrides=["prompt=a rubber burger falling", *filter(None, [choice])])
            settings: Any = OmegaConf.to_container(cfg, resolve=True)
            try:
                yield need(choice, make(settings["stages"]))
            except InstantiationException as e:
                yield Need(choice, (), (), None, asks=str(e.__cause__ or e))


def broken(model: Model) -> Iterator[str]:
    """Files whose bytes are not those promised: by the registry, or by the cache of the hub, which names large files by
    their SHA-256."""
    known = dict(model.sha256 or {})
    folder = kept(model.url).parent if model.url else place(model.id, model.revision)
    files = [kept(model.url)] if model.url else sorted(f for f in folder.rglob("*") if f.is_file()) if folder else []
    for file in files:
        name = model.id if model.url or folder is None else file.relative_to(folder).as_posix()
        promised = known.get(name) or (file.resolve().name if file.is_symlink() else "")
        if re.fullmatch(r"[0-9a-f]{64}", promised):
            with file.open("rb") as stream:
                if hashlib.file_digest(stream, "sha256").hexdigest() != promised:
                    yield name


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Returns:
        Exit status: 0, or 1 if something that is required is not here.
    """
    options = parser().parse_args(argv)
    names = {name for role, models in roles().items() for name in (role, *(m.id for m in models))}
    if unknown := set(options.require) - names:
        parser().error(f"--require: {', '.join(sorted(unknown))} is no role; roles are {', '.join(roles())}")
    report = examine(ask=not options.offline, timeout=options.timeout, verify=options.verify)
    print(json.dumps(report.asdict(), indent=1) if options.json else report)
    absent = [name for name in options.require if not report.present(name)]
    if absent:
        print(f"not here: {', '.join(absent)}", file=sys.stderr)
    return 1 if absent else 0


if __name__ == "__main__":
    sys.exit(main())
