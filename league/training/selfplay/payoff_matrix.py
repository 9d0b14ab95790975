"""The win matrix: a policy, its past, its parent and a scripted driver against each other."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from statistics import fmean

from league.agents.driver import Driver
from league.atomic_file import replacing
from league.errors import PolicyError
from league.sim.config import CarConfig
from league.track.track import TrackSet
from league.training.selfplay import matches
from league.training.selfplay.matches import Score
from league.training.selfplay.pool import PARENT
from league.training.selfplay.settings import SelfPlayConfig

SCRIPTED = ("centerline",)
FINAL = "final"
"""What the trained driver is called: the weights of the run's `last.pt`."""


@dataclass(frozen=True)
class WinMatrix:
    """Who beats whom, from mirrored deterministic races."""

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
        """Who of the snapshots and the trained driver wins most; of equals the newest.

        What a learner can do comes and goes between snapshots, and the last one need not be the
        best of them. Scripted drivers, the parent and the other snapshots count a third each:
        among selves of like pace the slot decides, so their races alone tell little.
        """
        place_of = range(len(self.names))
        scripted = {place for place in place_of if self.names[place] in SCRIPTED}
        parent = {place for place in place_of if self.names[place] == PARENT}
        selves = set(place_of) - scripted - parent

        def merit(place: int) -> tuple[float, int]:
            rates = [
                fmean(rate for other in group if (rate := self.wins[place][other]) is not None)
                for group in (scripted, parent, selves)
                if group - {place}
            ]
            return round(fmean(rates or [0.0]), 6), place

        return self.names[max(selves, key=merit)]

    def past_of(self, name: str) -> dict[str, float]:
        """Return a self's win rate against each that is older than it, the parent included.

        Those that came after it are not its past: it cannot have forgotten them.
        """
        place = self.names.index(name)
        return {
            older: rate
            for older, rate in zip(self.names[:place], self.wins[place][:place], strict=True)
            if older not in SCRIPTED and rate is not None
        }

    def against(self, name: str) -> float | None:
        """Return the champion's win rate against a driver; None: itself, or who did not race."""
        if name not in self.names:
            return None
        return self.wins[self.names.index(self.champion)][self.names.index(name)]

    def write(self, path: Path) -> None:
        """Write it as JSON, with the figures that sum it up: the champion's, apart the last's."""
        told = {
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
        with replacing(path, "the win matrix", PolicyError) as file:
            file.write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")


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
) -> WinMatrix:
    """Race all pairs of drivers.

    Args:
        tracks: the courses.
        car: the cars.
        drivers: by name, in the order of the matrix.
        cfg: number and length of the races.
        seed: makes the races' seeds.
    """
    names, field = tuple(drivers), list(drivers.values())
    pairs = list(combinations(range(len(field)), 2))
    found = matches.meet(tracks, car, field, pairs, cfg.duel, races=cfg.matrix_races, seed=seed)
    wins: list[list[float | None]] = [[None] * len(field) for _ in field]
    scores = [Score() for _ in field]
    for (one, two), (first, second) in found.items():
        wins[one][two], wins[two][one] = first.win_rate, second.win_rate
        scores[one], scores[two] = scores[one] + first, scores[two] + second
    return WinMatrix(
        names=names,
        races=cfg.matrix_races,
        wins=tuple(tuple(row) for row in wins),
        contacts_per_km=tuple(round(score.contacts_per_km, 2) for score in scores),
        off_tracks_per_km=tuple(round(score.off_tracks_per_km, 2) for score in scores),
        clean_lap_s=tuple(score.clean_lap_s for score in scores),
    )
