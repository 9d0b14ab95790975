"""The win matrix as a picture: who beats whom, and how the champion does against each of them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from league.atomic_file import replacing
from league.errors import PolicyError
from league.training.selfplay.payoff_matrix import FINAL, SCRIPTED, WinMatrix

if TYPE_CHECKING:
    from matplotlib.axes import Axes

GOAL, ALARM = 0.45, 0.30
"""Smallest win rate against the past that is wished for, and that says it was forgotten."""
_INK, _FAINT, _ROAD = "#1d2733", "#8a94a0", "#eef1f3"
_COLOURS = {"its past": "#1f6f8b", "came after it": "#a9c9d4", "scripted": "#d9a35c"}


def draw(matrix: WinMatrix, path: Path) -> None:
    """Write the picture, a PNG, whole or not at all.

    Raises:
        PolicyError: it cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    size = max(len(matrix.names), 3)
    figure = Figure(figsize=(7.6 + 0.72 * size, 2.4 + 0.5 * size), facecolor="white")
    FigureCanvasAgg(figure)
    figure.set_layout_engine("constrained")
    left, right = figure.subplots(1, 2, width_ratios=(0.72 * size + 1.0, 4.2))
    _heat(left, matrix)
    _bars(right, matrix)
    figure.suptitle(_title(matrix), color=_INK, fontsize=12, fontweight="bold")
    with replacing(path, "the picture of the win matrix", PolicyError) as file:
        figure.savefig(file, format="png", dpi=110)


def _title(matrix: WinMatrix) -> str:
    smallest, count = matrix.smallest, len(matrix.past)
    selves = "1 self" if count == 1 else f"{count} selves"
    rate = f"smallest win rate against its past, {selves}: {smallest:.2f}" if count else "no past"
    return (
        f"Self-play: the champion, best.pt, is “{_label(matrix.champion)}”\n"
        f"{rate}; {matrix.races} mirrored races of each pair"
    )


def _heat(axes: Axes, matrix: WinMatrix) -> None:
    from matplotlib.patches import Rectangle

    names = [_label(name) for name in matrix.names]
    values = [[float("nan") if one is None else one for one in row] for row in matrix.wins]
    axes.set_facecolor(_ROAD)
    axes.imshow(values, cmap="RdYlBu", vmin=0.0, vmax=1.0, aspect="auto")
    for row, rates in enumerate(matrix.wins):
        for column, rate in enumerate(rates):
            if rate is not None:
                ink = "white" if rate < 0.15 or rate > 0.85 else _INK
                axes.text(
                    column, row, f"{rate:.2f}", ha="center", va="center", color=ink, fontsize=9
                )
    champion = matrix.names.index(matrix.champion)
    frame = Rectangle(
        (-0.5, champion - 0.5), len(names), 1.0, fill=False, ec=_INK, lw=2.5, clip_on=False
    )
    axes.add_patch(frame)
    rows = [
        f"{name}   {_lap(lap)} · {contacts:.0f}/km"
        for name, lap, contacts in zip(
            names, matrix.clean_lap_s, matrix.contacts_per_km, strict=True
        )
    ]
    rows[champion] = f"★ {rows[champion]}"
    axes.set_xticks(range(len(names)), names, rotation=45, ha="right", rotation_mode="anchor")
    axes.set_yticks(range(len(rows)), rows)
    axes.tick_params(length=0, labelsize=9)
    for label in (axes.get_xticklabels()[champion], axes.get_yticklabels()[champion]):
        label.set_fontweight("bold")
    axes.set_title("Win rate of the row against the column", color=_INK, fontsize=11)
    axes.set_ylabel("driver   clean lap · contacts to blame for", color=_FAINT, fontsize=9)
    for side in axes.spines.values():
        side.set_visible(False)


def _bars(axes: Axes, matrix: WinMatrix) -> None:
    """Draw the champion's win rate against each driver, beside that driver's row."""
    champion = matrix.names.index(matrix.champion)
    last = {} if matrix.champion == FINAL else matrix.past_of(FINAL)
    axes.axvspan(0.0, ALARM, color="#d9534f", alpha=0.08, lw=0)
    axes.axvline(0.5, color=_FAINT, lw=0.8)
    axes.axvline(GOAL, color=_FAINT, lw=0.9, ls="--")
    for kind, colour in _COLOURS.items():
        found = [place for place in range(len(matrix.names)) if _kind(matrix, place) == kind]
        rates = [matrix.wins[champion][place] or 0.0 for place in found]
        if found:
            axes.barh(found, rates, height=0.55, color=colour, label=kind)
    for place, name in enumerate(matrix.names):
        rate, mark = matrix.against(name), last.get(name, -1.0)
        if rate is None:
            aside = 0.5 if 0.0 <= mark < 0.45 else 0.0
            axes.text(aside + 0.015, place, "★ the champion", color=_INK, fontsize=9, va="center")
        else:
            end = mark + 0.01 if rate - 0.02 < mark < rate + 0.12 else rate
            axes.text(end + 0.015, place, f"{rate:.2f}", color=_INK, fontsize=9, va="center")
    if last:
        places = [matrix.names.index(name) for name in last]
        axes.plot(list(last.values()), places, ls="", marker="D", ms=5, mfc="white", mec=_INK,
                  clip_on=False, label="last.pt (final) against its past")  # fmt: skip
    ticks = {0.0: "0", ALARM / 2: "forgotten", ALARM: ".30", GOAL: "goal .45", 0.75: ".75", 1: "1"}
    axes.set_xticks(list(ticks), list(ticks.values()))
    axes.tick_params(axis="x", length=0, pad=6, labelsize=8, labelcolor=_FAINT)
    axes.set_yticks([])
    axes.set_xlim(0.0, 1.13)
    axes.set_ylim(len(matrix.names) - 0.5, -0.5)
    axes.set_title("Win rate of the champion against the row", color=_INK, fontsize=11)
    if len(matrix.names) > 1:
        axes.legend(
            loc="upper center", bbox_to_anchor=(0.45, -0.12), ncols=2, frameon=False, fontsize=8
        )
    for side in ("top", "right", "bottom"):
        axes.spines[side].set_visible(False)


def _kind(matrix: WinMatrix, place: int) -> str:
    """Return what a driver is to the champion; empty for itself."""
    champion = matrix.names.index(matrix.champion)
    if matrix.names[place] in SCRIPTED:
        return "scripted"
    return "" if place == champion else "its past" if place < champion else "came after it"


def _label(name: str) -> str:
    return f"after {int(name):,}" if name.isdigit() else name


def _lap(lap_s: float | None) -> str:
    return "no clean lap" if lap_s is None else f"{lap_s:.2f} s"
