"""Whether a model can be fetched, asked of a server on this machine that answers in every way."""

import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from diffuphy.doctor.reach import address, reach
from diffuphy.models import Model, roles
from diffuphy.models.registry import Part

ANSWERS = {
    "here": (200, "reachable"),
    "elsewhere": (302, "reachable"),
    "gated": (401, "accept its licence"),
    "forbidden": (403, "accept its licence"),
    "gone": (404, "gone or moved"),
    "busy": (503, "answers 503"),
    "mute": (0, "no answer"),
    "hangs": (-1, "no answer"),
}


class Hub(BaseHTTPRequestHandler):
    asked: list[str]

    def do_HEAD(self):
        type(self).asked.append(self.path)
        status = ANSWERS[self.path.split("/")[2]][0]
        if status == -1:
            time.sleep(2)
        if status > 0:
            self.send_response(status)
            self.send_header("Location", "http://127.0.0.1:9/nobody")
            self.end_headers()

    do_GET = None  # weights must never be fetched by a question

    def log_message(self, *args):
        pass


@pytest.fixture
def hub(monkeypatch):
    handler = type("Hub", (Hub,), {"asked": []})
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, daemon=True).start()
    monkeypatch.setenv("HF_ENDPOINT", f"http://127.0.0.1:{server.server_port}/")
    for name in ("HF_HUB_OFFLINE", "TRANSFORMERS_OFFLINE", "http_proxy", "HTTP_PROXY", "all_proxy", "ALL_PROXY"):
        monkeypatch.delenv(name, raising=False)
    yield handler
    server.shutdown()
    server.server_close()


def model(name: str) -> Model:
    return Model(f"a/{name}", "image", "guidance.model", {"unet": Part("diffusers")}, "MIT", "C")


def test_every_answer_is_told_apart_and_all_are_asked_at_once(hub):
    """One slow server costs its timeout and no more."""
    began = time.monotonic()
    said = reach([model(name) for name in ANSWERS], timeout=0.5)
    assert time.monotonic() - began < 1.5  # one after another the two without an answer alone would take 1 s
    for name, (_, words) in ANSWERS.items():
        assert words in said[f"a/{name}"]
    assert "/a/here/resolve/main/unet/config.json" in hub.asked and len(hub.asked) == len(ANSWERS)


def test_offline_asks_nobody(hub, monkeypatch):
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    assert "HF_HUB_OFFLINE" in reach([model("here")])["a/here"] and not hub.asked


def test_every_known_model_has_an_address(hub):
    for models in roles().values():
        for m in models:
            assert address(m).endswith(m.id) if m.url else f"/{m.id}/resolve/main/" in address(m)
