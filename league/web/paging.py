"""Long lists, a page of them at a time."""

from __future__ import annotations

import math
from collections.abc import Mapping
from urllib.parse import urlencode

from league.web.reader import Document, NotFoundError

PER_PAGE = 100
"""Lines on one page."""


def paging(
    lines: int, page: str, what: str, path: str, asked: Mapping[str, str], per_page: int = 0
) -> tuple[slice, Document]:
    """Return which lines of a list a page shows, and what its data tells of that.

    That is its number, how many pages there are, and numbers and addresses of this and some others.

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
    pager: list[tuple[str, str]] = []
    for other in sorted({1, pages, *range(max(1, number - 2), min(pages, number + 2) + 1)}):
        there = address(path, {**asked, "page": str(other)} if other > 1 else asked)
        pager.append((str(other), "" if other == number else there))
    lines_shown = slice((number - 1) * per_page, number * per_page)
    return lines_shown, {"page": number, "pages": pages, "pager": pager}


def address(path: str, asked: Mapping[str, str]) -> str:
    """Return the address of a page with some parameters."""
    return f"{path}?{urlencode(asked)}" if asked else path
