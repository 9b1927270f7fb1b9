"""A language model behind a network: everything that goes wrong there ends in the best prompt so far and a warning."""

import json
import logging
import socket
import sys
from pathlib import Path

import pytest

pytest.importorskip("openai", reason="pip install 'diffuphy[llm]'")
sys.path.insert(0, str(Path(__file__).parent))
from loopback import KEY, Counting, Reply, Swatches, answer, completion, error, refinement, says, serving

from diffuphy.artifact import describe
from diffuphy.text2gs.refine import OpenAI, Picture, Refined, Rules, Unavailable
from diffuphy.workspace import Workspace

WORDS = "a rubber burger falling"
SOON = {"retry-after-ms": "1"}
"""Where a server asks for patience."""


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """A key, no proxy on the way to the loopback, and pauses of milliseconds where the server names none."""
    monkeypatch.setenv("OPENAI_API_KEY", KEY)
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    monkeypatch.delenv("OPENAI_BASE_URL", raising=False)
    monkeypatch.setattr("openai._base_client.INITIAL_RETRY_DELAY", 0.002)


def refined(url: str, tmp_path: Path | None = None, **settings):
    """The loop with pictures and scores that cost nothing; two prompts are tried."""
    loop = {"max_iter": 2, "generator": Swatches(), "scorer": Counting({refinement().prompt: 0.3})}
    loop |= {k: settings.pop(k) for k in ("max_iter", "scorer", "generator", "replies") if k in settings}
    options = {"retries": 2, "timeout": 5.0} | settings
    return Refined(WORDS, refiner=OpenAI(base_url=url, **options), **loop)(work=Workspace(tmp_path))


def flawed(**changes) -> str:
    """An answer with some fields changed, or removed by None."""
    fields = refinement().asdict() | changes
    return json.dumps({k: v for k, v in fields.items() if v is not None})


MENDED = [
    # name, what the server does, calls until it is answered
    ("too many requests, then an answer", [error(429, **SOON), says(answer())], 2),
    ("server error twice, then an answer", [error(500, **SOON), error(503, **SOON), says(answer())], 3),
    ("lost connection, then an answer", [Reply(completion(answer()), cut=True), says(answer())], 2),
    ("knows no schemas", [error(400, "response_format"), says(answer())], 2),
    ("knows no schemas (422)", [error(422, "response_format"), says(answer())], 2),
    ("JSON in a fence among prose", [says(f"Sure! {{here}} it is:\n```json\n{answer()}\n```\nEnjoy.")], 1),
    ("no JSON, then an answer", [says("I think the prompt is fine."), says(answer())], 2),
    ("a key is missing, then an answer", [says(flawed(clip_prompt=None)), says(answer())], 2),
    ("a wrong kind, then an answer", [says(flawed(prompt=["a", "b"])), says(answer())], 2),
    ("cut off, then an answer", [says(answer()[:40], finish="length"), says(answer())], 2),
    ("empty, then an answer", [says(None), says("  "), says(answer())], 3),
    ("too long for CLIP, then an answer", [says(flawed(prompt="sesame " * 80)), says(answer())], 2),
    ("half a character, then an answer", [says(flawed(prompt="a bun \ud83c")), says(answer())], 2),
    ("half a character in the reply itself", [says(answer() + "\ud83c"), says(answer())], 1),
    ("nothing but half a character", [says("\ud83c"), says(answer())], 2),
    ("silent, then an answer", [Reply(completion(answer()), delay=3.0), says(answer())], 2),
]

FAILED = [
    # name, what the server does, calls until it is given up, what the warning says
    ("wrong key", [error(401, "Incorrect API key")], 1, "check the key in OPENAI_API_KEY"),
    ("not allowed", [error(403)], 1, "may not use this model"),
    ("no such model", [error(404, "model not found")], 1, "check refine.refiner.model"),
    ("too many requests for ever", [error(429, "quota", **SOON)] * 3, 3, "limit or quota is used up"),
    ("server error for ever", [error(500, "boom", **SOON)] * 3, 3, "boom"),
    ("bad request for ever", [error(400, "no pictures here")] * 2, 2, "no pictures here"),
    ("refusal", [says(None, refusal="I cannot help with that")], 1, "refused: I cannot help with that"),
    ("content filter", [says("", finish="content_filter")], 1, "content filter"),
    ("no JSON for ever", [says("no")] * 3, 3, "3 answers that cannot be used; the last: it holds no JSON object"),
    ("wrong schema for ever", [says('{"prompt": "a bun"}')] * 3, 3, "'original_analysis' is missing"),
    ("cut off for ever", [says("{", finish="length")] * 3, 3, "cut off"),
    ("too long for ever", [says(flawed(prompt="sesame " * 80))] * 3, 3, "82 CLIP tokens, at most 74"),
    ("silent for ever", [Reply(delay=0.8)] * 3, 3, "timed out"),
    ("lost connection for ever", [Reply(b"{", cut=True)] * 3, 3, "Connection error"),
    ("a web page", [Reply(b"<html>Log in</html>", headers={"Content-Type": "text/html"})], 1, "is base_url right"),
    ("an error with status 200", [Reply(b'{"error": {"message": "overloaded"}}')], 1, "overloaded"),
    ("an error with half a character", [Reply(b'{"error": "over\\ud83cloaded"}')], 1, "over?loaded"),
    ("a refusal with half a character", [says(None, refusal="no\ud83c")], 1, "refused: no?"),
    ("a status with half a character", [error(403, "no\ud83c")], 1, "no?"),
    ("no choices", [Reply(b'{"choices": []}')], 1, "is base_url right"),
    ("not an object", [Reply(b"[1, 2]")], 1, "is base_url right"),
]


