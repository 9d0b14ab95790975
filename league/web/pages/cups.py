"""A cup: its qualifying and its bracket."""

from __future__ import annotations

from league.matchmaking import cups
from league.web.pages.seasons import frozen
from league.web.reader import Document, NotFoundError, Reader


def document(reader: Reader, number: int) -> Document:
    """Return a cup as far as it has come."""
    cup = next((one for one in reader.store.cups() if one.number == number), None)
    if cup is None:
        raise NotFoundError(f"This league has no cup {number}.")
    document = frozen(reader, "cup", number)
    if document is None:
        names = {entry.id: entry for entry in reader.store.entries()}
        document = cups.document(cup, cups.bracket(reader.store, cup), names)
    qualifying, *rounds = document["stages"]
    return {
        "cup": cup,
        "qualifying": qualifying,
        "rounds": rounds,
        "order": document["order"],
    }
