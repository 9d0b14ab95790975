"""A cup: its qualifying and its bracket."""

from __future__ import annotations

from league.matchmaking import cups
from league.web.pages.seasons import frozen
from league.web.reader import Document, NotFoundError, Reader

TO_COME: Document = {"number": None, "state": None, "track": None, "runs": []}
"""A heat of a round that has not been drawn."""


def document(reader: Reader, number: int) -> Document:
    """Return a cup as far as it has come."""
    cup = next((one for one in reader.store.cups() if one.number == number), None)
    if cup is None:
        raise NotFoundError(f"This league has no cup {number}.")
    document = frozen(reader, cup)
    if document is None:
        entrants = {id: reader.entry_of(id) for id in cup.settings["entrants"]}
        document = cups.document(cup, cups.bracket(reader.store, cup), entrants)
    qualifying, *rounds = document["stages"]
    return {
        "cup": cup,
        "qualifying": qualifying,
        "rounds": _bracket(rounds),
        "order": document["order"],
    }


def _bracket(rounds: list[Document]) -> list[Document]:
    """Return all knock-out rounds, those to come too, with heats that feed one heat side by side.

    Each heat lists under `feeds` the numbers of the heats that its drivers come from.
    """
    if not rounds:
        return []
    sizes = [len(rounds[0]["heats"])]
    while sizes[-1] > 1:
        sizes.append(sizes[-1] // 2)
    shown = []
    for size in sizes:
        known = rounds[len(shown)]["heats"] if len(shown) < len(rounds) else []
        before = shown[-1]["heats"] if shown else []
        heats = [
            {**(known[index] if known else TO_COME), "feeds": [one["number"] for one in feeding]}
            for index, feeding in zip(_order(size), _pairs(before, size), strict=True)
        ]
        shown.append({"name": cups.stage_name(size), "heats": heats})
    return shown


def _order(size: int) -> list[int]:
    """Return the heats of a round from top to bottom, see cups: the first meets the last, ..."""
    if size == 1:
        return [0]
    return [index for one in _order(size // 2) for index in (one, size - 1 - one)]


def _pairs(heats: list[Document], size: int) -> list[list[Document]]:
    return [heats[2 * index : 2 * index + 2] for index in range(size)]
