"""Addresses and forms that need a token: what each takes, who may ask, and how it answers."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from email.message import Message
from functools import partial
from typing import Any, Literal

from pydantic import BaseModel, ValidationError
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, RedirectResponse, Response
from starlette.routing import Route

from league.errors import DatabaseError, LeagueError, QuotaError, brief, first_problem
from league.matchmaking.documents import plain
from league.matchmaking.store import Scope, Store, Token
from league.web.reader import Document, Reader
from league.web.security import Access, bearer, body_of, check_origin, drain

UPLOADS = 4
"""Uploads that are read and checked at the same time; each may take 16 MiB."""
REQUESTS = 8
"""Other requests at the same time, for each address."""
MOST_FIELDS = 64 << 10
"""Bytes of a form without its file."""
MOST_FIELD = 1000
"""Bytes of a field that is no file."""
Fields = Mapping[str, bytes]
"""The fields of a form by their names."""
Render = Callable[..., Response]
"""Renders a template: its name, request and status, then its values by name."""


@dataclass(frozen=True)
class Asked:
    """A request that passed: who asks, and what for."""

    store: Store
    access: Access
    token: Token
    body: Any
    """A checked `Protected.body`, or bytes."""
    query: Mapping[str, str]
    """Parameters of path and query."""


@dataclass(frozen=True)
class Protected:
    """An address that needs a token."""

    path: str
    """As Starlette writes routes."""
    summary: str
    """What it does, in a few words."""
    scope: Scope
    """What the token must allow."""
    handle: Callable[[Asked], object]
    """Does it; runs in a thread. Returns JSON's plain data, frozen data, or bytes."""
    answer: type
    """Type of what it returns."""
    method: Literal["GET", "POST"] = "POST"
    body: type[BaseModel] | None = None
    """What a POST holds; None for bytes."""
    most_bytes: int = 1 << 20
    """Longest body."""
    query: Mapping[str, str] = field(default_factory=dict)
    """Parameters after the question mark, all of them text, each with its meaning."""

    def route(self, store: Store, access: Access) -> Route:
        """Return the route that answers it."""
        is_upload = self.method == "POST" and self.body is None
        slots = asyncio.Semaphore(UPLOADS if is_upload else REQUESTS)

        async def respond(request: Request) -> Response:
            try:
                token = await run_in_threadpool(self._authorised, store, access, request)
            except HTTPException:
                await drain(request)
                raise
            async with slots:
                content = await body_of(request, self.most_bytes)
                query = {name: request.query_params.get(name, "") for name in self.query}
                asked = Asked(store, access, token, content, {**request.path_params, **query})
                return await run_in_threadpool(self._answer, asked)

        return Route(self.path, respond, methods=[self.method])

    def _authorised(self, store: Store, access: Access, request: Request) -> Token:
        token = access.token(request, store, bearer(request), self.scope)
        is_work = self.scope == "worker"
        limit = access.limits.work if is_work else access.limits.submissions
        limit.charge(str(token.number) if is_work else token.owner)
        return token

    def _answer(self, asked: Asked) -> Response:
        with refusing():
            value = self.handle(replace(asked, body=self._parsed(asked.body)))
        if isinstance(value, bytes):
            return Response(value, media_type="application/octet-stream")
        return JSONResponse(plain(value))

    def _parsed(self, content: bytes) -> object:
        """Return a body, checked."""
        if self.body is None:
            return content
        try:
            return self.body.model_validate_json(content)
        except ValidationError as error:
            first, where, _ = first_problem(error, "The body")
        found = "" if first["type"] in ("missing", "json_invalid") else brief(first["input"])
        reason = f"{first['msg'][:200]}{f', not {found}' if found else ''}"
        raise HTTPException(422, f"{where}: {reason}; see /api/v1/openapi.json.")


@contextmanager
def refusing() -> Generator[None]:
    """Turn what the league refuses into an answer with the reason.

    Raises:
        HTTPException: 429 for a quota, 503 for a database that fails, otherwise 422.
    """
    try:
        yield
    except QuotaError as error:
        raise HTTPException(429, f"{error}.") from error
    except DatabaseError as error:
        sentence = "The league cannot be read or written now: try again later."
        raise HTTPException(503, sentence) from error
    except LeagueError as error:
        raise HTTPException(422, f"{error}.") from error


