"""The command line: what it accepts, what it says when something is wrong, and that it answers at once."""

import logging
import os
import re
import resource
import shlex
import shutil
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import pytest
from hydra.core.hydra_config import HydraConfig

from diffuphy import cli, composing
from diffuphy.cli import main
from diffuphy.composing import conf_dir, slug
from diffuphy.explain import nearest
from diffuphy.quoting import protect

ROOT = Path(__file__).parents[1]


class Diverging(RuntimeError):
    """Stands for any error that is a bug."""


@pytest.fixture
def conf(tmp_path, monkeypatch):
    """A small tree of settings with the real logging and folders, and a film that only remembers its settings."""
    folder = tmp_path / "conf"
    shutil.copytree(conf_dir() / "hydra", folder / "hydra")
    text = (conf_dir() / "train.yaml").read_text(encoding="utf-8")
    (folder / "train.yaml").write_text(
        "defaults: [fit: sds, guidance: analytic, _self_, experiment: null, override hydra/help: film,\n"
        "  override hydra/job_logging: lines, override hydra/hydra_logging: lines]\n"
        f"prompt: ???\nseed: 0\nstore: {tmp_path}/outputs\ndevice: auto\nthreads: 1\nuntil: clip\nforce: []\n"
        "outputs: [mp4]\nviewer: 'off'\naccuracy: null\ncheckpoint_seconds: 3\n"
        "stages: {clip: '${clip}'}\nclip: {_target_: fractions.Fraction, _args_: ['${prompt}']}\n"
        + text[text.index("\nhydra:") :]
    )
    for name, lines in {
        "fit/sds": "_target_: diffuphy.quoting.protect\nsteps: 5\nlr: 0.1",
        "fit/step": "_target_: tests.missing.Fit\nsteps: 1",
        "guidance/analytic": "s: 0.05",
        "guidance/stable_diffusion": "scale: 100",
        "experiment/tiny": "# @package _global_\nfit: {steps: 1}",
    }.items():
        (folder / f"{name}.yaml").parent.mkdir(exist_ok=True)
        (folder / f"{name}.yaml").write_text(lines + "\n")
    monkeypatch.setattr(cli, "conf_dir", lambda: folder)
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    yield folder
    root.handlers[:] = handlers
    root.setLevel(level)


@pytest.fixture
def films(conf, monkeypatch):
    seen = []
    monkeypatch.setattr(cli, "film", lambda cfg: seen.append((cfg, HydraConfig.get().runtime.output_dir)))
    return seen


def failing(monkeypatch, error):
    def film(cfg):
        raise error

    monkeypatch.setattr(cli, "film", film)


def test_prompt_and_settings_arrive(films, tmp_path):
    text = "a dog's ball (red), $5 = 果冻 ${x} \\"
    assert main([f"prompt={text}", "fit.steps=7", "experiment=tiny"]) == 0
    ((cfg, folder),) = films
    assert (cfg.prompt, cfg.fit.steps, cfg.fit.lr) == (text, 7, 0.1)
    assert Path(folder) == tmp_path / "outputs/runs" / slug(text)


def test_same_command_same_folder(films):
    main(["prompt=a ball", "seed=1"])
    main(["prompt=a ball", "seed=1"])
    main(["prompt=a bell", "seed=1"])
    folders = [folder for _, folder in films]
    assert folders[0] == folders[1] != folders[2]


def test_a_sweep_has_a_folder_for_every_film(films):
    assert main(["-m", "prompt=a dog's ball,果冻", "seed=1,2"]) == 0
    assert [(cfg.prompt, cfg.seed) for cfg, _ in films] == [(p, s) for p in ("a dog's ball", "果冻") for s in (1, 2)]
    assert len({folder for _, folder in films}) == 4


def test_settings_are_kept_in_the_run_folder(films):
    main(["prompt=a ball", "seed=3"])
    assert "seed: 3" in (Path(films[0][1]) / ".hydra/config.yaml").read_text()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ([], 'prompt is missing; write prompt="a rubber burger falling"'),
        (["prompt=a", "fit.stpes=1"], "did you mean fit.steps?"),
        (["prompt=a", "sed=1"], "did you mean seed?"),
        (["prompt=a", "stpes=1"], "did you mean fit.steps?"),
        (["prompt=a", "gidance=analytic"], "did you mean guidance?"),
        (["prompt=a", "experiment=tinny"], "did you mean experiment=tiny?"),
        (["prompt=a", "guidance=zebra"], "the options are analytic, stable_diffusion"),
        (["prompt=a", "zebra=1"], "--help lists all settings"),
        (["prompt=a", "seed=[1"], "cannot read 'seed=[1'"),
        (["prompt=a", "seed=1,2"], "add --multirun"),
        (["-m", "prompt=a,b", "seed=1,2", "fit.stpes=1,2"], "did you mean fit.steps?"),
        (["-cn", "trian", "prompt=a"], "Cannot find primary config 'trian'"),
    ],
)
def test_wrong_argument_is_one_line(films, capsys, arguments, says):
    """Status 2, one line that names what would be right, no film, no folder."""
    assert main(arguments) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ") and says in line
    assert films == []


