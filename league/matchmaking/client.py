"""A league that another machine serves, reached over HTTP with a token."""

from __future__ import annotations

import http.client
import json
import re
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import quote, urlsplit

from league.errors import ConfigError, StoreError, brief

TOKEN = re.compile(r"league_[A-Za-z0-9_-]{43}")
HERE = ("127.0.0.1", "localhost", "::1")
"""Hosts to which a token may travel unencrypted."""
TIMEOUT_S = 60.0
"""Longest silence of a server [s]."""
MOST_ANSWER = 128 << 20
"""Bytes of an answer that are read."""
BUSY = (429, 502, 503, 504)
"""Answers after which the same request may succeed later."""


class _NoRedirects(urllib.request.HTTPRedirectHandler):
    """Follows no redirect: it would take the token to another place."""

    def redirect_request(self, req: Any, *_: Any, **__: Any) -> None:  # noqa: ANN401
        return None


@dataclass(frozen=True)
class Client:
    """A served league."""

    url: str
    """Its address, without a slash at the end."""
    token: str = field(repr=False)
    patience_s: float = 0.0
    """How long a request is repeated while the server is busy or away [s]."""
    sleep: Callable[[float], None] = time.sleep

    @classmethod
    def of(cls, url: str, token: str, *, insecure: bool = False) -> Client:
        """Return a league by its address.

        Args:
            url: of its first page, http:// or https://.
            token: the secret.
            insecure: whether the token may travel unencrypted to another machine.

        Raises:
            ConfigError: the address or the token is not possible, or the token would be readable
                on its way.
        """
        parts = urlsplit(url)
        if parts.scheme not in ("http", "https") or not parts.hostname or "@" in parts.netloc:
            raise ConfigError(
                f"{brief(url)} is no address of a served league: give one such as "
                "https://league.example.org"
            )
        if not token:
            raise ConfigError(
                "there is no token: put it into the environment variable LEAGUE_TOKEN; who runs "
                "the league makes one with `league token create`"
            )
        if not TOKEN.fullmatch(token):
            raise ConfigError(
                f"the token has {len(token)} characters and not the form of one: copy all of "
                "league_... (50 characters) that `league token create` printed"
            )
        if parts.scheme == "http" and parts.hostname not in HERE and not insecure:
            raise ConfigError(
                f"the token would travel readable to {parts.hostname}: use https://, or allow it "
                "in a network that you trust with --insecure"
            )
        return cls(url.rstrip("/"), token)

    def submit(self, content: bytes, name: str) -> dict[str, Any]:
        """Send an entry, as submission.pack makes it; return what the server says of it."""
        path = f"/api/v1/entries?name={quote(name, safe='')}"
        return self.ask(path, content, "application/octet-stream")

    def ask(self, path: str, body: bytes, kind: str = "application/json") -> dict[str, Any]:
        """Send a body, and return the JSON that comes back."""
        answer = self.fetch(path, body, kind)
        try:
            return dict(json.loads(answer))
        except ValueError as error:
            raise StoreError(f"{self.url} answers as no league does: check the address") from error

    def fetch(self, path: str, body: bytes | None = None, kind: str = "") -> bytes:
        """Return what an address answers; a busy or absent server is asked again for a while.

        Raises:
            StoreError: it refuses, with its sentence, or cannot be reached.
        """
        give_up_s, pause_s = time.monotonic() + self.patience_s, 0.5
        while True:
            try:
                return self._once(path, body, kind)
            except urllib.error.HTTPError as error:
                refusal, wait_s = self._refusal(error), _wait_s(error)
                if error.code not in BUSY:
                    raise refusal from None
            except (OSError, http.client.HTTPException) as error:
                refusal, wait_s = self._unreachable(error), 0.0
            pause_s = min(2 * pause_s, 30.0)
            if time.monotonic() + max(pause_s, wait_s) > give_up_s:
                raise refusal
            self.sleep(max(pause_s, wait_s))

    def _once(self, path: str, body: bytes | None, kind: str) -> bytes:
        headers = {"Authorization": f"Bearer {self.token}", "User-Agent": "racing-league"}
        if kind:
            headers["Content-Type"] = kind
        request = urllib.request.Request(self.url + path, body, headers)
        opener = urllib.request.build_opener(_NoRedirects)
        with opener.open(request, timeout=TIMEOUT_S) as answer:
            return answer.read(MOST_ANSWER)

    def _unreachable(self, error: Exception) -> StoreError:
        reason = str(getattr(error, "reason", None) or error)[:200] or type(error).__name__
        return StoreError(
            f"{self.url} cannot be reached ({reason}): check the address, and that `league serve` "
            "runs there"
        )

    def _refusal(self, error: urllib.error.HTTPError) -> StoreError:
        """Return what a server said, as an error."""
        with error:
            text = error.read(10_000)
        if 300 <= error.code < 400:
            where = brief(error.headers.get("location", ""))
            return StoreError(f"{self.url} is now {where}: give that address")
        try:
            sentence = str(json.loads(text)["error"]).removesuffix(".")
        except (ValueError, KeyError, TypeError):
            sentence = f"{self.url} answers {error.code} {error.reason}: is a league served there?"
        printable = "".join(letter if letter.isprintable() else "?" for letter in sentence)
        return StoreError(printable[:1000])


def _wait_s(error: urllib.error.HTTPError) -> float:
    """Return how long a server asks to wait [s]."""
    text = error.headers.get("retry-after", "")
    return float(text) if text.isdecimal() and len(text) < 5 else 0.0
