"""A league's pages as files, for any web space: the same pages, without what needs a server."""

from __future__ import annotations

import asyncio
import html
import json
import posixpath
import re
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import parse_qsl, urlsplit

from starlette.types import ASGIApp, Message

from league.atomic_file import replacing
from league.errors import ConfigError
from league.matchmaking.store import SeasonView, Store
from league.web.app import make_app

LINK = re.compile(r' (href|src|data-replay)="(/[^"]*)"')
"""Links within the site, in the pages' own markup."""
KEPT = re.compile(
    r"/(standings|heats|tracks|seasons|time-attack|definitions)?"
    r"|/seasons/\d+(\?page=\d+)?|/cups/\d+(\?(round=\d+(&page=\d+)?|page=\d+))?"
    r"|/time-attack\?races=\w+"
    r"|/standings\?(against=\d+(&page=\d+)?|page=\d+)"
    r"|/drivers/\d+|/heats/\d+(\?race=\d+)?"
    r"|/matchups/\d+/\d+(\?before=\d+)?|/static/[\w.]+"
)
"""Addresses that become files."""


@dataclass(frozen=True)
class Exported:
    """What was written."""

    pages: int
    """Pages."""
    heats: int
    """Races among them, each with its player."""


def export(store: Store, folder: Path, *, heats: int, season: int | None = None) -> Exported:
    """Write a league's pages into a new or empty folder; they need no server.

    Args:
        store: the league.
        folder: is made if it is not there.
        heats: so many of the newest ones get pages, and links to others become text.
        season: number of a season that is over, which the pages show as it was at its end.

    Raises:
        ConfigError: there is something in the folder, or it cannot be written.
        StoreError: there is no such season, or it is not over.
    """
    if season is not None:
        store = SeasonView(store, season)
    if folder.is_file() or (folder.is_dir() and any(folder.iterdir())):
        raise ConfigError(f"{folder} is not empty: give a new folder, so that nothing is mixed up")
    numbers = {one.number for one in store.heats(("done",), limit=heats, newest=True)}
    return asyncio.run(_export(make_app(store, exported=True), folder, numbers))


async def _export(app: ASGIApp, folder: Path, heats: set[int]) -> Exported:
    waiting, known = deque(["/"]), {"/"}
    pages = players = 0
    while waiting:
        address = waiting.popleft()
        content = await _get(app, address)
        name = _file(address)
        if name.endswith(".html"):
            text, links = _relinked(content.decode(), name, heats)
            new = [link for link in dict.fromkeys(links) if link not in known]
            known.update(new)
            waiting.extend(new)
            replay = re.search(r'data-replay="([^"]*)"', content.decode())
            if replay:
                data = (await _get(app, replay.group(1))).decode()
                text = _with_data(text, data)
                players += address.startswith("/heats")
            content, pages = text.encode(), pages + 1
        with replacing(folder / name, "the page", ConfigError) as file:
            file.write_bytes(content)
    return Exported(pages, players)


def _relinked(text: str, name: str, heats: set[int]) -> tuple[str, list[str]]:
    """Return a page with links to files instead of addresses, and the addresses it links to."""
    links: list[str] = []

    def relink(match: re.Match[str]) -> str:
        attribute, written = match.groups()
        url = urlsplit(html.unescape(written))
        address = _canonical(url.path, url.query)
        heat = re.match(r"/heats/(\d+)", address)
        if attribute == "data-replay":
            return " data-replay"
        if not KEPT.fullmatch(address) or (heat and int(heat.group(1)) not in heats):
            return ""
        links.append(address)
        path = posixpath.relpath(_file(address), posixpath.dirname(name) or ".")
        return f' {attribute}="{path}{"#" + url.fragment if url.fragment else ""}"'

    return LINK.sub(relink, text), links


def _canonical(path: str, query: str) -> str:
    """Return the address of a page: the first race of a heat is the heat's own page."""
    asked = "&".join(f"{name}={value}" for name, value in parse_qsl(query))
    return path if asked in ("", "race=1") else f"{path}?{asked}"


def _file(address: str) -> str:
    """Return the name of the file that an address becomes."""
    path = address.lstrip("/") or "index"
    if path.startswith("static/"):
        return path
    return re.sub(r"[?=&]", "-", path) + ".html"


def _with_data(text: str, data: str) -> str:
    """Return a page with the race that its player plays, which a file cannot fetch."""
    safe = json.dumps(json.loads(data), separators=(",", ":")).replace("<", "\\u003c")
    script = f'<script type="application/json" id="race-data">{safe}</script>'
    return text.replace("</main>", f"{script}\n</main>")


async def _get(app: ASGIApp, address: str) -> bytes:
    """Return what the application answers to a request."""
    url = urlsplit(address)
    answers: list[Message] = []

    async def receive() -> Message:
        return {"type": "http.request", "body": b"", "more_body": False}

    async def send(message: Message) -> None:
        answers.append(message)

    scope = {
        "type": "http",
        "http_version": "1.1",
        "method": "GET",
        "scheme": "http",
        "path": url.path,
        "raw_path": url.path.encode(),
        "query_string": url.query.encode(),
        "headers": [(b"host", b"localhost")],
        "server": ("localhost", 80),
    }
    await app(scope, receive, send)
    status = answers[0]["status"]
    if status != 200:
        raise ConfigError(f"the page {address} cannot be exported (status {status})")
    return b"".join(answer["body"] for answer in answers[1:])