def test_setting_at_its_default_is_known_by_its_field(conf, capsys):
    """A field that the YAML does not list needs a plus; a field misspelt is still found."""
    (conf / "fit/sds.yaml").write_text("_target_: hydra.core.override_parser.types.QuotedString\ntext: a\n")
    assert main(["prompt=a", "fit.quote=1"]) == 2
    assert "write +fit.quote=1" in capsys.readouterr().err
    assert main(["prompt=a", "fit.qoute=1"]) == 2
    assert "did you mean +fit.quote?" in capsys.readouterr().err


@pytest.mark.parametrize(
    "error", [ValueError("nu must be in\n[0, 0.5), got 2"), OSError(28, "No space left on device")]
)
def test_failure_of_a_film_is_one_line(conf, monkeypatch, capsys, tmp_path, error):
    failing(monkeypatch, error)
    assert main(["prompt=a ball"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line == "error: " + " ".join(str(error).split())
    assert "Traceback" in (tmp_path / "outputs/runs" / slug("a ball") / "log.txt").read_text()


def test_divergence_is_one_line(conf, monkeypatch, capsys):
    from diffuphy.types import SimulationDiverged

    failing(monkeypatch, SimulationDiverged("particle 3 left the grid; lower scene.cfl"))
    assert main(["prompt=a ball"]) == 2
    assert capsys.readouterr().err == "error: particle 3 left the grid; lower scene.cfl\n"


def test_component_that_refuses_its_settings_is_named(conf, monkeypatch, capsys):
    from hydra.utils import instantiate

    monkeypatch.setattr(cli, "film", lambda cfg: instantiate(cfg.stages))
    assert main(["prompt=a ball"]) == 2
    assert capsys.readouterr().err == "error: stages.clip: Invalid literal for Fraction: 'a ball'\n"
    assert main(["prompt=1/2", "clip._target_=fractions.Fractoin"]) == 2
    assert capsys.readouterr().err.startswith("error: stages.clip: ")


def test_film_hands_components_to_the_pipeline(conf, monkeypatch, tmp_path):
    """Objects are made once, the device is a device, and the run folder is Hydra's."""
    import torch

    from diffuphy import pipeline
    from diffuphy.plan import Plan

    calls = []

    def run(components, **settings):
        calls.append((components, settings))
        return [], Plan(components, ())

    monkeypatch.setattr(pipeline, "run", run)
    assert main(["prompt=3/4", "until=material", "force=[prompt]"]) == 0
    ((components, settings),) = calls
    assert components == {"clip": Fraction(3, 4)}
    store = settings.pop("store")
    assert store.device == ("cuda" if torch.cuda.is_available() else "cpu")
    assert store.interval == 3
    assert settings == {
        "until": "material",
        "force": ["prompt"],
        "run_dir": tmp_path / "outputs/runs" / slug("3/4"),
        "accuracy": None,
    }


@pytest.mark.parametrize(
    "text", ["a ${x}", "\\${x}", "\\\\${prompt} \\ ${", "${", "$${x}", "a\\", "\\\\\\${seed}", "果冻, it's"]
)
def test_a_component_gets_the_words_as_they_are(text):
    """However dollars and backslashes stand in them."""
    (made,) = composing.make({"prompt": {"_target_": "collections.UserString", "_args_": [text]}}).values()
    assert made == text


def test_missing_extra_is_named(conf, monkeypatch, capsys):
    failing(monkeypatch, ModuleNotFoundError("No module named 'gsplat'", name="gsplat"))
    assert main(["prompt=a ball"]) == 2
    assert capsys.readouterr().err == "error: gsplat is not installed; run: pip install 'diffuphy[gsplat]'\n"


def test_bug_keeps_its_traceback(conf, monkeypatch):
    failing(monkeypatch, Diverging("a bug"))
    with pytest.raises(Diverging, match="a bug"):
        main(["prompt=a ball"])


def test_full_error_shows_everything(conf, monkeypatch):
    monkeypatch.setenv("HYDRA_FULL_ERROR", "1")
    failing(monkeypatch, ValueError("nu"))
    with pytest.raises(ValueError, match="nu"):
        main(["prompt=a ball"])
    assert os.environ["HYDRA_FULL_ERROR"] == "1"


def test_interrupt_says_how_to_continue(conf, monkeypatch, capsys):
    failing(monkeypatch, KeyboardInterrupt())
    assert main(["prompt=a ball"]) == 130
    assert capsys.readouterr().err.strip() == "stopped; run the same command to continue"


def test_a_sweep_goes_on_after_a_failure(conf, monkeypatch, capsys):
    seen = []

    def film(cfg):
        seen.append(cfg.seed)
        if cfg.seed == 1:
            raise ValueError("nu")

    monkeypatch.setattr(cli, "film", film)
    assert main(["-m", "prompt=a ball", "seed=1,2"]) == 2
    assert seen == [1, 2]
    assert capsys.readouterr().err.endswith("error: nu\n")


def test_log_is_one_line_an_event(conf, monkeypatch, capsys, tmp_path):
    def film(cfg):
        logging.getLogger("diffuphy.mpm").info("step %d", 3)
        logging.getLogger("other").debug("noise")

    monkeypatch.setattr(cli, "film", film)
    main(["prompt=a ball"])
    output = capsys.readouterr()
    assert output.out == ""
    assert re.fullmatch(r"\d\d:\d\d:\d\d  step 3\n", output.err)
    assert (
        (tmp_path / "outputs/runs" / slug("a ball") / "log.txt").read_text().endswith("INFO    diffuphy.mpm: step 3\n")
    )


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("gpu", "device must be auto, cpu, cuda or cuda:1, got 'gpu'"),
        ("cuda:x", "device must be"),
        ("mps", "device must be"),
        ("cuda", "device=cuda: there is no CUDA device; use device=cpu or device=auto"),
        ("cuda:2", "device=cuda:2: there is no CUDA device"),
    ],
)
def test_a_device_that_is_not_there_is_refused(monkeypatch, name, says):
    import torch

    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(ValueError, match=re.escape(says)):
        composing.device(name)
    assert composing.device("auto") == composing.device("cpu") == "cpu"


