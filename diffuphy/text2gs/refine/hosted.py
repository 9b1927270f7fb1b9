"""Refiners behind ``/chat/completions``: GPT-4o, and servers that speak its language (vLLM, llama.cpp, Ollama)."""

import base64
import io
import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib.util import find_spec
from typing import Any, Literal
from urllib.parse import urlsplit

from diffuphy.text2gs.refine.chat import Chat
from diffuphy.text2gs.refine.protocols import Unavailable
from diffuphy.text2gs.refine.reply import SCHEMA, Message, Unusable

HIDDEN = "[key]"
SHORTEST_KEY = 8
"""Characters from which on a key is looked for in answers; the placeholders of local servers are shorter."""


@dataclass(frozen=True)
class OpenAI(Chat):
    """A model asked over the network, by the ``openai`` package, which retries 408, 409, 429, 5xx and lost connections
    after a growing, random pause (or the one that the server names).

    The key comes from the environment. It is no setting, and is taken out of everything the server says.
    """

    model: str = "gpt-4o"
    """Name of the model; the paper's is GPT-4o."""
    base_url: str = ""
    """Where the server is, such as ``http://host:8000/v1``; empty: ``OPENAI_BASE_URL``, or else OpenAI's own."""
    key_variable: str = field(default="OPENAI_API_KEY", metadata={"runtime": True})
    """Environment variable with the key, which is sent to the server, whosever it is: name another variable for another
    server. One's own may need none."""
    structured: bool = True
    """Ask for an answer that obeys the schema; a server that knows no schemas is then asked for plain JSON."""
    detail: Literal["low", "high", "auto"] = "low"
    """At which resolution the model looks at the picture; low is 512 px and costs 85 tokens."""
    timeout: float = field(default=60.0, metadata={"runtime": True})
    """Longest silence of the server [s]."""
    retries: int = field(default=3, metadata={"runtime": True})
    """How often a call is repeated that failed for a reason that may pass."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if find_spec("openai") is None:
            raise ModuleNotFoundError("No module named 'openai'", name="openai")
        if not self.model:
            raise ValueError("model is empty; name one, such as gpt-4o")
        if self.base_url and (flaw := _flaw(self.base_url)):
            raise ValueError(f"base_url {flaw}")
        if self.detail not in ("low", "high", "auto"):
            raise ValueError(f"detail must be 'low', 'high' or 'auto', got {self.detail!r}")
        if not self.timeout > 0:
            raise ValueError(f"timeout must be positive, got {self.timeout} s")
        if self.retries < 0:
            raise ValueError(f"retries must not be negative, got {self.retries}")

    @cached_property
    def _memory(self) -> dict[str, Any]:
        """The client, and whether the server knows schemas: a cache, no setting."""
        return {}

    @property
    def identity(self) -> str:
        return f"openai {self.model}" + (f" at {self._server}" if self._server and not _flaw(self._server) else "")

    @property
    def _server(self) -> str:
        """Address of the server; empty for OpenAI's own."""
        return self.base_url or os.environ.get("OPENAI_BASE_URL", "")

    def close(self) -> None:
        if (client := self._memory.pop("client", None)) is not None:
            client.close()

    def clean(self, text: str) -> str:
        key = os.environ.get(self.key_variable, "").strip()
        return text.replace(key, HIDDEN) if len(key) >= SHORTEST_KEY else text

    # ------------------------------------------------------------------ one conversation
    def ask(self, messages: Sequence[Message], *, device: str) -> str:
        import openai  # pyright: ignore[reportMissingImports]  # an extra

        spoken = [{"role": m.role, "content": _content(m, self.detail)} for m in messages]
        try:
            try:
                body = self._post(spoken, plain=self._memory.get("plain", not self.structured))
            except (openai.BadRequestError, openai.UnprocessableEntityError):
                if self._memory.get("plain", not self.structured):
                    raise
                body = self._post(spoken, plain=True)
                self._memory["plain"] = True  # it knows no schemas: do not ask again
        except openai.OpenAIError as e:
            raise Unavailable(self._failed(e)) from None
        return self._answer(body)

    def _post(self, messages: list[dict[str, Any]], *, plain: bool) -> Any:
        """The decoded body of one call; None if it is no JSON."""
        strict = {"type": "json_schema", "json_schema": {"name": "refinement", "strict": True, "schema": SCHEMA}}
        options: dict[str, Any] = {} if plain else {"response_format": strict}
        raw = self._client().chat.completions.with_raw_response.create(model=self.model, messages=messages, **options)
        try:
            return json.loads(raw.text)
        except (ValueError, RecursionError):
            return None

    def _client(self) -> Any:
        if "client" not in self._memory:
            import openai  # pyright: ignore[reportMissingImports]  # an extra

            key = os.environ.get(self.key_variable, "").strip()
            if not key and not self._server:
                raise Unavailable(
                    f"{self.identity} needs a key: set {self.key_variable} in the environment, or name a server of "
                    "your own with refine.refiner.base_url"
                )
            if self._server and (flaw := _flaw(self._server)):
                raise Unavailable(f"OPENAI_BASE_URL {flaw}")
            if not (key.isascii() and key.isprintable()):
                raise Unavailable(f"the key in {self.key_variable} has characters that no key has; set it again")
            self._memory["client"] = openai.OpenAI(
                api_key=key or "none", base_url=self._server or None, timeout=self.timeout, max_retries=self.retries
            )
        return self._memory["client"]

    def _answer(self, body: Any) -> str:
        """The text of a chat completion; nothing is taken for granted, as many servers speak the language a little.

        Raises:
            Unavailable: no chat completion, a refusal, a filter.
            Unusable: cut off, or empty.
        """
        try:
            choice = body["choices"][0]
            message, ended = choice["message"], choice.get("finish_reason")
            content, refusal = message.get("content"), message.get("refusal")
        except (TypeError, KeyError, IndexError, AttributeError):
            said = f" ({self._short(body['error'])})" if isinstance(body, dict) and "error" in body else ""
            raise Unavailable(
                f"{self.identity} did not answer with a chat completion{said}; is base_url right?"
            ) from None
        if refusal:
            raise Unavailable(f"{self.identity} refused: {self._short(refusal)}")
        if ended == "content_filter":
            raise Unavailable(f"{self.identity} refused: its content filter stopped the answer")
        if ended == "length":
            raise Unusable("it was cut off before its end; be brief")
        if not isinstance(content, str) or not content.strip():
            raise Unusable("it is empty")
        return self.clean(content)

    def _failed(self, error: Exception) -> str:
        """One line about a failed call, with what to change where that is known."""
        remedy = {
            401: f"; check the key in {self.key_variable}",
            403: f"; the key in {self.key_variable} may not use this model",
            404: "; check refine.refiner.model and refine.refiner.base_url",
            429: "; its limit or quota is used up, try again later",
        }.get(getattr(error, "status_code", 0), "")
        return f"{self.identity} cannot be asked ({self._short(f'{error} {error.__cause__ or str()}')}){remedy}"

    def _short(self, said: Any) -> str:
        """What a server says, in one line that a file can hold. The key goes before the rest is cut off, which might
        cut the key in two."""
        return " ".join(self.clean(str(said)).split())[:300].encode(errors="replace").decode()


def _flaw(url: str) -> str:
    """What is wrong with the address of a server, without repeating it."""
    try:
        parts = urlsplit(url)
        whole = parts.scheme in ("http", "https") and bool(parts.hostname) and parts.port != 0
    except ValueError:  # a port that is no number, half a bracket
        return "must be an address like http://host:8000/v1"
    if "@" in parts.netloc or parts.query:
        return "must hold no credentials: settings are written to disk; use key_variable"
    return "" if whole else "must be an address like http://host:8000/v1"


def _content(message: Message, detail: str) -> Any:
    """Text, or text beside a picture as a data URL."""
    if message.image is None:
        return message.text
    buffer = io.BytesIO()
    message.image.convert("RGB").save(buffer, "JPEG", quality=90)
    url = "data:image/jpeg;base64," + base64.b64encode(buffer.getvalue()).decode()
    picture = {"type": "image_url", "image_url": {"url": url, "detail": detail}}
    return [{"type": "text", "text": message.text}, picture]
