"""The book of one race: its events and laps as the referee finds them, and the classification."""

from __future__ import annotations

from dataclasses import dataclass, field

from torch import Tensor

from league.race_spec import CarResult, Event, EventKind, RaceResult, RaceSpec
from league.sim.referee import NOBODY, Verdict
from league.sim.world import World


@dataclass
class Book:
    """The events of a race, and each car's laps, as they happen."""

    step_dt: float
    num_cars: int
    events: list[Event] = field(default_factory=list)
    laps: list[list[float]] = field(default_factory=list)
    penalties: list[float] = field(default_factory=list)
    steps: int = 0

    def __post_init__(self) -> None:
        self.laps = [[] for _ in range(self.num_cars)]
        self.penalties = [0.0] * self.num_cars
        self.events.append(Event(time_s=0.0, kind="start", car=0))

    def add(
        self, kind: EventKind, car: int, other: int | None = None, value: float | None = None
    ) -> None:
        """Write down an event of now."""
        time_s = round(self.steps * self.step_dt, 4)
        self.events.append(Event(time_s=time_s, kind=kind, car=car, other=other, value=value))

    def note(self, seen: Verdict, scraped: Tensor, world: World) -> None:
        """Write down what the referee found in a step, and which cars came to the wall."""
        now = world.standing
        for car in range(self.num_cars):
            if seen.lap[0, car]:
                self.laps[car].append(round(float(now.last_lap_s[0, car]), 4))
                self.add("lap", car, value=self.laps[car][-1])
            if seen.finished[0, car]:
                self.add("finish", car, value=round(float(now.finish_s[0, car]), 4))
            self._note_mistakes(seen, world, car)
            for other in seen.overtook[0, car].nonzero()[:, 0].tolist():
                self.add("overtake", car, other=other)
            if seen.was_hit[0, car]:
                self.add("contact", car)
            if scraped[0, car]:
                self.add("wall_contact", car)
        if seen.lead_changed[0]:
            self.add("lead_change", int(now.leader[0]))

    def _note_mistakes(self, seen: Verdict, world: World, car: int) -> None:
        penalty = float(world.standing.penalty_s[0, car])
        named: tuple[tuple[EventKind, Tensor], ...] = (
            ("off_track", seen.off_track),
            ("immobilised", seen.immobilised),
            ("reversed", seen.reversed),
        )
        for kind, flag in named:
            if flag[0, car]:
                self.add(kind, car, value=round(penalty, 4))
        if seen.crashed[0, car]:
            car_hit, thing = int(seen.crashed_car[0, car]), int(seen.crashed_obstacle[0, car])
            if car_hit != NOBODY:
                self.add("crash", car, other=car_hit, value=round(penalty, 4))
            if thing != NOBODY:
                self.add("obstacle_contact", car, other=thing, value=round(penalty, 4))
        if seen.mistake[0, car]:
            self.penalties[car] += penalty
        if seen.released[0, car]:
            self.add("put_back", car)


def classify(spec: RaceSpec, world: World, book: Book) -> RaceResult:
    """Return the classification of a race that is over (facts 5.4)."""
    now = world.standing
    race_s = book.steps * book.step_dt
    unplaced = []
    for car, entry in enumerate(spec.entries):
        finish_s = float(now.finish_s[0, car])
        finished = finish_s != float("inf")
        unplaced.append(
            CarResult(
                car=car,
                name=entry.name,
                place=1,
                finished=finished,
                laps=int(now.laps[0, car]),
                total_s=round(finish_s if finished else race_s, 4),
                lap_times_s=tuple(book.laps[car]),
                distance=round(float(now.best_distance[0, car]), 3),
                off_tracks=int(now.off_tracks[0, car]),
                crashes=int(now.crashes[0, car]),
                contacts_taken=int(now.contacts_taken[0, car]),
                immobilised=int(now.immobilised[0, car]),
                reversed=int(now.reversed[0, car]),
                penalty_s=round(book.penalties[car], 4),
                overtakes=int(now.overtakes[0, car]),
            )
        )
    ordered = sorted(unplaced, key=lambda car: merit(spec, car))
    placed = [car.model_copy(update={"place": place}) for place, car in enumerate(ordered, 1)]
    return RaceResult(
        spec=spec,
        order=tuple(placed),
        steps=book.steps,
        race_s=round(race_s, 4),
        lead_changes=int(now.lead_changes[0]),
        events=tuple(book.events),
    )


def merit(spec: RaceSpec, car: CarResult) -> tuple[float, ...]:
    """Return what to sort by: complete races first, by the spec's ranking; then by distance.

    Equal times are told apart by fewer mistakes, then by the place on the grid.
    """
    times = {
        "total": car.total_s,
        "best": car.best_lap_s or float("inf"),
        "average": car.total_s / max(car.laps, 1),
    }
    counts = car.best_lap_s is not None if spec.ranking == "best" else car.finished
    time_s = times[spec.ranking] if counts else 0.0
    mistakes = car.off_tracks + car.crashes
    return (0.0 if counts else 1.0, time_s, -car.distance, float(mistakes), float(car.car))
