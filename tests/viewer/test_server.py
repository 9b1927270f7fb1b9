"""Where the page is, and who can get there."""

import builtins

import pytest

from diffuphy.viewer.__main__ import main, parser
from diffuphy.viewer.opened import Run
from diffuphy.viewer.server import LOCAL, directions, serve
from tests.viewer.runs import run


def test_only_this_machine_is_served_unless_asked():
    assert parser().parse_args(["run"]).host == LOCAL == "127.0.0.1"
    assert "warning" not in directions(LOCAL, 8080, 8080)
    assert "warning: listening at 0.0.0.0" in directions("0.0.0.0", 8080, 8080)


def test_directions_say_how_to_come_by_ssh_and_that_a_port_was_taken():
    told = directions(LOCAL, 8080, 8083)
    assert "ssh -L 8083:{}:8083".format("localhost") in told and "port 8080 is taken, took 8083" in told
    assert "taken" not in directions(LOCAL, 8080, 8080)


@pytest.mark.parametrize("port", [80, 65536])
def test_a_port_that_cannot_be_is_refused(port):
    with pytest.raises(ValueError, match="between 1024 and 65535"):
        serve(port=port)


def test_a_missing_viser_is_one_line(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(Run, "open", classmethod(lambda cls, *a: run(tmp_path)))
    real = builtins.__import__

    def without(name, *rest):
        if name == "viser":
            raise ModuleNotFoundError("No module named 'viser'", name="viser")
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    assert main([str(tmp_path), "--device", "cpu"]) == 2
    assert capsys.readouterr().err == "error: viser is not installed; run: pip install 'diffuphy[viewer]'\n"


def test_the_next_port_is_taken_when_one_is_in_use():
    """Two servers at once, each on its own port, neither reached from outside."""
    pytest.importorskip("viser")
    first = serve(port=18080)
    second = serve(port=first.get_port())
    try:
        assert second.get_port() > first.get_port()
        assert first.get_host() == second.get_host() == LOCAL
    finally:
        first.stop()
        second.stop()
