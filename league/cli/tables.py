"""What the commands print with: tables and progress bars, all loaded late."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress
    from rich.table import Table


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


def is_narrow() -> bool:
    """Return whether less than 80 columns are there: then tables leave out what is least needed."""
    return console().width < 80


def table(title: str, *columns: str) -> Table:
    """Return an empty table: columns of words are set to the left and wrap, numbers never do."""
    from rich import box
    from rich.table import Table

    table = Table(
        title=spelled(title),
        title_justify="left",
        title_style="bold",
        header_style="dim",
        box=box.SIMPLE_HEAD,
        pad_edge=False,
        padding=(0, 0) if is_narrow() else (0, 1),
    )
    for number, column in enumerate(columns):
        if number < 2 or column in ("title", "driven", "how it drives"):
            table.add_column(column, overflow="fold")
        else:
            table.add_column(column, justify="right", no_wrap=True)
    return table


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


def counted(number: int, noun: str) -> str:
    """Return a number with its noun, in the plural unless it is 1; 0 is "no"."""
    ending = "" if number == 1 else "es" if noun.endswith("ch") else "s"
    return f"{number or 'no'} {noun}{ending}"
