"""Safety ratings: incident points for each 100 corners over an entry's last races."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from league.matchmaking.store import Drives, Store
from league.track import files

RACES = 50  # newest rated races of an entry that count
BEST = 5.0  # safety rating of an entry without incidents
HALF = 20.0  # incident points for each 100 corners that halve it
ENOUGH_CORNERS = 100.0  # corners from which on a safety rating is more than a guess


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
    """Return the safety rating of each entry that raced, by its number.

    By default under the present ruleset (its hash). Seasons make no difference: driving is as safe
    as it was in the last races. If given, only heats numbered below `before` count.
    """
    ruleset = ruleset or store.settings.ruleset.hash
    drives = store.drives(ruleset)
    if before is not None:
        drives = drives.where(drives.heat < before)
    return rated(drives, store.rulesets()[ruleset].tracks).by_entry


@dataclass(frozen=True)
class Record:
    """Safety ratings, and what they are made of, so that later races can be added."""

    by_entry: dict[int, Safety]  # of each entry that raced, by its number
    drives: Drives  # those that count, entry by entry, the newest first


def rated(drives: Drives, tracks: Sequence[str], earlier: Record | None = None) -> Record:
    """Return the safety ratings by drives under one ruleset, and by what came before them."""
    later = drives.where((drives.track < len(tracks)) & (drives.distance_cm > 0))
    if earlier is None:
        return _rated(later, tracks)
    # Only entries that raced since then change.
    theirs = np.isin(earlier.drives.entry, np.unique(later.entry))
    new = _rated(earlier.drives.where(theirs).joined(later), tracks)
    return Record(
        {**earlier.by_entry, **new.by_entry}, earlier.drives.where(~theirs).joined(new.drives)
    )


def _rated(drives: Drives, tracks: Sequence[str]) -> Record:
    drives = drives.where(np.lexsort((-drives.half, -drives.heat, drives.entry)))
    entries, first, counts = np.unique(drives.entry, return_index=True, return_counts=True)
    newest = np.arange(len(drives.entry)) - np.repeat(first, counts) < RACES
    drives, ends = drives.where(newest), np.cumsum(np.minimum(counts, RACES))
    per_cm = np.zeros(len(tracks))
    for index in map(int, np.unique(drives.track)):
        track = files.load(tracks[index])
        per_cm[index] = track.num_corners / track.length / 100
    turned, found = drives.distance_cm * per_cm[drives.track], {}
    for entry, begin, end in zip(entries.tolist(), np.append(0, ends), ends, strict=False):
        own = slice(begin, end)
        found[entry] = _safety(drives.heat[own], drives.points[own], float(turned[own].sum()))
    return Record(found, drives)


def _safety(heats: np.ndarray, points: np.ndarray, turned: float) -> Safety:
    """Return the rating of an entry by its newest races, (races,), in which it turned corners."""
    total = int(points.sum())
    incidents = 100 * total / turned if turned > 0 else 0.0
    worst = np.argsort(-points, kind="stable")[: np.count_nonzero(points)]
    return Safety(
        rating=BEST / (1 + incidents / HALF),
        incidents=incidents,
        points=total,
        corners=turned,
        races=len(points),
        heats=tuple(dict.fromkeys(heats[worst].tolist()))[:5],
    )
