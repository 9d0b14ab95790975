"""Long lists, a page of them at a time."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from urllib.parse import urlencode

from league.web.reader import Document, NotFoundError

PER_PAGE = 100
"""Lines on one page."""


@dataclass(frozen=True)
class Paging:
    """Which part of a list a page shows."""

    page: int
    """Number of the page, from 1."""
    pages: int
    """How many there are."""
    pager: list[tuple[str, str]]
    """Numbers and addresses of this page and some others; this one's address is empty."""
    first: int
    """Index of the page's first line."""
    end: int
    """Index behind its last one."""

    @property
    def document(self) -> Document:
        """The part of a page's data that tells which page it is."""
        return {name: value for name, value in asdict(self).items() if name.startswith("page")}


def paging(
    lines: int, page: str, what: str, path: str, asked: Mapping[str, str], per_page: int = 0
) -> Paging:
    """Return where a page of a list is.

    Args:
        lines: how many the list has.
        page: number that was asked for, from 1; empty for the first one.
        what: the list, in plural, for the error.
        path: of its pages.
        asked: other parameters of the request.
        per_page: lines on one page; by default `PER_PAGE`.

    Raises:
        NotFoundError: there is no such page.
    """
    per_page = per_page or PER_PAGE
    pages = math.ceil(lines / per_page) or 1
    if page and page not in map(str, range(1, pages + 1)):
        raise NotFoundError(f"The {what} have the pages 1 to {pages}.")
    number = int(page or 1)
    first = (number - 1) * per_page
    pager: list[tuple[str, str]] = []
    for other in sorted({1, pages, *range(max(1, number - 2), min(pages, number + 2) + 1)}):
        there = address(path, {**asked, "page": str(other)} if other > 1 else asked)
        pager.append((str(other), "" if other == number else there))
    return Paging(number, pages, pager, first, min(first + per_page, lines))


def address(path: str, asked: Mapping[str, str]) -> str:
    """Return the address of a page with some parameters."""
    return f"{path}?{urlencode(asked)}" if asked else path
