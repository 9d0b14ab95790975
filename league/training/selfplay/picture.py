"""The win matrix as a picture: who beats whom, and how the trained policy does against its past."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from league.errors import PolicyError
from league.training.selfplay.matrix import SCRIPTED, WinMatrix
from league.whole_file import replacing

if TYPE_CHECKING:
    from matplotlib.axes import Axes

GOAL, ALARM = 0.45, 0.30
"""Smallest win rate against the past that is wished for, and that says it was forgotten."""
_INK, _FAINT, _LINE = "#1d2733", "#8a94a0", "#1f6f8b"


def draw(matrix: WinMatrix, path: Path) -> None:
    """Write the picture, a PNG, whole or not at all.

    Raises:
        PolicyError: it cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    size = max(len(matrix.names), 4)
    figure = Figure(figsize=(6.2 + 1.1 * size, 2.2 + 0.62 * size), facecolor="white")
    FigureCanvasAgg(figure)
    figure.set_layout_engine("constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.25, 1.0))
    _heat(left, matrix)
    _line(right, matrix)
    smallest = matrix.smallest
    said = "no past" if smallest is None else f"smallest against the past {smallest:.2f}"
    title = f"Self-play: {said}; {matrix.races} mirrored races of each pair"
    figure.suptitle(title, color=_INK, fontsize=13, fontweight="bold")
    with replacing(path, "the picture of the win matrix", PolicyError) as file:
        figure.savefig(file, format="png", dpi=110)


def _heat(axes: Axes, matrix: WinMatrix) -> None:
    names = [_label(name) for name in matrix.names]
    values = [[float("nan") if one is None else one for one in row] for row in matrix.wins]
    axes.imshow(values, cmap="RdYlBu", vmin=0.0, vmax=1.0)
    for row, rates in enumerate(matrix.wins):
        for column, rate in enumerate(rates):
            if rate is not None:
                ink = "white" if rate < 0.15 or rate > 0.85 else _INK
                axes.text(
                    column, row, f"{rate:.2f}", ha="center", va="center", color=ink, fontsize=9
                )
    axes.set_xticks(range(len(names)), names, rotation=45, ha="right", fontsize=9)
    rows = [
        f"{name}   {_lap(lap)} · {contacts:.0f}/km"
        for name, lap, contacts in zip(
            names, matrix.clean_lap_s, matrix.contacts_per_km, strict=True
        )
    ]
    axes.set_yticks(range(len(rows)), rows, fontsize=9)
    axes.set_title("Win rate of the row against the column", color=_INK, fontsize=11)
    axes.set_ylabel("driver   clean lap · contacts to blame for", color=_FAINT, fontsize=9)
    for side in axes.spines.values():
        side.set_visible(False)
    axes.tick_params(length=0)


def _line(axes: Axes, matrix: WinMatrix) -> None:
    past = matrix.past
    names, rates = [_label(name) for name in past], list(past.values())
    axes.axhspan(0.0, ALARM, color="#d9534f", alpha=0.08, lw=0)
    axes.axhline(0.5, color=_FAINT, lw=0.8)
    axes.axhline(GOAL, color=_FAINT, lw=0.8, ls="--")
    axes.text(1.0, GOAL - 0.01, f" goal {GOAL:.2f}", color=_FAINT, fontsize=8, va="top",
              ha="right", transform=axes.get_yaxis_transform())  # fmt: skip
    axes.text(1.0, ALARM - 0.01, " forgotten", color="#b0413e", fontsize=8, va="top",
              ha="right", transform=axes.get_yaxis_transform())  # fmt: skip
    places = range(len(rates))
    axes.plot(places, rates, color=_LINE, lw=2, marker="o", ms=6)
    for place, rate in zip(places, rates, strict=True):
        above = rate < 0.9
        axes.annotate(
            f"{rate:.2f}", (place, rate), (0, 8 if above else -8), textcoords="offset points",
            ha="center", va="bottom" if above else "top", color=_INK, fontsize=9,
            bbox={"boxstyle": "round,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.85},
        )  # fmt: skip
    for name, rate in zip(matrix.names, matrix.wins[-1], strict=True):
        if name in SCRIPTED and rate is not None:
            axes.axhline(rate, color="#c77f1c", lw=1.2, ls=":")
            axes.text(0.0, rate - 0.012, f" {name} {rate:.2f}", color="#c77f1c", fontsize=8,
                      va="top", transform=axes.get_yaxis_transform())  # fmt: skip
    axes.set_xticks(list(places), names, rotation=45, ha="right", fontsize=9)
    axes.set_xlim(-0.5, max(len(rates) - 0.5, 0.5))
    axes.set_ylim(0.0, 1.03)
    axes.set_title("Win rate of the trained policy against its past", color=_INK, fontsize=11)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _label(name: str) -> str:
    return f"after {int(name):,}" if name.isdigit() else name


def _lap(lap_s: float | None) -> str:
    return "no clean lap" if lap_s is None else f"{lap_s:.2f} s"
