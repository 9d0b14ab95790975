"""Forms for browsers: pages that take a token, and work without JavaScript."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from email.message import Message

from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response
from starlette.routing import Route

from league.web.protected import UPLOADS, Asked, refusing
from league.web.reader import Document, Reader
from league.web.security import Access, body_of, check_origin, client_of, drain

MOST_FIELDS = 64 << 10
"""Bytes of a form without its file."""
MOST_FIELD = 1000
"""Bytes of a field that is no file."""
Fields = Mapping[str, bytes]
"""The fields of a form by their names."""
Render = Callable[..., Response]
"""Renders a template: its name, request and status, then its values by name."""


def _nothing(_: Reader) -> Document:
    return {}


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
    about: Callable[..., Document] = _nothing
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
                    asked = await run_in_threadpool(_asked, reader, access, request, fields)
                    address = await run_in_threadpool(self._acted, asked, document)
            except HTTPException as error:
                await drain(request)
                return shown(fields, error.status_code, error.detail)
            return RedirectResponse(address, 303)

        return Route(self.path, respond, methods=["GET", "POST"])

    def _acted(self, asked: Asked, document: Document) -> str:
        with refusing():
            return self.act(asked, document)


def _asked(reader: Reader, access: Access, request: Request, fields: Fields) -> Asked:
    """Return a form with the token that it holds; refuse one that may not do this, or not now."""
    secret = text(fields, "token")
    token = access.token(reader.store, secret, "submit", client_of(request))
    access.limits.submissions.charge(token.owner)
    return Asked(reader.store, access, token, fields, request.path_params)


def form_fields(kind: str, body: bytes) -> Fields:
    """Return the fields of a form (multipart/form-data, RFC 7578) by their names.

    Args:
        kind: the Content-Type header, which names the boundary.
        body: what was sent.

    Raises:
        HTTPException: 422 for another kind of form.
    """
    boundary = _header(kind).get_param("boundary")
    if not isinstance(boundary, str) or not 1 <= len(boundary) <= 70:
        raise HTTPException(422, "This was not sent by the form: use the form, with a file.")
    fields = {}
    delimiter = b"\r\n--" + boundary.encode("latin-1", "replace")
    for part in (b"\r\n" + body).split(delimiter)[1:-1]:
        head, _, content = part.removeprefix(b"\r\n").partition(b"\r\n\r\n")
        for line in head.decode("latin-1").split("\r\n"):
            title, _, value = line.partition(":")
            if title.strip().lower() == "content-disposition":
                fields[str(_header(value).get_param("name"))] = content
    return fields


def _header(value: str) -> Message:
    message = Message()
    message["content-type"] = value.replace("\r", "").replace("\n", "")
    return message


def text(fields: Fields, name: str) -> str:
    """Return a field that people filled in; empty for one that is missing."""
    return fields.get(name, b"")[:MOST_FIELD].decode("utf-8", "replace").strip()
