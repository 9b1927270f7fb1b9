"""Can a model be fetched from here? One short question to its server, in parallel for all."""

import urllib.error
import urllib.request
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import PurePosixPath
from typing import Any

from diffuphy.models import Model, offline
from diffuphy.models.cache import endpoint
from diffuphy.models.files import KINDS


class _Stay(urllib.request.HTTPRedirectHandler):
    """A redirection is an answer: the file is there. Hubs send their large files elsewhere."""

    def redirect_request(self, *args: Any, **kwargs: Any) -> None:
        return None


def address(model: Model) -> str:
    """A small file that the model must have."""
    if model.url:
        return model.url
    part, kind = next((p, x.kind) for p, x in model.parts.items())
    name = PurePosixPath(part, KINDS[kind].needs[0][0])
    return f"{endpoint()}/{model.id}/resolve/{model.revision or 'main'}/{name}"


def ask(url: str, timeout: float) -> str:
    """``reachable``, or why not, in words."""
    try:
        with urllib.request.build_opener(_Stay).open(urllib.request.Request(url, method="HEAD"), timeout=timeout):
            return "reachable"
    except urllib.error.HTTPError as e:
        if 300 <= e.code < 400:
            return "reachable"
        if e.code in (401, 403):
            return f"refused ({e.code}): accept its licence on its page, then `hf auth login`"
        return "gone or moved (404)" if e.code == 404 else f"its server answers {e.code}"
    except OSError as e:
        return f"no answer ({getattr(e, 'reason', None) or e})"


def reach(models: Sequence[Model], timeout: float = 3.0) -> dict[str, str]:
    """Answer for each id; all are asked at once, so it takes about one ``timeout`` [s]."""
    if offline():
        return {m.id: "not asked: HF_HUB_OFFLINE is set" for m in models}
    with ThreadPoolExecutor(max(1, len(models))) as pool:
        return dict(zip((m.id for m in models), pool.map(lambda m: ask(address(m), timeout), models), strict=True))