def test_a_device_beyond_the_last_is_refused(monkeypatch):
    import torch

    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    assert [composing.device(n) for n in ("auto", "cuda", "cuda:1")] == ["cuda", "cuda", "cuda:1"]
    with pytest.raises(ValueError, match="cuda:0 to cuda:1 are there"):
        composing.device("cuda:2")


@pytest.mark.parametrize(
    ("argument", "shown"),
    [
        ("prompt=a rubber ball", "prompt='a rubber ball'"),
        ("prompt=ball", "prompt=ball"),
        ("prompt='a, b'", "prompt='a, b'"),
        ("refine.negative=blur, noise", "refine.negative='blur, noise'"),
        ("force=[clip]", "'force=[clip]'"),
        ("seed=1", "seed=1"),
    ],
)
def test_command_is_shown_as_typed(argument, shown):
    """The same words after the shell and ``protect`` have read what is shown."""
    (override,) = protect([argument])
    assert cli.typed(override) == shown
    assert protect(shlex.split(shown)) == [override]


@pytest.mark.parametrize(
    "text", ["a dog's ball, $5 ${x} \\", "果冻 🍔 #1 [a] = {b}", "it's\n'so'", "'quoted'", "$(date)", "!!"]
)
def test_shown_command_gives_the_same_prompt(text):
    (override,) = protect([f"prompt={text}"])
    assert protect(shlex.split(cli.typed(override))) == [override]


def test_number_of_threads_is_that_of_the_settings(conf, monkeypatch, capsys):
    import torch

    from diffuphy import pipeline
    from diffuphy.plan import Plan

    before, seen = torch.get_num_threads(), []
    monkeypatch.setattr(pipeline, "run", lambda c, **_: seen.append(torch.get_num_threads()) or ([], Plan(c, ())))
    try:
        assert main(["prompt=1/2"]) == main(["prompt=1/2", "threads=2"]) == 0
        assert main(["prompt=1/2", "threads=0"]) == 2
    finally:
        torch.set_num_threads(before)
    assert seen == [1, 2]
    assert capsys.readouterr().err.endswith("error: threads must be at least 1, got 0\n")


def test_one_stage_may_be_forced_by_name(conf, monkeypatch):
    """force=prompt is force=[prompt]."""
    from diffuphy import pipeline
    from diffuphy.plan import Plan

    forced = []
    monkeypatch.setattr(pipeline, "run", lambda c, *, force, **_: forced.append(force) or ([], Plan(c, ())))
    assert main(["prompt=1/2", "force=prompt"]) == main(["prompt=1/2", "force=[prompt]"]) == 0
    assert forced == [["prompt"], ["prompt"]]


