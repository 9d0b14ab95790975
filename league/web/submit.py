"""Entering and retiring drivers over HTTP: for programs with a token, and a form for browsers."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from email.message import Message
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response
from starlette.routing import Route

from league.agents.checkpoint import MAX_SIZE_CAMERA
from league.matchmaking import submission
from league.matchmaking.store import Entry, EntryState, Store, Token
from league.race_spec import printable
from league.web.protected import UPLOADS, Asked, Protected, refusing
from league.web.security import Access, body_of, check_origin, client_of

FORM = "/submit"
"""Address of the form."""
MOST_FORM = MAX_SIZE_CAMERA + (64 << 10)
"""Bytes of a form with the largest file."""
MOST_FIELD = 1000
"""Bytes of a field that is no file."""
Render = Callable[..., Response]
"""Renders a template: its name, request and status, then its values by name."""


@dataclass(frozen=True)
class Submitted:
    """What became of a submission."""

    number: int
    """Number of the entry."""
    id: str
    name: str
    """Another one than was given if the same policy is entered already."""
    owner: str
    state: EntryState
    near_copy_of: str
    """Name of the earlier entry with nearly the same weights; empty for none."""
    page: str
    """Where its validation and its races can be followed."""


class Retirement(BaseModel):
    """Which driver leaves the league."""

    model_config = ConfigDict(extra="forbid")
    entry: Annotated[str, Field(min_length=1, max_length=100), AfterValidator(printable)]
    """Name or id of the entry."""
    reason: Annotated[str, Field(max_length=300), AfterValidator(printable)] = ""
    """Why, for people to read."""


@dataclass(frozen=True)
class Retired:
    """What became of an entry that was to leave."""

    name: str
    state: EntryState
    changed: bool
    """False if it was retired already."""


def enter(store: Store, access: Access, token: Token, content: bytes, name: str) -> Entry:
    """Check what the owner of a token sent, and enter it, as `league submit` does."""
    if not name:
        raise HTTPException(422, "The entry has no name: give one.")
    with refusing():
        return submission.accept(store, content, name, token.owner, access.quota)


def _submit(asked: Asked) -> Submitted:
    entry = enter(asked.store, asked.access, asked.token, asked.body, asked.query["name"])
    return Submitted(
        number=entry.number,
        id=entry.id,
        name=entry.name,
        owner=entry.owner,
        state=entry.state,
        near_copy_of=entry.near_copy_of,
        page=f"/drivers/{entry.number}",
    )


def _retire(asked: Asked) -> Retired:
    entry = asked.store.entry(asked.body.entry)
    if entry.owner != asked.token.owner and not asked.token.allows("admin"):
        raise HTTPException(
            403, f"{entry.name} is {entry.owner}'s: only its owner's token can retire it."
        )
    changed = asked.store.move(
        {entry.id: "retired"}, reason=asked.body.reason, actor=asked.token.owner
    )
    return Retired(entry.name, "retired", bool(changed))


ADDRESSES = (
    Protected(
        "/api/v1/entries",
        "Submit a driver: a safetensors file with a card, as `league pack` writes it",
        "submit",
        _submit,
        Submitted,
        most_bytes=MAX_SIZE_CAMERA,
        query={"name": "Name shown to people"},
    ),
    Protected(
        "/api/v1/entries/retire",
        "Take an entry of the token's owner out of the league; there is no way back",
        "submit",
        _retire,
        Retired,
        body=Retirement,
    ),
)
"""Addresses for programs."""


def form(store: Store, access: Access, render: Render) -> Route:
    """Return the route of the form: GET shows it, POST takes what was filled in."""
    free = asyncio.Semaphore(UPLOADS)

    def shown(request: Request, status: int = 200, sentence: str = "", name: str = "") -> Response:
        response = render("submit.html", request, status, sentence=sentence, name=name)
        # An older browser says by Origin where a form came from, which no-referrer would hide.
        response.headers["Referrer-Policy"] = "same-origin"
        response.headers["Cache-Control"] = "no-store"
        return response

    def entered(request: Request, fields: dict[str, bytes]) -> Entry:
        secret = _text(fields, "token")
        token = access.token(store, secret, "submit", client_of(request))
        access.limits.submissions.check(token.owner)
        access.limits.submissions.take(token.owner)
        if not fields.get("file"):
            raise HTTPException(422, "There was no file: choose the one that `league pack` wrote.")
        return enter(store, access, token, fields["file"], _text(fields, "name"))

    async def respond(request: Request) -> Response:
        if request.method != "POST":
            return shown(request)
        fields: dict[str, bytes] = {}
        try:
            check_origin(request)
            async with free:
                body = await body_of(request, MOST_FORM)
                fields = form_fields(request.headers.get("content-type", ""), body)
                entry = await run_in_threadpool(entered, request, fields)
        except HTTPException as error:
            return shown(request, error.status_code, error.detail, _text(fields, "name"))
        return RedirectResponse(f"/drivers/{entry.number}", 303)

    return Route(FORM, respond, methods=["GET", "POST"])


def form_fields(kind: str, body: bytes) -> dict[str, bytes]:
    """Return the fields of a form with a file (multipart/form-data, RFC 7578) by their names.

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


def _text(fields: dict[str, bytes], name: str) -> str:
    return fields.get(name, b"")[:MOST_FIELD].decode("utf-8", "replace").strip()
