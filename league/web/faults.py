"""What each car did wrong on each lap of a race, and what it cost."""

from __future__ import annotations

from dataclasses import dataclass, field

from league.race_spec import Event, RaceResult

WORDS = {
    "off_track": "off",
    "crash": "contact",
    "touch": "light contact",
    "forced_off": "pushed off",
    "obstacle_contact": "obstacle",
    "wall_contact": "wall",
    "immobilised": "stuck",
    "reversed": "backwards",
}
"""Kinds of events that are the car's own fault, in the words of the page."""
UNPENALISED = ("touch", "wall_contact")
"""Kinds of which the value is no penalty."""


@dataclass
class LapFaults:
    """The faults of one car on one lap."""

    counts: dict[str, int] = field(default_factory=dict)
    """How often, by the page's word."""
    penalty_s: float = 0.0
    """Seconds of penalty that they cost."""


def by_lap(result: RaceResult) -> list[list[LapFaults]]:
    """Return the faults of each car, by grid slot, on each of its laps.

    The lap that a car was on when the race ended is the last one, where it did not finish.
    """
    cars = sorted(result.order, key=lambda row: row.car)
    found = [[LapFaults() for _ in range(row.laps + (not row.finished))] for row in cars]
    laps, steps = [0] * len(cars), dict[tuple[int, float], float]()
    for event in result.events:
        car = event.car
        laps[car] += event.kind == "lap"
        if event.kind in WORDS and laps[car] < len(found[car]):
            _add(found[car][laps[car]], event, steps)
    return found


def _add(lap: LapFaults, event: Event, steps: dict[tuple[int, float], float]) -> None:
    """Count a fault; faults of one step share its penalty, which is kept in `steps`."""
    word = WORDS[event.kind]
    lap.counts[word] = lap.counts.get(word, 0) + 1
    if event.kind not in UNPENALISED and event.value:
        step, paid_s = (event.car, event.time_s), steps.get((event.car, event.time_s), 0.0)
        lap.penalty_s += max(event.value - paid_s, 0.0)
        steps[step] = max(event.value, paid_s)
