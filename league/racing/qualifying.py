"""Qualifying: laps that each driver drives alone, and the grid that follows from them."""

from __future__ import annotations

import math
from collections.abc import Sequence

from league.race_spec import RaceSpec
from league.racing import race
from league.track.track import Track

LAPS = 2
"""Laps of a qualifying run: one from rest, and a flying one; the better one counts."""


def best_laps(spec: RaceSpec, track: Track) -> list[float]:
    """Return the best lap of each driver of a race alone on the track [s], infinite for none.

    All drive the same car, of the seed's variation, by the rules and physics of the race.

    Raises:
        LeagueError: as `race.run`.
    """
    alone = {
        "kind": "time_trial",
        "laps": LAPS,
        "format": "standing",
        "obstacles": 0,
        "max_time_s": 0.0,
    }
    jobs = [
        race.RaceJob(spec.model_copy(update={**alone, "entries": (entry,)}), track, record=False)
        for entry in spec.entries
    ]
    return [finished.result.order[0].best_lap_s or math.inf for finished in race.run_together(jobs)]


def line_up(spec: RaceSpec, laps: Sequence[float]) -> RaceSpec:
    """Return the spec with its entries by their laps: the fastest first, in a reverse grid last.

    Equal laps keep the order in which they are given.
    """
    sign = -1.0 if spec.format == "reverse" else 1.0
    order = sorted(range(len(laps)), key=lambda car: sign * laps[car])
    return spec.model_copy(update={"entries": tuple(spec.entries[car] for car in order)})
