"""The newest heats, and how many are in each state."""

from __future__ import annotations

from league.web.reader import Document, Reader

RECENT = 60
"""Newest heats that are listed."""


def document(reader: Reader) -> Document:
    """Return the newest heats, the last one first, and how many are in each state."""
    return {"heats": reader.listed(reader.newest(RECENT)), "counts": reader.store.counts()}
