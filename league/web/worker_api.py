"""Lending heats to workers on other machines, and taking their results in."""

from __future__ import annotations

from dataclasses import replace

from starlette.exceptions import HTTPException

from league.errors import StoreError
from league.matchmaking import wire
from league.matchmaking.documents import names_of
from league.matchmaking.store import HeatRecord, Received, Token
from league.matchmaking.store.queue import LEASE_S
from league.web.protected import Asked, Protected

WORK = "/api/v1/work"
MOST_HELD = 64
"""Heats that all workers of a token hold at a time."""
MOST_RESULTS = 16 << 20
"""Bytes of a message with results and recordings."""


def worker_of(token: Token, name: str) -> str:
    """Return what the store knows a remote worker by: no other token has it."""
    return f"{token.number}/{token.owner[:80]}/{name}"


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
    name, owner = worker_of(asked.token, claim.worker), asked.token.owner
    records = asked.store.claim(name, limit, lease_s=claim.lease_s, lender=owner)
    if not records:
        return wire.Lent()
    entries = {entry.id: entry for entry in asked.store.entries()}
    return wire.lent(records, asked.store.rulesets(), entries)


def _renew(asked: Asked) -> wire.Held:
    renewal: wire.Renewal = asked.body
    worker = worker_of(asked.token, renewal.worker)
    if not renewal.keys:
        return wire.Held()
    keys = asked.store.heartbeat(worker, lease_s=renewal.lease_s, keys=renewal.keys)
    return wire.Held(keys=tuple(keys))


def _complete(asked: Asked) -> Received:
    """Take in results of heats that this worker was lent last; others count as repeated."""
    sent: wire.Sent = asked.body
    store, worker = asked.store, worker_of(asked.token, sent.worker)
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
    return Received(
        received.accepted, (*received.repeated, *late), received.quarantined, received.unverified
    )


def _fail(asked: Asked) -> wire.State:
    failure: wire.Failure = asked.body
    worker = worker_of(asked.token, failure.worker)
    state = asked.store.fail(worker, failure.key, failure.traceback, lost=failure.lost)
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
        f"{WORK}/claim", f"Claim heats, lent for {LEASE_S:.0f} s unless said otherwise",
        "worker", _claim, wire.Lent, body=wire.Claim,
    ),
    Protected(
        f"{WORK}/heartbeat", "Renew the leases of heats", "worker", _renew, wire.Held,
        body=wire.Renewal,
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
"""Addresses for workers."""
