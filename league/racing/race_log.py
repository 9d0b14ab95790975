"""The log of a race: events and laps by the referee's verdicts, and the classification."""

from collections.abc import Callable

import numpy as np

from league.race_spec import CarResult, Event, EventKind, RaceResult, RaceSpec
from league.sim.records import NOBODY, World, members

_COUNTS = (
    *("laps", "off_tracks", "crashes", "touches", "contacts_taken", "immobilised", "reversed"),
    "overtakes",
)
"""Counts of a car that the classification has as they are."""


class RaceLog:
    """The events of a race, and each car's laps, as they happen."""

    def __init__(
        self, step_dt: float, num_cars: int, listen: Callable[[Event], None] | None = None
    ) -> None:
        """Log the start; `listen` is called with each event."""
        self.step_dt, self.num_cars, self.listen = step_dt, num_cars, listen
        self.steps = 0
        self.events: list[Event] = []
        self.laps: list[list[float]] = [[] for _ in range(num_cars)]
        self.penalties = [0.0] * num_cars
        self.add("start", 0)

    def add(
        self, kind: EventKind, car: int, other: int | None = None, value: float | None = None
    ) -> None:
        """Log an event at the current time."""
        time_s = round(self.steps * self.step_dt, 4)
        self.events.append(Event(time_s=time_s, kind=kind, car=car, other=other, value=value))
        if self.listen is not None:
            self.listen(self.events[-1])

    def note(self, verdicts: np.ndarray, scraped: np.ndarray, world: World) -> None:
        """Log the referee's verdicts on a step of one race.

        Args:
            verdicts: VERDICT records (num_cars,).
            scraped: which cars came to the wall in this step, bool (num_cars,).
            world: the race after the step, a batch of one.
        """
        for car, (seen, now) in enumerate(zip(verdicts, world.cars[0], strict=True)):
            if seen["lap"]:
                self.laps[car].append(round(float(now["last_lap_s"]), 4))
                self.add("lap", car, value=self.laps[car][-1])
            if seen["finished"]:
                self.add("finish", car, value=round(float(now["finish_s"]), 4))
            self._note_mistakes(seen, now, verdicts, car)
            for other in np.flatnonzero(members(seen["overtook"], self.num_cars)).tolist():
                self.add("overtake", car, other=other)
            if seen["was_hit"]:
                self.add("contact", car)
            if scraped[car]:
                self.add("wall_contact", car)
        if verdicts[0]["lead_changed"]:
            self.add("lead_change", int(world.worlds[0]["leader"]))

    def _note_mistakes(self, seen: np.void, now: np.void, verdicts: np.ndarray, car: int) -> None:
        penalty = float(seen["penalty_s"])
        self.penalties[car] += penalty
        kinds: tuple[EventKind, ...] = ("off_track", "immobilised", "reversed")
        for kind in kinds:
            if seen[kind]:
                self.add(kind, car, value=round(penalty, 4))
        if seen["crashed"]:
            car_hit, thing = int(seen["crashed_car"]), int(seen["crashed_obstacle"])
            if car_hit != NOBODY:
                self.add("crash", car, other=car_hit, value=round(penalty, 4))
            if thing != NOBODY:
                self.add("obstacle_contact", car, other=thing, value=round(penalty, 4))
        if seen["touched"]:
            touching = np.flatnonzero(members(now["touching_cars"], self.num_cars))
            hit = [other for other in touching.tolist() if verdicts[other]["was_hit"]]
            closing = round(float(seen["closing_speed"]), 4)
            self.add("touch", car, other=hit[0] if hit else None, value=closing)
        if seen["forced_off"]:
            pusher = int(now["pushed_by"])
            imposed = float(verdicts[pusher]["penalty_s"])
            self.add("forced_off", pusher, other=car, value=round(imposed, 4))
        if seen["released"]:
            self.add("put_back", car)


def classify(spec: RaceSpec, world: World, log: RaceLog) -> RaceResult:
    """Return the classification of a race that is over, or as if it were."""
    race_s = log.steps * log.step_dt
    unplaced = []
    for car, (entry, now) in enumerate(zip(spec.entries, world.cars[0], strict=True)):
        finish_s = float(now["finish_s"])
        finished = finish_s != float("inf")
        unplaced.append(
            CarResult(
                car=car,
                name=entry.name,
                place=1,
                finished=finished,
                total_s=round(finish_s if finished else race_s, 4),
                lap_times_s=tuple(log.laps[car]),
                distance=round(float(now["best_distance"]), 3),
                penalty_s=round(log.penalties[car], 4),
                **{name: int(now[name]) for name in _COUNTS},
            )
        )
    ordered = sorted(unplaced, key=lambda car: merit(spec, car))
    placed = [car.model_copy(update={"place": place}) for place, car in enumerate(ordered, 1)]
    return RaceResult(
        spec=spec,
        order=tuple(placed),
        steps=log.steps,
        race_s=round(race_s, 4),
        lead_changes=int(world.worlds[0]["lead_changes"]),
        events=tuple(log.events),
    )


def merit(spec: RaceSpec, car: CarResult) -> tuple[float, ...]:
    """Return what to sort by: complete races first, by the spec's ranking; then by distance.

    Fewer mistakes break a tie, then the place on the grid.
    """
    window = {"best": 1, "average": min(spec.average_laps, spec.laps)}.get(spec.ranking)
    time_s = car.total_s if car.finished else None
    if window is not None:
        laps = car.lap_times_s
        stretches = [laps[first : first + window] for first in range(len(laps) - window + 1)]
        time_s = min(map(sum, stretches), default=None)  # all as long: the best mean, times that
    mistakes = car.off_tracks + car.crashes
    return (float(time_s is None), time_s or 0.0, -car.distance, float(mistakes), float(car.car))
