"""The whole way from a sentence to a film: complete, remembered, resumable, never silently wrong."""

import hashlib
import json
import os
import random
import re
import shlex
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from benchmarks import resume
from diffuphy.cli import main
from diffuphy.types import Clip, Particles, Trajectory

ROOT = Path(__file__).parents[1]
PROMPT = "a rubber burger falling"
STAGES = ["prompt", "gaussians", "particles", "material", "trajectory", "clip", "errors", "evaluate"]


pytestmark = pytest.mark.usefixtures("quiet")


@pytest.fixture
def store(whole_run, tmp_path):
    """A copy of the results of the whole run, to be changed at will."""
    shutil.copytree(whole_run.store, tmp_path / "store", symlinks=True)
    return tmp_path / "store"


def film(store: Path, *settings: str, prompt: str = PROMPT) -> int:
    """The command line within this process, which has torch already."""
    return main([f"prompt={prompt}", "experiment=tiny", f"store={store}", "device=cpu", *settings])


def stages(output: str) -> dict[str, str]:
    """What the log says first about each stage: ``done`` or ``cached``; the prompt is looked up twice."""
    return dict(reversed(re.findall(r"  (\w+): (done|cached), ", output)))


def forget(store: Path, *names: str) -> None:
    """As if these stages had never run."""
    for name in names:
        shutil.rmtree(store / name)


def folder(store: Path, stage: str) -> Path:
    """The one result of a stage."""
    (meta,) = store.glob(f"{stage}/*/meta.json")
    return meta.parent