@pytest.mark.parametrize("where", ["/dev/null/store", "/proc/nowhere"])
def test_store_that_cannot_be_made_says_what_to_change(conf, capsys, where):
    assert main(["prompt=a ball", f"store={where}"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"error: {where}") and line.endswith("choose another store with store=/path/to/folder")


def test_empty_store_is_refused(conf, capsys):
    assert main(["prompt=a ball", "store="]) == 2
    assert capsys.readouterr().err == "error: store is empty; name a folder, such as store=outputs\n"


@pytest.mark.parametrize(
    ("text", "begins"),
    [("a rubber burger falling", "a-rubber-burger-falling-"), ("Café, crème!", "cafe-creme-"), ("果冻汉堡掉落", "")],
)
def test_slug_is_ascii_and_distinct(text, begins):
    assert re.fullmatch(re.escape(begins) + "[0-9a-f]{6}", slug(text))
    assert slug(text) != slug(text + "!")
    assert len(slug(text * 50)) <= 48 + 7


def test_slug_of_several_texts_forgets_empty_ones():
    assert slug("a ball", "") == slug("a ball") != slug("a ball", "seed=1")


@pytest.mark.parametrize(
    ("called", "typed"),
    [
        ("train.py", "python train.py"),
        ("/somewhere/diffuphy/__main__.py", "python -m diffuphy"),
        ("/somewhere/bin/diffuphy", "diffuphy"),
    ],
)
def test_the_command_to_go_on_is_the_one_that_was_called(called, typed, monkeypatch):
    """Where the package is installed there is no train.py."""
    monkeypatch.setattr(sys, "argv", [called, "seed=1"])
    assert cli.conclusion([], {}, ["seed=1"]).splitlines()[2] == f"again     {typed} seed=1"


def test_nearest_name():
    assert nearest("fit.stpes", ["fit.steps", "fit.lr"]) == "fit.steps"
    assert nearest("stpes", ["guidance", "fit.steps"]) == "fit.steps"
    assert nearest("out", ["fit.init.count", "outputs"]) == "outputs"
    assert nearest("zebra", ["fit.steps"]) is None


def run(*arguments: str) -> tuple[subprocess.CompletedProcess[str], float]:
    """``train.py`` in a fresh interpreter, and the processor time it took [s]."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, *arguments], cwd=ROOT, capture_output=True, text=True, timeout=60, check=False
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return done, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


@pytest.mark.parametrize("entry", [["train.py"], ["-m", "diffuphy"]])
def test_help_answers_at_once(entry):
    """Less than 1.5 s of processor time: torch alone takes longer to import."""
    done, seconds = run(*entry, "--help")
    assert done.returncode == 0 and 'prompt="a rubber burger falling"' in done.stdout
    assert seconds < 1.5


def test_help_imports_nothing_heavy():
    code = (
        "import sys\nfrom diffuphy.cli import main\n"
        "try: main(['--help'])\n"
        "except SystemExit: print('loaded:', *({'torch', 'warp', 'numpy', 'diffusers'} & set(sys.modules)))"
    )
    done, _ = run("-c", code)
    assert done.stdout.splitlines()[-1] == "loaded:"


def test_error_reaches_the_shell():
    done, _ = run("train.py", "prompt=a", "sed=1")
    assert (done.returncode, done.stderr) == (2, "error: there is no setting 'sed'; did you mean seed?\n")


@pytest.mark.skipif(shutil.which("make") is None, reason="needs make")
@pytest.mark.parametrize(
    "text",
    [
        "a dog's ball, $5",
        "a $(date) `date` $(shell false) ${x}",
        "unterminated $(",
        'say "hi" & go; ls | cat #3',
        "果冻\nline",
        "a\\",
    ],
)
@pytest.mark.parametrize("how", ["argument", "environment"])
def test_make_hands_the_prompt_over(tmp_path, text, how):
    """Neither make nor the shell changes a character."""
    for name in ("Makefile", "pyproject.toml", "constraints.txt"):
        shutil.copy(ROOT / name, tmp_path)
    python = tmp_path / ".venv/bin/python"
    python.parent.mkdir(parents=True)
    python.write_text("#!/bin/sh\nprintf '%s' \"$2\" > got\n")
    python.chmod(0o755)
    (tmp_path / ".venv/.film").touch()
    command = ["make", "film"] + ([f"PROMPT={text}"] if how == "argument" else [])
    environment = os.environ | ({"PROMPT": text} if how == "environment" else {})
    subprocess.run(command, cwd=tmp_path, env=environment, check=True, capture_output=True)
    assert (tmp_path / "got").read_text(encoding="utf-8") == f"prompt={text}"
