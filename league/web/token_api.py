"""What needs a token: entering and retiring drivers, also by forms; heats for workers elsewhere."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError
from starlette.exceptions import HTTPException

from league.agents.checkpoint import MAX_SIZE_CAMERA
from league.errors import StoreError, brief
from league.matchmaking import submission, wire
from league.matchmaking.documents import names_of
from league.matchmaking.store import EntryState, HeatRecord, LeagueEntry, Received
from league.matchmaking.store.queue import LEASE_S
from league.race_spec import printable
from league.web.protected import Asked, Form, Protected, text
from league.web.reader import Document, Reader

WORK = "/api/v1/work"
MOST_HELD = 64
"""Heats that all workers of a token hold at a time."""
MOST_RESULTS = 16 << 20
"""Bytes of a message with results and recordings."""


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


def enter(asked: Asked, content: bytes, name: str, *, download: bool) -> LeagueEntry:
    """Check what the owner of a token sent, and enter it, as `league submit` does."""
    if not name:
        raise HTTPException(422, "The entry has no name: give one.")
    owner, quota = asked.token.owner, asked.access.quota
    return submission.accept(asked.store, content, name, owner, quota, download=download)


def _submit(asked: Asked) -> Submitted:
    name, offered = asked.query["name"], asked.query["download"]
    if offered not in ("", "false", "true"):
        raise HTTPException(422, f"download is {brief(offered)}: give true or false.")
    entry = enter(asked, asked.body, name, download=offered == "true")
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


def worker_of(asked: Asked) -> str:
    """Return what the store knows the asking worker by: no other token has it."""
    return f"{asked.token.number}/{asked.token.owner[:80]}/{asked.body.worker}"


def _held(asked: Asked) -> list[HeatRecord]:
    """Return the heats that workers of a token hold."""
    prefix = f"{asked.token.number}/"
    claimed = asked.store.heats(("claimed",))
    return [record for record in claimed if (record.worker or "").startswith(prefix)]


def _claim(asked: Asked) -> wire.Lent:
    claim: wire.Claim = asked.body
    physics = asked.store.settings.ruleset.physics
    if claim.physics != physics:
        raise HTTPException(
            409,
            f"This league races with physics {physics}, and this worker has {claim.physics[:20]}: "
            "use the version of the program that the server has.",
        )
    limit = min(claim.limit, MOST_HELD - len(_held(asked)))
    if limit <= 0:
        return wire.Lent()
    worker, owner = worker_of(asked), asked.token.owner
    records = asked.store.claim(worker, limit, lease_s=claim.lease_s, lender=owner)
    if not records:
        return wire.Lent()
    entries = {entry.id: entry for entry in asked.store.entries()}
    return wire.lent(records, asked.store.rulesets(), entries)


def _renew(asked: Asked) -> wire.Held:
    renewal: wire.Renewal = asked.body
    if not renewal.keys:
        return wire.Held()
    keys = asked.store.heartbeat(worker_of(asked), lease_s=renewal.lease_s, keys=renewal.keys)
    return wire.Held(keys=tuple(keys))


def _show(asked: Asked) -> wire.Held:
    """Keep what is sent as it is: it is checked when the race is followed."""
    sent: wire.Showing = asked.body
    asked.store.show(worker_of(asked), [wire.progress_of(one) for one in sent.heats])
    return wire.Held(keys=tuple(one.key for one in sent.heats))


def _complete(asked: Asked) -> Received:
    """Take in results of heats that this worker was lent last; others count as repeated."""
    sent: wire.Sent = asked.body
    store, worker = asked.store, worker_of(asked)
    names = names_of(store.entries())
    rules, outcomes, late = store.rulesets(), [], []
    for one in sent.heats:
        record = store.heat(one.key)
        if record.worker != worker:
            late.append(one.key)  # its lease had ended, and another worker has it
            continue
        if one.machine and rules[record.heat.ruleset].solver != "bullet":
            # A class of machine excuses other bits, and these races have the same on all.
            raise StoreError(f"heat {record.number} is planar, and a machine was named: name none")
        seeded = replace(record, seeds=store.seeds(record.heat))
        outcomes.append(wire.outcome_of(one, seeded, names))
    received = store.complete(worker, outcomes)
    store.audit((*received.accepted, *received.repeated), asked.access.audited)
    return received.joined(Received(repeated=tuple(late)))


def _fail(asked: Asked) -> wire.State:
    failure: wire.Failure = asked.body
    state = asked.store.fail(worker_of(asked), failure.key, failure.traceback, lost=failure.lost)
    return wire.State(state=state)


def _weights(asked: Asked) -> bytes:
    """Return the weights of a driver that races in a heat which the token holds."""
    ids = {id for record in _held(asked) for id in record.heat.entries}
    blobs = {entry.blob for entry in asked.store.entries() if entry.id in ids}
    if asked.query["digest"] not in blobs:
        raise HTTPException(404, "No heat that this token holds needs such a file.")
    return asked.store.blobs.get(asked.query["digest"])


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
    Protected(
        f"{WORK}/claim", f"Claim heats, lent for {LEASE_S:.0f} s unless said otherwise",
        "worker", _claim, wire.Lent, body=wire.Claim,
    ),
    Protected(
        f"{WORK}/heartbeat", "Renew the leases of heats", "worker", _renew, wire.Held,
        body=wire.Renewal,
    ),
    Protected(
        f"{WORK}/progress", "Show how far heats have come", "worker", _show, wire.Held,
        body=wire.Showing, most_bytes=MOST_RESULTS,
    ),
    Protected(
        f"{WORK}/complete", "Hand in results of heats; sending them again changes nothing",
        "worker", _complete, Received, body=wire.Sent, most_bytes=MOST_RESULTS,
    ),
    Protected(
        f"{WORK}/fail", "Hand back a heat that could not be raced", "worker", _fail, wire.State,
        body=wire.Failure,
    ),
    Protected(
        f"{WORK}/weights", "The weights of a driver in a heat that the token holds", "worker",
        _weights, bytes, method="GET", query={"digest": "SHA-256 of the file"},
    ),
)  # fmt: skip
"""Addresses for programs."""


def _entered(asked: Asked, _: Document) -> str:
    if not asked.body.get("file"):
        raise HTTPException(422, "There was no file: choose the one that `league pack` wrote.")
    name = text(asked.body, "name")
    offered = bool(text(asked.body, "download"))
    entry = enter(asked, asked.body["file"], name, download=offered)
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