def ids(cases):
    return [name for name, *_ in cases]


@pytest.mark.parametrize(("name", "script", "calls"), MENDED, ids=ids(MENDED))
def test_what_can_be_mended_is(tmp_path, name, script, calls):
    with serving(*script) as server:
        prompt = refined(server.url, tmp_path, timeout=2.0 if "silent" in name else 5.0)
    assert prompt.look.text == refinement().prompt
    assert prompt.turns[0].reply == refinement().asdict()
    assert [t.failure for t in prompt.turns] == ["", ""]
    assert len(server.requests) == calls


@pytest.mark.parametrize(("name", "script", "calls", "why"), FAILED, ids=ids(FAILED))
def test_what_cannot_be_mended_is_a_warning(tmp_path, caplog, name, script, calls, why):
    """The words of the rules are kept, one line says why; the server is not asked more often than it makes sense."""
    rules = Rules(WORDS)(work=Workspace())
    with serving(*script) as server, caplog.at_level(logging.WARNING, "diffuphy"):
        prompt = refined(server.url, tmp_path, timeout=0.5 if "silent" in name else 5.0)
    assert (prompt.look, prompt.motion) == (rules.look, rules.motion)
    prompt.save(tmp_path)
    assert why in prompt.turns[-1].failure
    assert [r.getMessage().count(prompt.turns[-1].failure) for r in caplog.records] == [1]
    assert "\n" not in caplog.records[0].getMessage()
    assert len(server.requests) == calls


