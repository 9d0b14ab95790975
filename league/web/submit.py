"""Entering and retiring drivers over HTTP: for programs with a token, and forms for browsers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError
from starlette.exceptions import HTTPException

from league.agents.checkpoint import MAX_SIZE_CAMERA
from league.errors import brief
from league.matchmaking import submission
from league.matchmaking.store import EntryState, LeagueEntry, Store, Token
from league.race_spec import printable
from league.web.protected import Asked, Form, Protected, text
from league.web.reader import Document, Reader
from league.web.security import Access


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
    downloadable: bool
    """Whether everyone may have the weights, which the first submission decides."""
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


def enter(
    store: Store, access: Access, token: Token, content: bytes, name: str, *, download: bool
) -> LeagueEntry:
    """Check what the owner of a token sent, and enter it, as `league submit` does."""
    if not name:
        raise HTTPException(422, "The entry has no name: give one.")
    return submission.accept(store, content, name, token.owner, access.quota, download=download)


def _submit(asked: Asked) -> Submitted:
    name, offered = asked.query["name"], asked.query["download"]
    if offered not in ("", "false", "true"):
        raise HTTPException(422, f"download is {brief(offered)}: give true or false.")
    entry = enter(
        asked.store, asked.access, asked.token, asked.body, name, download=offered == "true"
    )
    same = ("number", "id", "name", "owner", "state", "near_copy_of", "downloadable")
    values = {name: getattr(entry, name) for name in same}
    return Submitted(**values, page=f"/drivers/{entry.number}")


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
        query={
            "name": "Name shown to people",
            "download": "true lets everyone download the weights; false by default",
        },
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


def _entered(asked: Asked, _: Document) -> str:
    if not asked.body.get("file"):
        raise HTTPException(422, "There was no file: choose the one that `league pack` wrote.")
    name = text(asked.body, "name")
    offered = bool(text(asked.body, "download"))
    entry = enter(
        asked.store, asked.access, asked.token, asked.body["file"], name, download=offered
    )
    return f"/drivers/{entry.number}"


def _leaving(reader: Reader, number: int) -> Document:
    """Return a driver as it is now, which pages that are kept may not show yet."""
    return {"entry": reader.store.entry(reader.entry(number).id)}


def _left(asked: Asked, document: Document) -> str:
    entry: LeagueEntry = document["entry"]
    if not text(asked.body, "sure"):
        raise HTTPException(422, f"{entry.name} stays: tick the box to retire it for good.")
    try:
        meant = Retirement(entry=entry.id, reason=text(asked.body, "reason"))
    except ValidationError as error:
        raise HTTPException(422, "The reason must be one line of at most 300 letters.") from error
    _retire(replace(asked, body=meant))
    return f"/drivers/{entry.number}/retire"


FORMS = (
    Form("/submit", "submit.html", _entered, ("name", "download"), most_file=MAX_SIZE_CAMERA),
    Form("/drivers/{number:number}/retire", "retire.html", _left, ("reason",), _leaving),
)
"""Forms for browsers."""
