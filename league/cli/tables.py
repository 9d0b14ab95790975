"""What the commands print with: tables and progress bars, all loaded late."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress
    from rich.table import Table

WORDS = ("title", "driven", "how it drives", "owner", "winner", "grid", "scopes")
"""Heads of columns of words, whichever place they have."""
NAME_WIDTH = 24  # Characters of a name in a line, where there is no room for whole ones.


def spelled(text: str) -> str:
    """Return text with signs that cannot be printed spelled out; lines stay lines."""
    lines = text.splitlines()
    return "\n".join(
        "".join(one if one.isprintable() else repr(one)[1:-1] for one in line) for line in lines
    )


def console(*, stderr: bool = False) -> Console:
    """Return where tables are printed: strangers' names stand in them, so text is text.

    Rich would read `[/x]` as markup, `:car:` as a picture, and numbers as something to colour.
    """
    from rich.console import Console

    return Console(stderr=stderr, markup=False, emoji=False, highlight=False)


def fitted(
    title: str, columns: Sequence[str], rows: Iterable[Sequence[object]], spare: Sequence[str] = ()
) -> Table:
    """Return a table that fits the terminal: names of 24 characters are whole, and no text is cut.

    The first two columns and those in WORDS are set to the left and wrap, others, such as numbers,
    never do. Where there is no room `spare` ones are left out, the least needed one first, and
    named in a line below.
    """
    kept, width = [tuple(map(str, row)) for row in rows], console().width
    drawn = _drawn(title, columns, kept, 1)
    if _width(drawn) <= width:
        return drawn
    heads, cells, left_out = columns, kept, 0
    while left_out < len(spare) and _width(_drawn(title, heads, cells, 0, NAME_WIDTH)) > width:
        left_out += 1
        shown = [k for k, one in enumerate(columns) if one not in spare[:left_out]]
        heads, cells = [columns[k] for k in shown], [[row[k] for k in shown] for row in kept]
    drawn = _drawn(title, heads, cells, 0)
    if left_out:
        drawn.caption = f"In a wider terminal also: {', '.join(spare[:left_out])}"
    return drawn


def table(
    title: str, columns: Sequence[str], rows: Iterable[Sequence[object]], *spare: str
) -> None:
    """Print a table that fits the terminal, see `fitted`."""
    console().print(fitted(title, columns, rows, spare))


def _width(drawn: Table) -> int:
    """Return how many columns of the terminal a table would like."""
    room = console()
    return room.measure(drawn, options=room.options.update(max_width=100_000)).maximum


def _drawn(
    title: str,
    columns: Sequence[str],
    rows: Iterable[Sequence[str]],
    padding: int,
    widest: int | None = None,
) -> Table:
    from rich import box
    from rich.table import Table

    drawn = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, padding), header_style="dim")
    drawn.title, drawn.title_justify, drawn.title_style = spelled(title), "left", "bold"
    drawn.caption_justify, drawn.caption_style = "left", "dim"
    for number, column in enumerate(columns):
        if number < 2 or column in WORDS:
            drawn.add_column(column, overflow="fold", max_width=widest)
        else:
            drawn.add_column(column, justify="right", no_wrap=True)
    for row in rows:
        drawn.add_row(*row)
    return drawn


def progress(disable: bool = False) -> Progress:
    """Return a progress bar on stderr that goes when it is done."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    return Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %", markup=False),
        TimeElapsedColumn(),
        console=console(stderr=True),
        transient=True,
        disable=disable,
    )
