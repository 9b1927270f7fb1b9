"""The command line: ``python train.py prompt="a rubber burger falling"``, or ``diffuphy prompt=...`` when installed.

Hydra composes the settings from ``conf/``; everything heavy is imported after that, so help and misspelt settings
answer at once. A failure that the user can mend is one line on standard error and exit status 2; anything else is a bug
of ours and keeps its traceback, as does everything with ``HYDRA_FULL_ERROR=1``.
"""

import logging
import os
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from diffuphy.composing import conf_dir
from diffuphy.making import make_film
from diffuphy.quoting import FREE_TEXT, protect

if TYPE_CHECKING:
    from diffuphy.artifact import Done

log = logging.getLogger(__name__)


class Console(logging.StreamHandler):
    """Lines on standard error that do not tear a progress bar apart."""

    def emit(self, record: logging.LogRecord) -> None:
        from tqdm import tqdm

        tqdm.write(self.format(record), file=sys.stderr)


def film(cfg: DictConfig) -> None:
    """Make the film and say the last words."""
    from diffuphy.judgement import judgement
    from diffuphy.scorecard import line, scorecard

    made = make_film(cfg, Path(HydraConfig.get().runtime.output_dir))
    said, scores = judgement(made.done), scorecard(made.done)
    told = str(said or ""), line(scores) if scores else ""
    overrides = OmegaConf.to_container(HydraConfig.get().overrides.task, resolve=False)  # "${" in a text is none
    log.info("%s", conclusion(made.done, made.files, overrides, *told))  # type: ignore[arg-type]


def conclusion(
    done: Sequence["Done"], files: dict[str, Path], overrides: Sequence[str], error: str = "", scores: str = ""
) -> str:
    """The last words of a run: where the results are, how wrong and how good the film is, what each stage took, how to
    go on."""
    seconds = ", ".join(f"{d.name} {'cached' if d.cached else f'{d.seconds:.1f}'}" for d in done)
    command = " ".join([program(), *map(typed, overrides)])
    lines = [f"{kind:<10}{os.path.relpath(path)}" for kind, path in files.items()]
    lines += [f"{'error':<10}{error}"] if error else []
    lines += [f"{'scores':<10}{scores}"] if scores else []
    lines += [f"{'seconds':<10}{seconds}", f"{'again':<10}{command}"]
    if not any(o.startswith("experiment=") for o in overrides):
        lines.append(f"{'finer':<10}{command} experiment=quality")
    return "\n" + "\n".join(lines)


def program() -> str:
    """How this program was called, as one types it: the script, the module, or the installed command."""
    called = Path(sys.argv[0])
    if called.parts[-2:] == ("diffuphy", "__main__.py"):
        return "python -m diffuphy"
    return "diffuphy" if called.name == "diffuphy" else "python train.py"


def typed(override: str) -> str:
    """An override as one types it in a shell; free text without the quotes that Hydra needed."""
    key, _, value = override.partition("=")
    if key.rpartition(".")[2] not in FREE_TEXT:
        return shlex.quote(override)
    text = OmegaConf.create({"text": OverridesParser.create().parse_overrides([override])[0].value()}).text
    return f"{key}={shlex.quote(text if protect([f'{key}={text}']) == [override] else value)}"


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        argv: arguments without the program's name; by default those of the process.

    Returns:
        Exit status: 0 done, 2 an error the user can mend, 130 stopped by the keyboard.
    """
    arguments = protect(sys.argv[1:] if argv is None else argv)
    full = os.environ.get("HYDRA_FULL_ERROR")
    os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra raises instead of printing; what is printed is decided here
    try:
        if "store=" in arguments:
            raise ValueError("store is empty; name a folder, such as store=outputs")
        _compose_and_run(arguments)
        return 0
    except KeyboardInterrupt:
        print("\nstopped; run the same command to continue", file=sys.stderr)
        return 130
    except (Exception, Failure) as raised:
        error = raised.error if isinstance(raised, Failure) else raised
    finally:
        os.environ.pop("HYDRA_FULL_ERROR") if full is None else os.environ.update(HYDRA_FULL_ERROR=full)
    from diffuphy.explain import explain

    line = None if full not in (None, "", "0") else explain(error, arguments, conf_dir())
    if line is None:
        raise error
    print(f"error: {line}", file=sys.stderr)
    return 2


def _compose_and_run(arguments: list[str]) -> None:
    if any(a.startswith("hydra/launcher=ray") for a in arguments):
        os.environ.setdefault("RAY_ENABLE_UV_RUN_RUNTIME_ENV", "0")  # else "uv run" makes the workers hang
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    argv, sys.argv = sys.argv, [sys.argv[0], *arguments]
    try:
        hydra.main(version_base="1.3", config_path=str(conf_dir()), config_name="train")(_job)()
    finally:
        sys.argv = argv


class Failure(BaseException):
    """Carries the error of a single run past Hydra, which would report an ``Exception`` in several lines of its own."""

    def __init__(self, error: Exception):
        self.error = error


def _job(cfg: DictConfig) -> None:
    """One film. When it fails a run ends at once; a sweep makes its other films and ends with the first error."""
    try:
        film(cfg)
    except Exception as error:
        log.debug("failed", exc_info=True)  # the traceback goes into the log file of the run
        if HydraConfig.get().mode == RunMode.MULTIRUN:
            log.error("failed: %s: %s", type(error).__name__, " ".join(str(error).split()))
            raise
        raise Failure(error) from None
