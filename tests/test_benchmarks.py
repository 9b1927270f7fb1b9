"""The benchmarks are listed, say what they measure, and can be run by name."""

import importlib
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.__main__ import QUICK, main, scripts

ROOT = Path(__file__).parents[1]


def test_every_benchmark_is_listed_with_what_it_measures(capsys, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["benchmarks"])
    assert main() == 0
    listed = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in listed] == list(scripts())
    assert all(len(line.split()) > 3 for line in listed)


def test_every_benchmark_has_a_quick_form():
    assert set(QUICK) == set(scripts())


@pytest.mark.parametrize("name", sorted(QUICK))
def test_benchmark_takes_the_options_of_its_quick_form(name, capsys, monkeypatch):
    """The help of the script, which is what its parser accepts, names every option."""
    monkeypatch.setattr(sys, "argv", [name, "--help"])
    with pytest.raises(SystemExit) as end:
        importlib.import_module(f"benchmarks.{name}").main()
    assert end.value.code == 0
    text = capsys.readouterr().out
    assert all(option in text for option in QUICK[name] if option.startswith("--"))


def test_options_are_passed_on():
    """``python -m benchmarks NAME ...`` is the script's own command line."""
    command = [sys.executable, "-m", "benchmarks", "resume", "--help"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert "--kills" in done.stdout


def test_unknown_benchmark_is_refused_with_the_names(capsys, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["benchmarks", "speeed"])
    with pytest.raises(SystemExit):
        main()
    assert "speed" in capsys.readouterr().err