def test_no_network_is_a_warning(caplog):
    """Nobody listens at the port."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        url = f"http://127.0.0.1:{free.getsockname()[1]}/v1"
    with caplog.at_level(logging.WARNING, "diffuphy"):
        prompt = refined(url)
    assert "Connection refused" in prompt.turns[0].failure and len(caplog.records) == 1


def test_the_best_prompt_so_far_survives_a_late_failure():
    """s₁ > s₀, then the third prompt cannot be had: y₁ is the result."""
    with serving(says(answer()), error(401)) as server:
        prompt = refined(server.url, max_iter=5)
    assert prompt.look.text == refinement().prompt
    assert [bool(t.failure) for t in prompt.turns] == [False, True]


def test_the_second_run_makes_no_call(tmp_path):
    with serving() as server:
        first = refined(server.url, max_iter=4, replies=str(tmp_path))
        calls = len(server.requests)
        assert refined(server.url, max_iter=4, replies=str(tmp_path)) == first
    assert calls == 3 and len(server.requests) == 3


def test_a_schema_that_was_refused_is_not_offered_again():
    with serving(error(400), says(answer(1)), says(answer(2))) as server:
        refined(server.url, max_iter=3)
    assert ["response_format" in r for r in server.requests] == [True, False, False]


def test_the_request_is_what_servers_understand():
    """Strict JSON schema with every property required, the picture as a data URL, score and words as JSON."""
    with serving() as server:
        refined(server.url, model="some-model", detail="high")
    (request,) = server.requests
    schema = request["response_format"]["json_schema"]
    assert schema["strict"] and schema["schema"]["required"] == list(refinement().asdict())
    assert not schema["schema"]["additionalProperties"]
    system, user = request["messages"]
    text, image = user["content"]
    assert (request["model"], system["role"], user["role"]) == ("some-model", "system", "user")
    assert json.loads(text["text"])["score of the image"] == 0.2
    assert image["image_url"]["url"].startswith("data:image/jpeg;base64,") and image["image_url"]["detail"] == "high"
    assert server.keys == [f"Bearer {KEY}"]


def test_a_correction_says_what_is_wrong():
    with serving(says('{"prompt": "a bun"}'), says(answer())) as server:
        refined(server.url)
    assistant, user = server.requests[1]["messages"][-2:]
    assert assistant == {"role": "assistant", "content": '{"prompt": "a bun"}'}
    assert "'original_analysis' is missing" in user["content"]


# ---------------------------------------------------------------------- the key
LEAKS = [
    error(401, f"Incorrect API key provided: {KEY}. {'x' * 250}{KEY}"),
    error(400, f"{'x' * 190}{KEY}"),
    says(None, refusal=f"not with {KEY}"),
    says(flawed(original_analysis=f"your key is {KEY}", prompt=f"a bun {KEY}")),
    says(flawed(prompt="a bun KEY").replace("KEY", "".join(f"\\u{ord(c):04x}" for c in KEY))),
    Reply(json.dumps({"error": KEY}).encode()),
]


@pytest.mark.parametrize("leak", LEAKS, ids=["401", "400", "refusal", "answer", "escaped answer", "body"])
def test_the_key_is_never_written(tmp_path, caplog, leak):
    """Not even by a server that says it aloud: no file of the store, of the run, of the log has eight characters of
    it in a row."""
    from diffuphy.artifact import Stage, Store
    from diffuphy.types import Prompt

    handler = logging.FileHandler(tmp_path / "log.txt")
    logging.getLogger().addHandler(handler)
    with serving(leak, leak, leak) as server, caplog.at_level(logging.DEBUG):
        loop = Refined(
            WORDS,
            refiner=OpenAI(base_url=server.url, retries=0),
            generator=Swatches(),
            scorer=Counting(),
            max_iter=2,
            replies=str(tmp_path / "replies"),
        )
        Store(tmp_path / "store").run([Stage("prompt", Prompt, loop)], "prompt")
    logging.getLogger().removeHandler(handler)
    assert server.keys[0] == f"Bearer {KEY}"
    written = [p for p in tmp_path.rglob("*") if p.is_file()]
    text = "\n".join([*(p.read_bytes().decode("latin-1") for p in written), caplog.text])
    assert {"result.json", "meta.json", "log.txt"} <= {p.name for p in written} and server.url in text
    assert [KEY[i : i + 8] for i in range(len(KEY) - 7) if KEY[i : i + 8] in text] == []
    assert KEY not in repr(loop) + str(describe(loop))


def test_without_a_key_nothing_is_sent(monkeypatch):
    monkeypatch.delenv("OPENAI_API_KEY")
    with pytest.raises(Unavailable, match="set OPENAI_API_KEY in the environment"):
        OpenAI().refine("a", "a", None, None, device="cpu")


def test_a_server_of_ones_own_needs_no_key(monkeypatch):
    monkeypatch.delenv("OPENAI_API_KEY")
    with serving() as server:
        assert refined(server.url).look.text == refinement().prompt


def test_the_environment_may_name_the_server(monkeypatch):
    with serving() as server:
        monkeypatch.setenv("OPENAI_BASE_URL", server.url)
        assert OpenAI().refine("a", "a", Picture("a", 0), None, device="cpu") == refinement()
        assert server.url.removeprefix("http://") in OpenAI().identity


@pytest.mark.parametrize("url", ["http://host:secret/v1", "http://me:secret@host/v1", "host"])
def test_a_broken_server_in_the_environment_is_one_line(monkeypatch, url):
    monkeypatch.setenv("OPENAI_BASE_URL", url)
    with pytest.raises(Unavailable, match="OPENAI_BASE_URL must") as e:
        OpenAI().refine("a", "a", None, None, device="cpu")
    assert "secret" not in str(e.value)


@pytest.mark.parametrize("key", ["sk-ü-12345678", "sk-1\n2345678"])
def test_a_broken_key_is_one_line(monkeypatch, key):
    monkeypatch.setenv("OPENAI_API_KEY", key)
    with pytest.raises(Unavailable, match="characters that no key has"):
        OpenAI().refine("a", "a", None, None, device="cpu")


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"model": ""}, "model is empty"),
        ({"base_url": "host:8000/v1"}, "like http://host:8000/v1"),
        ({"base_url": "http://host:secret/v1"}, "like http://host:8000/v1"),
        ({"base_url": "http://[secret/v1"}, "like http://host:8000/v1"),
        ({"base_url": "http://me:secret@host/v1"}, "no credentials"),
        ({"base_url": "http://host/v1?key=secret"}, "no credentials"),
        ({"detail": "sharp"}, "detail must be"),
        ({"timeout": 0.0}, "timeout must be positive"),
        ({"retries": -1}, "retries must not"),
        ({"corrections": -1}, "corrections must not"),
    ],
)
def test_wrong_settings_are_refused_without_repeating_secrets(settings, says):
    with pytest.raises(ValueError, match=says) as refused:
        OpenAI(**settings)
    assert "secret" not in str(refused.value)


def test_a_missing_package_is_named(monkeypatch):
    monkeypatch.setattr("diffuphy.text2gs.refine.hosted.find_spec", lambda name: None)
    with pytest.raises(ModuleNotFoundError) as missing:
        OpenAI()
    assert missing.value.name == "openai"
