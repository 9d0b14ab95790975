"""Safety ratings: incident points for each 100 corners over an entry's last races."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from league.matchmaking.store import Drives, Store
from league.track import files
from league.track.corners import corners

RACES = 50
"""Newest rated races of an entry that count."""
BEST = 5.0
"""Safety rating of an entry without incidents."""
HALF = 20.0
"""Incident points for each 100 corners that halve it."""
ENOUGH_CORNERS = 100.0
"""Corners from which on a safety rating is more than a guess."""


@dataclass(frozen=True)
class Safety:
    """How safely an entry drives."""

    rating: float
    """From 0 to 5, the safest: 5 / (1 + incidents / 20)."""
    incidents: float
    """Incident points for each 100 corners."""
    points: int
    """Incident points: 1 for leaving the track and for a light contact, 4 for a crash."""
    corners: float
    """Corners driven, parts of a lap in proportion."""
    races: int
    """Races that count, 50 at most."""
    heats: tuple[int, ...]
    """Heats with the most incident points in them, five at most."""

    @property
    def known(self) -> bool:
        """Whether enough corners were driven for the rating to mean something."""
        return self.corners >= ENOUGH_CORNERS


def of(store: Store, ruleset: str | None = None, *, before: int | None = None) -> dict[int, Safety]:
    """Return the safety rating of each entry that raced under a ruleset, by its number.

    Seasons make no difference: driving is as safe as it was in the last races.

    Args:
        store: the league.
        ruleset: hash; by default the present one.
        before: only heats with a smaller number count.
    """
    ruleset = ruleset or store.settings.ruleset.hash
    drives = store.drives(ruleset)
    tracks = store.rulesets()[ruleset].tracks
    known = (drives.track < len(tracks)) & (drives.distance_cm > 0)
    if before is not None:
        known &= drives.heat < before
    per_cm = np.zeros(len(tracks))
    for index in np.unique(drives.track[known]):
        track = files.load(tracks[index])
        per_cm[index] = corners(track) / track.length / 100
    return _rated(drives, per_cm, np.flatnonzero(known))


def _rated(drives: Drives, per_cm: np.ndarray, rows: np.ndarray) -> dict[int, Safety]:
    rows = rows[np.lexsort((-drives.half[rows], -drives.heat[rows], drives.entry[rows]))]
    entries, first = np.unique(drives.entry[rows], return_index=True)
    ends = np.append(first[1:], len(rows))[: len(first)]
    found = {}
    for entry, begin, end in zip(entries.tolist(), first, ends, strict=True):
        own = rows[begin : min(end, begin + RACES)]
        turned = float((drives.distance_cm[own] * per_cm[drives.track[own]]).sum())
        points = int(drives.points[own].sum())
        incidents = 100 * points / turned if turned > 0 else 0.0
        worst = own[np.argsort(-drives.points[own], kind="stable")]
        heats = dict.fromkeys(drives.heat[worst[drives.points[worst] > 0]].tolist())
        found[entry] = Safety(
            rating=BEST / (1 + incidents / HALF),
            incidents=incidents,
            points=points,
            corners=turned,
            races=len(own),
            heats=tuple(heats)[:5],
        )
    return found