@dataclass(frozen=True)
class Form:
    """A page with a form: GET shows it, POST takes what was filled in."""

    path: str
    """As Starlette writes routes."""
    template: str
    """File of the page; besides what `about` returns it is given `sentence`, the reason of a
    refusal, and the fields that are kept."""
    act: Callable[[Asked, Document], str]
    """Does what is asked for, with the fields as the body and what `about` returned; runs in a
    thread. Returns the address to go to."""
    kept: tuple[str, ...]
    """Fields that a refused form shows again; never the token."""
    about: Callable[..., Document] = lambda reader: {}
    """Returns what the page shows, from a Reader and the parameters of the path by their names."""
    most_file: int = 0
    """Bytes of the largest file."""

    def route(self, reader: Reader, access: Access, render: Render) -> Route:
        """Return the route that answers it."""
        free = asyncio.Semaphore(UPLOADS)

        async def respond(request: Request) -> Response:
            document = await run_in_threadpool(self.about, reader, **request.path_params)

            def shown(fields: Fields, status: int = 200, sentence: str = "") -> Response:
                kept = {name: text(fields, name) for name in self.kept}
                page = render(self.template, request, status, sentence=sentence, **kept, **document)
                # An older browser says by Origin where a form came from, which no-referrer hides.
                page.headers["Referrer-Policy"] = "same-origin"
                page.headers["Cache-Control"] = "no-store"
                return page

            if request.method != "POST":
                return shown({})
            fields: Fields = {}
            try:
                check_origin(request)
                async with free:
                    body = await body_of(request, self.most_file + MOST_FIELDS)
                    fields = form_fields(request.headers.get("content-type", ""), body)
                    act = partial(self._acted, reader, access, request, fields)
                    address = await run_in_threadpool(act, document)
            except HTTPException as error:
                await drain(request)
                return shown(fields, error.status_code, error.detail)
            if "hx-request" in request.headers:  # a script would follow 303 without the browser
                return Response(status_code=204, headers={"HX-Redirect": address})
            return RedirectResponse(address, 303)

        return Route(self.path, respond, methods=["GET", "POST"])

    def _acted(
        self, reader: Reader, access: Access, request: Request, fields: Fields, document: Document
    ) -> str:
        """Do what a form asks for, if the token that it holds may do this now."""
        token = access.token(request, reader.store, text(fields, "token"), "submit")
        access.limits.submissions.charge(token.owner)
        with refusing():
            asked = Asked(reader.store, access, token, fields, request.path_params)
            return self.act(asked, document)


def form_fields(kind: str, body: bytes) -> Fields:
    """Return the fields of a form (multipart/form-data, RFC 7578) by their names.

    Its kind is the Content-Type header, which names the boundary.

    Raises:
        HTTPException: 422 for another kind of form.
    """
    boundary = _mime_header(kind).get_param("boundary")
    if not isinstance(boundary, str) or not 1 <= len(boundary) <= 70:
        raise HTTPException(422, "This was not sent by the form: use the form, with a file.")
    fields = {}
    delimiter = b"\r\n--" + boundary.encode("latin-1", "replace")
    for part in (b"\r\n" + body).split(delimiter)[1:-1]:
        head, _, content = part.removeprefix(b"\r\n").partition(b"\r\n\r\n")
        for line in head.decode("latin-1").split("\r\n"):
            title, _, value = line.partition(":")
            if title.strip().lower() == "content-disposition":
                fields[str(_mime_header(value).get_param("name"))] = content
    return fields


def _mime_header(value: str) -> Message:
    message = Message()
    message["content-type"] = value.replace("\r", "").replace("\n", "")
    return message


def text(fields: Fields, name: str) -> str:
    """Return a field that people filled in; empty for one that is missing."""
    return fields.get(name, b"")[:MOST_FIELD].decode("utf-8", "replace").strip()
