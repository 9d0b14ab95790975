"""The family of a policy: the checkpoints it was trained from, and those trained from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from league.matchmaking.store import Entry

GENERATIONS = 8
"""Generations of ancestors that are shown."""
MOST = 40
"""Ancestors that are shown; cards are strangers' texts, and may name any number."""


@dataclass(frozen=True)
class Ancestor:
    """A checkpoint that a policy was trained from."""

    digest: str
    """Of its file."""
    number: int | None
    """Number of the entry it is; None if it was never entered in this league."""
    name: str
    """Name of that entry; empty if unknown."""
    parents: list[Ancestor] = field(default_factory=list)
    """What it was trained from, as far as its entry tells."""


def ancestors(entries: Sequence[Entry], entry: Entry) -> list[Ancestor]:
    """Return the parents of an entry, each with its own."""
    by_digest = {digest: one for one in entries if (digest := _digest(one))}
    left = MOST

    def parents_of(one: Entry, above: tuple[str, ...]) -> list[Ancestor]:
        nonlocal left
        found = []
        for digest in _parents(one):
            # A card may name its own descendant.
            if digest in above or len(above) > GENERATIONS or left <= 0:
                continue
            left -= 1
            known = by_digest.get(digest)
            own = parents_of(known, (*above, digest)) if known else []
            found.append(
                Ancestor(digest, known.number if known else None, known.name if known else "", own)
            )
        return found

    return parents_of(entry, (_digest(entry),))


def children(entries: Sequence[Entry], entry: Entry) -> list[Entry]:
    """Return the entries that were trained from this one."""
    digest = _digest(entry)
    return [one for one in entries if digest and digest in _parents(one)]


def _digest(entry: Entry) -> str:
    return str(entry.card.get("digest", ""))


def _parents(entry: Entry) -> list[str]:
    match entry.card.get("parents"):
        case [*digests]:
            return [str(digest) for digest in digests]
    return []
