"""Figures of matplotlib, drawn without a display and written as PNG."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from league.atomic_file import replacing
from league.errors import LeagueError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, GRID = "#1d2733", "#e0e4e8"  # Colours of text, and of grid lines.


def figure(width: float, height: float) -> Figure:
    """Return an empty white figure of this size [inches]."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained", facecolor="white")


def strip(axes: Axes, *, keep: tuple[str, ...] = ()) -> None:
    """Remove tick marks and the lines around the axes but for those on the sides in `keep`."""
    axes.tick_params(colors=INK, length=0)
    for side, spine in axes.spines.items():
        spine.set_visible(side in keep)
        spine.set_color(GRID)


def save(drawn: Figure, path: Path, what: str, refusal: type[LeagueError], dpi: int = 110) -> None:
    """Write a figure as a PNG, whole or not at all; `refusal` is the error if it cannot be."""
    with replacing(path, what, refusal) as file:
        drawn.savefig(file, format="png", dpi=dpi)
