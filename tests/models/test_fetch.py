"""A file of weights by path or by address: fetched once, checked always, never when forbidden."""

import functools
import hashlib
import http.server
import threading

import pytest
import torch

from diffuphy.models import MissingWeights
from diffuphy.models.cache import file_cache as cache
from diffuphy.models.cache import kept
from diffuphy.models.fetch import file

BYTES = b"weights" * 1000
SHA256 = hashlib.sha256(BYTES).hexdigest()


@pytest.fixture
def served(tmp_path, monkeypatch):
    """Address of a server that has ``w.pt``, and the list of what it was asked for."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv("HF_HUB_OFFLINE", raising=False)
    (tmp_path / "site").mkdir()
    (tmp_path / "site/w.pt").write_bytes(BYTES)
    asked = []

    class Handler(http.server.SimpleHTTPRequestHandler):
        def do_GET(self):
            asked.append(self.path)
            super().do_GET()

        def log_message(self, *args):
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Handler, directory=tmp_path / "site"))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}", asked
    server.shutdown()


def test_a_file_is_fetched_once(served):
    address, asked = served
    for _ in range(2):
        path = file(f"{address}/w.pt", SHA256, "shape.guidance.checkpoint")
        assert path.read_bytes() == BYTES and path == kept(f"{address}/w.pt")
    assert asked == ["/w.pt"]


def test_wrong_bytes_are_refused_and_not_kept(served):
    address, _ = served
    with pytest.raises(ValueError, match=SHA256):
        file(f"{address}/w.pt", "0" * 64, "x")
    assert list(cache().iterdir()) == []
    file(f"{address}/w.pt", "", "x").write_bytes(b"damaged")
    with pytest.raises(ValueError, match="SHA-256"):
        file(f"{address}/w.pt", SHA256, "x")


@pytest.mark.parametrize("how", ["setting", "environment"])
def test_the_network_is_not_asked_when_it_is_forbidden(served, monkeypatch, how):
    address, asked = served
    if how == "environment":
        monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    with pytest.raises(MissingWeights, match=r"shape\.guidance\.checkpoint=/path"):
        file(f"{address}/w.pt", SHA256, "shape.guidance.checkpoint", local=how == "setting")
    assert asked == []


def test_what_is_not_there_says_what_to_do(served, tmp_path):
    address, _ = served
    for source in (f"{address}/nothing.pt", "http://127.0.0.1:9/w.pt", str(tmp_path / "no.pt"), ""):
        with pytest.raises(MissingWeights, match=r"set a\.b=") as error:
            file(source, "", "a.b")
        assert "\n" not in str(error.value)
    assert not list(cache().glob("*.part"))


def test_a_path_is_checked_and_taken_where_it_is(tmp_path):
    path = tmp_path / "w.pt"
    torch.save({"w": torch.zeros(2)}, path)
    assert file(str(path), hashlib.sha256(path.read_bytes()).hexdigest(), "x") == path
    with pytest.raises(ValueError, match="SHA-256"):
        file(str(path), "0" * 64, "x")
