"""A chat-completions server on this machine that answers, or misbehaves, as it is told; and parts without weights."""

import hashlib
import json
import threading
import time
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from diffuphy.text2gs.refine import Picture, Refinement

KEY = "sk-test-5f1c0b7d9e2a4486"
"""Looks like a key, so that it would be found where it must not be."""


def refinement(number: int = 1) -> Refinement:
    words = f"a glossy red rubber burger with a sesame bun, version {number}, plain background"
    return Refinement("brief", "keeps the facts", "the bun is grey", "a red rubber burger", words)


def answer(number: int = 1) -> str:
    """What a good model says."""
    return json.dumps(refinement(number).asdict())


def completion(content: str | None, *, finish: str = "stop", refusal: str | None = None) -> bytes:
    message = {"role": "assistant", "content": content, "refusal": refusal}
    choice = {"index": 0, "finish_reason": finish, "message": message}
    return json.dumps(
        {"id": "x", "object": "chat.completion", "created": 0, "model": "m", "choices": [choice]}
    ).encode()


@dataclass
class Reply:
    """One answer of the server."""

    body: bytes = b""
    status: int = 200
    headers: dict[str, str] = field(default_factory=dict)
    delay: float = 0.0
    """Silence before it [s]."""
    cut: bool = False
    """Promise more bytes than are sent, then hang up."""


def error(status: int, message: str = "no", **headers: str) -> Reply:
    return Reply(json.dumps({"error": {"message": message, "type": "x"}}).encode(), status, headers)


def says(content: str | None, **options) -> Reply:
    return Reply(completion(content, **options))


@dataclass
class Server:
    url: str
    script: list[Reply]
    """What is left to answer; at its end good answers, each with another prompt."""
    requests: list[dict] = field(default_factory=list)
    keys: list[str] = field(default_factory=list)


@contextmanager
def serving(*script: Reply):
    """A server for as long as the context lasts."""

    class Handler(BaseHTTPRequestHandler):
        def log_message(self, *_):
            pass

        def do_POST(self):
            server.requests.append(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
            server.keys.append(self.headers.get("Authorization", ""))
            reply = server.script.pop(0) if server.script else says(answer(len(server.requests)))
            time.sleep(reply.delay)
            try:
                self.send_response(reply.status)
                for name, value in {"Content-Type": "application/json", **reply.headers}.items():
                    self.send_header(name.replace("_", "-"), value)
                self.send_header("Content-Length", str(len(reply.body) + 100 * reply.cut))
                self.end_headers()
                self.wfile.write(reply.body)
            except OSError:  # the client no longer waits
                pass
            self.close_connection = True

    http = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    http.daemon_threads = False  # closing waits for them: every request is then in the list
    server = Server(f"http://127.0.0.1:{http.server_port}/v1", list(script))
    thread = threading.Thread(target=http.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True)
    thread.start()
    try:
        yield server
    finally:
        http.shutdown()
        http.server_close()


@dataclass(frozen=True)
class Swatches:
    """Draws every prompt as one colour of its own."""

    def generate(self, prompt, *, seed, device):
        from PIL import Image

        return Picture(prompt, seed, Image.new("RGB", (8, 8), tuple(hashlib.sha256(prompt.encode()).digest()[:3])))

    def close(self):
        pass


@dataclass(frozen=True)
class Counting:
    """Scores (prompt of the picture, text) by a table; 0.2 where it says nothing."""

    table: dict[str, float] = field(default_factory=dict)

    def score(self, picture, text, *, device):
        key = picture.prompt if text == picture.prompt else f"{picture.prompt} → {text}"
        return self.table.get(key, 0.2)

    def close(self):
        pass
