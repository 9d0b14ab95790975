"""The payoff matrix: a policy, its past, its parent and a scripted driver race each other."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING

from league import figures
from league.agents.driver import Driver
from league.atomic_file import replacing
from league.errors import PolicyError
from league.figures import FAINT, INK
from league.sim.config import CarConfig
from league.track.track import TrackSet
from league.training.selfplay import matches
from league.training.selfplay.matches import Score
from league.training.selfplay.pool import PARENT
from league.training.selfplay.settings import SelfPlayConfig

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SCRIPTED = ("centerline",)
FINAL = "final"
"""Name of the trained driver, with the weights of the run's `last.pt`."""
GOAL, ALARM = 0.45, 0.30
"""Smallest win rate against the past that is the goal, and below which the past was forgotten."""
_COLOURS = {"its past": "#1f6f8b", "came after it": "#a9c9d4", "scripted": "#d9a35c"}


@dataclass(frozen=True)
class PayoffMatrix:
    """Win rates of all pairs, from mirrored deterministic races."""

    names: tuple[str, ...]
    """Drivers: scripted ones, then the parent and snapshots by age; the last is the trained one."""
    races: int
    """Races of each pair."""
    wins: tuple[tuple[float | None, ...], ...]
    """Win rate of the row's driver against the column's, 0 to 1; None on the diagonal."""
    contacts_per_km: tuple[float, ...]
    """Contacts each driver was to blame for, over all its races [1/km]."""
    off_tracks_per_km: tuple[float, ...]
    """How often each left the road, over all its races [1/km]."""
    clean_lap_s: tuple[float | None, ...]
    """Median flying lap of each without a mistake or a contact [s]; None: it drove none."""

    @property
    def past(self) -> dict[str, float]:
        """Win rate of the champion against each of its past selves, the parent included."""
        return self.past_of(self.champion)

    @property
    def smallest(self) -> float | None:
        """Smallest win rate of the champion against its past; None without a past."""
        return min(self.past.values(), default=None)

    @property
    def champion(self) -> str:
        """Which of the snapshots and the trained driver wins most; of equals the newest.

        Skill comes and goes between snapshots, so the last one need not be the best. Scripted
        drivers, the parent and the other snapshots count a third each: among selves of like pace
        the grid slot decides.
        """
        places = range(len(self.names))
        scripted = {place for place in places if self.names[place] in SCRIPTED}
        parent = {place for place in places if self.names[place] == PARENT}
        selves = set(places) - scripted - parent

        def merit(place: int) -> tuple[float, int]:
            rates = [
                fmean(rate for other in group if (rate := self.wins[place][other]) is not None)
                for group in (scripted, parent, selves)
                if group - {place}
            ]
            return round(fmean(rates or [0.0]), 6), place

        return self.names[max(selves, key=merit)]

    def past_of(self, name: str) -> dict[str, float]:
        """Return a self's win rate against each older one, the parent included."""
        place = self.names.index(name)
        return {
            older: rate
            for older, rate in zip(self.names[:place], self.wins[place][:place], strict=True)
            if older not in SCRIPTED and rate is not None
        }

    def against(self, name: str) -> float | None:
        """Return the champion's win rate against a driver; None: itself, or an absent one."""
        if name not in self.names:
            return None
        return self.wins[self.names.index(self.champion)][self.names.index(name)]

    def write(self, path: Path) -> None:
        """Write it as JSON, with summaries of the champion and of the last policy."""
        content = {
            "names": self.names,
            "races_of_each_pair": self.races,
            "win_rates": self.wins,
            "champion": self.champion,
            **_summary(self.past),
            FINAL: _summary(self.past_of(self.names[-1])),
            "contacts_per_km": self.contacts_per_km,
            "off_tracks_per_km": self.off_tracks_per_km,
            "clean_lap_s": self.clean_lap_s,
        }
        with replacing(path, "the payoff matrix", PolicyError) as file:
            file.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def _summary(past: Mapping[str, float]) -> dict[str, object]:
    return {
        "win_rates_against_the_past": past,
        "smallest_win_rate_against_the_past": min(past.values(), default=None),
    }


def measure(
    tracks: TrackSet,
    car: CarConfig,
    drivers: Mapping[str, Driver],
    cfg: SelfPlayConfig,
    *,
    seed: int = 0,
) -> PayoffMatrix:
    """Race all pairs of drivers, which are given by name in the order of the matrix."""
    names, field = tuple(drivers), list(drivers.values())
    pairs = list(combinations(range(len(field)), 2))
    results = matches.race_pairs(
        tracks, car, field, pairs, cfg.match, races=cfg.matrix_races, seed=seed
    )
    wins: list[list[float | None]] = [[None] * len(field) for _ in field]
    scores = [Score() for _ in field]
    for (one, two), (first, second) in results.items():
        wins[one][two], wins[two][one] = first.win_rate, second.win_rate
        scores[one], scores[two] = scores[one] + first, scores[two] + second
    return PayoffMatrix(
        names=names,
        races=cfg.matrix_races,
        wins=tuple(tuple(row) for row in wins),
        contacts_per_km=tuple(round(score.contacts_per_km, 2) for score in scores),
        off_tracks_per_km=tuple(round(score.off_tracks_per_km, 2) for score in scores),
        clean_lap_s=tuple(score.clean_lap_s for score in scores),
    )


