"""What the commands print with: tables, times and progress bars, all loaded late."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress
    from rich.table import Table


def clock(seconds: float) -> str:
    """Return a time as people read it on a timing screen: m:ss.mmm."""
    minutes, rest = divmod(round(seconds * 1000), 60_000)
    return f"{minutes}:{rest / 1000:06.3f}"


def console() -> Console:
    """Return where tables are printed."""
    from rich.console import Console

    return Console()


def table(title: str, *columns: str) -> Table:
    """Return an empty table; its first two columns, and those of words, are set to the left."""
    from rich import box
    from rich.table import Table

    table = Table(
        title=title,
        title_justify="left",
        title_style="bold",
        header_style="dim",
        box=box.SIMPLE_HEAD,
        pad_edge=False,
    )
    for number, column in enumerate(columns):
        left = number < 2 or column in ("title", "driven", "how it drives")
        sentences = column == "how it drives"
        table.add_column(column, justify="left" if left else "right", no_wrap=not sentences)
    return table


def progress(disable: bool = False) -> Progress:
    """Return a progress bar on stderr that goes when it is done."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
        console=Console(stderr=True),
        transient=True,
        disable=disable,
    )