def contents(store: Path) -> dict[Path, str]:
    """SHA-256 of every file of every result."""
    files = (p for stage in STAGES for p in (store / stage).rglob("*") if p.is_file() and p.suffix != ".lock")
    return {p.relative_to(store): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


# ---------------------------------------------------------------------- complete
def test_a_run_leaves_every_result_and_every_file(whole_run):
    run = whole_run.folder
    for number, stage in enumerate(STAGES, 1):
        link = run / f"{number}_{stage}"
        assert link.resolve() == folder(whole_run.store, stage).resolve()
        assert not Path(os.readlink(link)).is_absolute(), "the store may be moved"
    for name in ("film.mp4", "contact_sheet.png", "report.html", "gaussians.ply", "plan.json", "log.txt"):
        assert (run / name).stat().st_size > 0
    assert not list(whole_run.store.rglob("*.partial")) and not list(whole_run.store.rglob("checkpoint*"))


def test_film_plays_everywhere(whole_run):
    """H.264 in 4:2:0, one picture for each stored frame, as long as the motion."""
    import imageio_ffmpeg

    clip = Clip.load(folder(whole_run.store, "clip"))
    frames = imageio_ffmpeg.read_frames(str(whole_run.folder / "film.mp4"))
    meta = next(frames)
    assert (meta["codec"], meta["pix_fmt"].partition("(")[0]) == ("h264", "yuv420p")
    assert meta["size"] == (clip.rgb.shape[2], clip.rgb.shape[1])
    assert meta["fps"] == clip.fps
    assert len(list(frames)) == len(clip.rgb)
    assert meta["duration"] == pytest.approx(len(clip.rgb) / clip.fps, abs=0.01)  # printed in hundredths


def test_film_shows_the_object_move(whole_run):
    """Pictures change from frame to frame, and are no flat colour."""
    rgb = Clip.load(folder(whole_run.store, "clip")).rgb
    assert 0 <= float(rgb.min()) and float(rgb.max()) <= 1
    assert float(rgb[0].std()) > 0.05
    assert float((rgb[1:] - rgb[:-1]).abs().amax(dim=(1, 2, 3)).min()) > 0.05


def test_the_object_falls_as_everything_does(whole_run):
    """Δz̄ = ½ g t² until it touches the floor; symplectic Euler with steps dt ≤ frame/100 is off by at most g t dt/2."""
    trajectory = Trajectory.load(folder(whole_run.store, "trajectory"))
    particles = Particles.load(folder(whole_run.store, "particles"))
    dx = 2 * particles.spacing
    free = [t for t in range(1, len(trajectory.x)) if float(trajectory.x[: t + 1, :, 2].min()) > 2 * dx]
    assert free, "the film begins in the air"
    for frame in free:
        t = frame / trajectory.fps
        fallen = float((trajectory.x[0, :, 2] - trajectory.x[frame, :, 2]).double().mean())
        assert fallen == pytest.approx(0.5 * 9.81 * t**2, rel=0.02 / frame, abs=1e-5)
    assert float(trajectory.x[..., 2].min()) > -dx, "nothing sinks into the floor"


def test_the_run_ends_with_its_files_its_times_and_its_command(whole_run):
    lines = whole_run.output.splitlines()[-8:]
    words = dict(line.split(maxsplit=1) for line in lines)
    assert list(words) == ["gaussians", "film", "sheet", "report", "error", "scores", "seconds", "again"]
    assert re.fullmatch(r"at most about .* of the centre of mass, .* px; .*", words["error"])
    assert re.fullmatch(r"PSNR to the prior .* dB, momentum error .*; left out: .*FVD.*", words["scores"])
    for kind in ("gaussians", "film", "sheet", "report"):
        assert (ROOT / words[kind]).is_file()
    assert re.fullmatch(r"prompt \d+\.\d, " + ", ".join(rf"{s} \d+\.\d" for s in STAGES[1:]), words["seconds"])
    assert shlex.split(words["again"]) == ["python", "train.py", *whole_run.arguments]
    assert (whole_run.folder / "log.txt").read_text(encoding="utf-8").endswith("\n".join(lines) + "\n")


def test_report_stands_alone(whole_run):
    """One file: nothing is fetched when it is opened."""
    text = (whole_run.folder / "report.html").read_text(encoding="utf-8")
    assert "burger" in text and "data:video/mp4;base64," in text
    assert not re.search(r"""(src|href)\s*=\s*["'](?!data:|#)""", text)


def test_plan_is_kept_and_names_every_stage(whole_run):
    plan = json.loads((whole_run.folder / "plan.json").read_text(encoding="utf-8"))
    decisions = {line["what"]: line["decision"] for line in plan}
    assert all(f"stage {stage}" in decisions for stage in STAGES)
    assert decisions["diffusion models"] == "left out"


# ---------------------------------------------------------------------- remembered
def test_second_run_computes_nothing_and_changes_nothing(store, capsys):
    before = contents(store)
    start = time.process_time()
    assert film(store) == 0
    assert time.process_time() - start < 5
    assert stages(capsys.readouterr().err) == dict.fromkeys(STAGES, "cached")
    assert contents(store) == before


def test_a_setting_of_the_scene_leaves_everything_before_it(store, capsys):
    before = contents(store)
    assert film(store, "scene.friction=0.3", "scene.seconds=0.1") == 0
    assert stages(capsys.readouterr().err) == dict.fromkeys(STAGES[:4], "cached") | dict.fromkeys(STAGES[4:], "done")
    assert contents(store).items() >= before.items()


def test_another_motion_keeps_the_object(store, capsys):
    """Gaussians depend on how the object looks alone; the particles come out the same once more."""
    assert film(store, "until=particles", prompt="a rubber burger bouncing") == 0
    assert stages(capsys.readouterr().err) == {"prompt": "done", "gaussians": "cached", "particles": "done"}
    digests = {json.loads(meta.read_text())["digest"] for meta in store.glob("particles/*/meta.json")}
    assert len(digests) == 1


def test_until_stops_there(store):
    forget(store, "runs", "particles", "material", "trajectory", "clip", "errors", "evaluate")
    assert film(store, "until=particles") == 0
    (run,) = (store / "runs").iterdir()
    assert sorted(p.name for p in run.glob("[1-7]_*")) == ["1_prompt", "2_gaussians", "3_particles"]
    assert sorted(p.name for p in store.iterdir()) == ["gaussians", "particles", "prompt", "runs"]
    assert (run / "gaussians.ply").exists() and not (run / "film.mp4").exists()


def test_the_estimate_is_left_out_where_nobody_wants_it(store, capsys):
    """Not run, not in the report, not among the stages that have a name; the film is the same film."""
    before = resume.digests(store)
    assert film(store, "report.error=off") == 0
    output = capsys.readouterr().err
    assert "errors" not in stages(output) and "\nerror " not in output
    assert re.search(r"error estimate +left out +report.error=off", output)
    (page,) = store.glob("runs/*/report.html")
    assert "Error and run time" not in page.read_text(encoding="utf-8")
    assert film(store, "report.error=off", "until=errors") == 2
    assert "no stage named 'errors'" in capsys.readouterr().err
    assert resume.digests(store) == before


def test_error_is_drawn_in_the_report(whole_run):
    """Three curves with bands beside the run time, and the sentence on what half of it would take."""
    text = (whole_run.folder / "report.html").read_text(encoding="utf-8")
    section = text[text.index("Error and run time") : text.index("Time and memory")]
    assert section.count('class="band"') == 3 and "16 times the work" in section


def test_scores_are_in_the_report_and_can_be_left_out(store, whole_run, capsys):
    """Numbers, and why others are missing; the film without them is the same film."""
    text = (whole_run.folder / "report.html").read_text(encoding="utf-8")
    section = text[text.index("<h2>Scores") : text.index("Error and run time")]
    assert "PSNR to the prior" in section and "Left out: " in section and "hf download" in section
    before = resume.digests(store)
    assert film(store, "evaluate.score=off") == 0
    output = capsys.readouterr().err
    assert "evaluate" not in stages(output) and "\nscores " not in output
    assert re.search(r"scores +left out +evaluate.score=off", output)
    assert resume.digests(store) == before


def test_weights_on_the_machine_add_their_scores(store, tmp_path, capsys):
    """The line that a user with CLIP writes, with a tiny random one: only the scores are taken again."""
    from tests.tiny_models import open_clip

    folder_of_weights = open_clip(tmp_path / "clip")
    assert film(store, f"evaluate.encoder.model={folder_of_weights}") == 0
    output = capsys.readouterr().err
    assert stages(output) == dict.fromkeys(STAGES[:-1], "cached") | {"evaluate": "done"}
    assert re.search(r"\nscores .*CLIPSIM -?0\.\d+.*Janus", output) and "left out: Diff_SSIM" in output


def test_estimate_costs_less_than_a_third_of_the_rest(whole_run):
    """Two drafts of a seventh of the particles and half of the substeps, and three quarters of it: a fifth of the
    trajectory; here against all stages, as the bill is read."""
    seconds = {s: json.loads((folder(whole_run.store, s) / "meta.json").read_text())["seconds"] for s in STAGES}
    assert seconds.pop("errors") < 0.3 * sum(seconds.values())


def test_a_forced_stage_gives_the_same_bytes(store, capsys):
    before = resume.digests(store)
    assert film(store, "force=[material]", "until=material") == 0
    assert stages(capsys.readouterr().err) == dict.fromkeys(STAGES[:3], "cached") | {"material": "done"}
    assert resume.digests(store) == before


def test_a_sweep_shares_what_its_films_have_in_common(store, capsys):
    """Two motions of one object: one set of Gaussians, two folders."""
    forget(store, "runs")
    prompts = "a rubber burger falling,a rubber burger bouncing"
    assert main(["-m", f"prompt={prompts}", "experiment=tiny", f"store={store}", "device=cpu", "until=gaussians"]) == 0
    assert len(list((store / "gaussians").glob("*/meta.json"))) == 1
    assert capsys.readouterr().err.count("gaussians: cached") == 2
    targets = [(run / "2_gaussians").resolve() for run in (store / "runs").iterdir() if run.name.startswith("a-")]
    assert len(targets) == 2 and len(set(targets)) == 1


# ---------------------------------------------------------------------- resumable
def test_killed_stages_continue_to_the_same_bytes(whole_run, tmp_path):
    """SIGKILL soon after a checkpoint of each stage that learns; then the same command."""
    store, log = tmp_path / "store", tmp_path / "log"
    args = resume.command(store, PROMPT, "experiment=tiny")
    for stage in ("gaussians", "material"):
        hit = resume.kill_at(resume.Moment(stage, random.Random(stage).uniform(0, 0.3)), args, log, checkpoints=store)
        assert not hit.over
    resume.finish(args, log)
    assert "gaussians: continuing\n" in log.read_text(encoding="utf-8")
    assert resume.digests(store) == resume.digests(whole_run.store)
    (killed,) = store.glob("runs/*/film.mp4")
    assert killed.read_bytes() == (whole_run.folder / "film.mp4").read_bytes()


@pytest.mark.slow
def test_ten_kills_at_random_change_nothing():
    done = subprocess.run([sys.executable, ROOT / "benchmarks/resume.py", "--kills", "10"], check=False, cwd=ROOT)
    assert done.returncode == 0


# ---------------------------------------------------------------------- never silently wrong
@pytest.mark.parametrize(
    ("prompt", "settings", "says"),
    [
        ("", [], "the prompt is empty"),
        ("a rubber zyzzyva falling", [], "zyzzyva"),
        ("果冻", [], "果冻"),
        (PROMPT, ["fit.stpes=1"], "did you mean fit.steps?"),
        (PROMPT, ["until=film"], "no stage named 'film'; the stages are prompt, gaussians"),
        (PROMPT, ["force=[burger]"], "no stage named 'burger'"),
        (PROMPT, ["device=cuda:99"], "device=cuda:99"),
        (PROMPT, ["device=gpu"], "device must be auto, cpu, cuda"),
        (PROMPT, ["seed=x"], "seed must be a whole number, got 'x'"),
        (PROMPT, ["fit.steps=many"], "fit.steps must be a whole number, got 'many'"),
        (PROMPT, ["+fit.rates.means=1"], "fit.rates must be a component"),
        (PROMPT, ["material.override.E=-1"], "E "),
        (PROMPT, ["material.override.nu=0.5"], "nu "),
        (PROMPT, ["scene.friction=-1"], "friction must be finite and not negative, got -1"),
        (PROMPT, ["+scene.cfl=5"], "cfl must be in (0, 0.75], got 5"),
        (PROMPT, ["scene.seconds=0"], "must be positive"),
        (PROMPT, ["film.width=127"], "must be even"),
        (PROMPT, ["accuracy=fine"], "accuracy must be a number or null, got 'fine'"),
        (PROMPT, ["accuracy=2"], "accuracy must be in (0, 1)"),
        (PROMPT, ["accuracy=1e-6"], "the best that can be promised is accuracy="),
        (PROMPT, ["checkpoint_seconds=soon"], "checkpoint_seconds must be a number"),
    ],
)
def test_bad_input_is_one_line_and_costs_nothing(whole_run, capsys, prompt, settings, says):
    """Status 2, one line that names the trouble, every result as it was and none more."""
    before = contents(whole_run.store)
    assert film(whole_run.store, *settings, prompt=prompt) == 2
    line = capsys.readouterr().err.splitlines()[-1]
    assert line.startswith("error: ") and says in line
    assert contents(whole_run.store) == before


def test_damaged_checkpoint_is_named_and_nothing_else_is_lost(store, capsys):
    """Delete what the message says, and the run ends with the same bytes."""
    before = resume.digests(store)
    path = folder(store, "clip")
    forget(store, "clip")
    work = path.with_suffix(".partial") / "work"
    work.mkdir(parents=True)
    checkpoint = work / f"checkpoint-{'0' * 32}.safetensors"
    checkpoint.write_bytes(b"not what was written")
    assert film(store) == 2
    line = capsys.readouterr().err.splitlines()[-1]
    assert line.startswith(f"error: checkpoint {checkpoint} is damaged") and "delete this one file" in line
    checkpoint.unlink()
    assert film(store) == 0
    assert resume.digests(store) == before


@pytest.mark.parametrize("file", ["result.json", "*.safetensors", "meta.json"])
def test_damaged_result_is_named_and_nothing_else_is_lost(store, capsys, file):
    before = resume.digests(store)
    path = folder(store, "clip")
    (damaged,) = path.glob(file)
    damaged.write_bytes(damaged.read_bytes()[:-1])
    assert film(store) == 2
    line = capsys.readouterr().err.splitlines()[-1]
    assert line == f"error: the stored result {path} is damaged; delete this one folder to compute it again"
    shutil.rmtree(path)
    assert film(store) == 0
    assert resume.digests(store) == before


def test_a_file_in_the_way_of_the_store_is_named(tmp_path, capsys):
    (tmp_path / "store").write_text("mine")
    assert film(tmp_path / "store") == 2
    line = capsys.readouterr().err.splitlines()[-1]
    assert line.startswith(f"error: {tmp_path / 'store'}") and "store=/path/to/folder" in line
    assert (tmp_path / "store").read_text() == "mine"


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_read_only_store_is_named(store, capsys):
    store.chmod(0o500)
    try:
        assert film(store, "until=prompt") == 2
        assert "store=/path/to/folder" in capsys.readouterr().err.splitlines()[-1]
    finally:
        store.chmod(0o700)


# ---------------------------------------------------------------------- any words
@pytest.mark.parametrize(
    "prompt",
    [
        "a rubber burger, falling",
        "a dog's rubber burger falling",
        'a "rubber" burger falling',
        "a rubber burger (red) [falling] {fast}",
        "rubber=burger falling #1 for $5 ${x} $(date) `date`",
        "a rubber burger 🍔 falling; 汉堡 掉落",
        "a ${x} burger",
        "burger \\ falling\\",
    ],
)
def test_the_words_reach_the_refiner_as_they_were_typed(store, prompt):
    """Understood or not, they are the setting that the result is stored under, or that the error shows."""
    from diffuphy.text2gs.refine.rules import Rules

    seen = []

    class Spy(Rules):
        def __post_init__(self):
            super().__post_init__()
            seen.append(self.prompt)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("diffuphy.text2gs.refine.rules.Rules", Spy)
        film(store, "until=prompt", prompt=prompt)
    assert set(seen) == {prompt}


def test_words_pass_through_a_real_shell(store):
    prompt = "it's a 'rubber' burger, falling (#1) = $5 & 汉堡 🍔"
    command = [sys.executable, "train.py", f"prompt={prompt}", "experiment=tiny", f"store={store}", "until=prompt"]
    done = subprocess.run(["sh", "-c", shlex.join(command)], cwd=ROOT, capture_output=True, text=True, check=False)
    prompts = {
        json.loads(meta.read_text(encoding="utf-8"))["run"]["prompt"] for meta in store.glob("prompt/*/meta.json")
    }
    assert prompt in prompts if done.returncode == 0 else (done.returncode == 2 and repr(prompt) in done.stderr), (
        done.stderr
    )