def draw(matrix: PayoffMatrix, path: Path) -> None:
    """Write the matrix as a PNG, whole or not at all.

    Raises:
        PolicyError: it cannot be written.
    """
    size = max(len(matrix.names), 3)
    figure = figures.figure(7.6 + 0.72 * size, 2.4 + 0.5 * size)
    left, right = figure.subplots(1, 2, width_ratios=(0.72 * size + 1.0, 4.2))
    _draw_rates(left, matrix)
    _draw_champion(right, matrix)
    figure.suptitle(_title(matrix), color=INK, fontsize=12, fontweight="bold")
    figures.save(figure, path, "the plot of the payoff matrix", PolicyError)


def _title(matrix: PayoffMatrix) -> str:
    smallest, count = matrix.smallest, len(matrix.past)
    selves = "1 self" if count == 1 else f"{count} selves"
    rate = f"smallest win rate against its past, {selves}: {smallest:.2f}" if count else "no past"
    return (
        f"Self-play: the champion, best.pt, is “{_label(matrix.champion)}”\n"
        f"{rate}; {matrix.races} mirrored races of each pair"
    )


def _draw_rates(axes: Axes, matrix: PayoffMatrix) -> None:
    from matplotlib.patches import Rectangle

    names = [_label(name) for name in matrix.names]
    values = [[float("nan") if one is None else one for one in row] for row in matrix.wins]
    axes.set_facecolor("#eef1f3")
    axes.imshow(values, cmap="RdYlBu", vmin=0.0, vmax=1.0, aspect="auto")
    for row, rates in enumerate(matrix.wins):
        for column, rate in enumerate(rates):
            if rate is not None:
                ink = "white" if rate < 0.15 or rate > 0.85 else INK
                axes.text(
                    column, row, f"{rate:.2f}", ha="center", va="center", color=ink, fontsize=9
                )
    champion = matrix.names.index(matrix.champion)
    frame = Rectangle(
        (-0.5, champion - 0.5), len(names), 1.0, fill=False, ec=INK, lw=2.5, clip_on=False
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
    figures.strip(axes)
    axes.tick_params(labelsize=9)
    for label in (axes.get_xticklabels()[champion], axes.get_yticklabels()[champion]):
        label.set_fontweight("bold")
    axes.set_title("Win rate of the row against the column", color=INK, fontsize=11)
    axes.set_ylabel("driver   clean lap · contacts to blame for", color=FAINT, fontsize=9)


def _draw_champion(axes: Axes, matrix: PayoffMatrix) -> None:
    """Draw the champion's win rate against each driver, next to that driver's row."""
    champion = matrix.names.index(matrix.champion)
    last = {} if matrix.champion == FINAL else matrix.past_of(FINAL)
    axes.axvspan(0.0, ALARM, color="#d9534f", alpha=0.08, lw=0)
    axes.axvline(0.5, color=FAINT, lw=0.8)
    axes.axvline(GOAL, color=FAINT, lw=0.9, ls="--")
    for kind, colour in _COLOURS.items():
        places = [place for place in range(len(matrix.names)) if _kind(matrix, place) == kind]
        rates = [matrix.wins[champion][place] or 0.0 for place in places]
        if places:
            axes.barh(places, rates, height=0.55, color=colour, label=kind)
    for place, name in enumerate(matrix.names):
        rate, mark = matrix.against(name), last.get(name, -1.0)
        if rate is None:
            shift = 0.5 if 0.0 <= mark < 0.45 else 0.0
            axes.text(shift + 0.015, place, "★ the champion", color=INK, fontsize=9, va="center")
        else:
            end = mark + 0.01 if rate - 0.02 < mark < rate + 0.12 else rate
            axes.text(end + 0.015, place, f"{rate:.2f}", color=INK, fontsize=9, va="center")
    if last:
        places = [matrix.names.index(name) for name in last]
        axes.plot(list(last.values()), places, ls="", marker="D", ms=5, mfc="white", mec=INK,
                  clip_on=False, label="last.pt (final) against its past")  # fmt: skip
    ticks = {0.0: "0", ALARM / 2: "forgotten", ALARM: ".30", GOAL: "goal .45", 0.75: ".75", 1: "1"}
    axes.set_xticks(list(ticks), list(ticks.values()))
    figures.strip(axes, keep=("left",))
    axes.tick_params(axis="x", pad=6, labelsize=8, labelcolor=FAINT)
    axes.set_yticks([])
    axes.set_xlim(0.0, 1.13)
    axes.set_ylim(len(matrix.names) - 0.5, -0.5)
    axes.set_title("Win rate of the champion against the row", color=INK, fontsize=11)
    if len(matrix.names) > 1:
        axes.legend(
            loc="upper center", bbox_to_anchor=(0.45, -0.12), ncols=2, frameon=False, fontsize=8
        )


def _kind(matrix: PayoffMatrix, place: int) -> str:
    """Return a driver's relation to the champion; empty for itself."""
    champion = matrix.names.index(matrix.champion)
    if matrix.names[place] in SCRIPTED:
        return "scripted"
    return "" if place == champion else "its past" if place < champion else "came after it"


def _label(name: str) -> str:
    return f"after {int(name):,}" if name.isdigit() else name


def _lap(lap_s: float | None) -> str:
    return "no clean lap" if lap_s is None else f"{lap_s:.2f} s"
