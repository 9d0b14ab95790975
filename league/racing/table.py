"""The table of an evaluation: trials and their summary; plain data for files and screens."""

from typing import Literal

from league.race_spec import FrozenModel
from league.sim.config import RaceKind, SolverName

Mode = Literal["race", "episode"]
Status = Literal["lap_complete", "off_track", "crashed", "immobilized", "reversed", "time_up"]
"""How a trial ended, in the words that community tools read."""
_SUMMARY = (
    *("asked", "complete_laps", "clean_laps", "clean_runs", "runs", "completion"),
    *("best_lap_s", "mean_lap_s", "best_flying_s", "total_s", "off_tracks", "crashes"),
)
"""Figures of an evaluation that describe it."""


class Trial(FrozenModel):
    """One lap, or one attempt at it."""

    trial: int  # number, from 1, over all runs
    run: int  # which run from the start line, from 0
    seed: int  # seed of the run: of obstacles, noise and variation
    # whether it began on the start line, at walking pace at most; otherwise it is a flying lap
    standing: bool
    status: Status  # how it ended
    time_s: float  # how long it took, penalties included [s]
    completion: float  # how much of the lap was driven [%], 0 to 100
    off_tracks: int  # times all four wheels left the road
    crashes: int  # contacts to blame for
    immobilised: int  # times standing still too long
    reversed: int  # times driving backwards too long
    penalty_s: float  # seconds of penalty, which `time_s` includes [s]

    @property
    def complete(self) -> bool:
        """Whether the lap was completed."""
        return self.status == "lap_complete"

    @property
    def resets(self) -> int:
        """Mistakes of every kind."""
        return self.off_tracks + self.crashes + self.immobilised + self.reversed

    @property
    def clean(self) -> bool:
        """Whether the lap was completed without a mistake."""
        return self.complete and self.resets == 0


class Evaluation(FrozenModel):
    """All trials of an evaluation."""

    driver: str  # name of the driver
    track: str  # name of the track
    kind: RaceKind  # kind of race
    mode: Mode  # whether a mistake costs seconds ("race") or ends the trial ("episode")
    solver: SolverName  # physics
    laps: int  # laps of each run
    asked: int  # trials that would have been driven had nothing gone wrong
    seed: int  # seed of the first run
    # how far runs differ in start speed, grip, mass and steering; 0: not at all
    variation: float = 0.0
    trials: tuple[Trial, ...]  # all trials that were begun, in order
    # place from 1 at the end of each run, against other cars; otherwise empty
    places: tuple[int, ...]

    @property
    def complete_laps(self) -> int:
        """Laps completed."""
        return sum(one.complete for one in self.trials)

    @property
    def clean_laps(self) -> int:
        """Laps completed without a mistake."""
        return sum(one.clean for one in self.trials)

    @property
    def runs(self) -> int:
        """Runs from the start line."""
        return len({one.run for one in self.trials})

    @property
    def clean_runs(self) -> int:
        """Runs with every lap completed without a mistake."""
        return self.runs - len({one.run for one in self.trials if not one.clean})

    @property
    def all_complete(self) -> bool:
        """Whether every lap asked for was completed."""
        return self.complete_laps == self.asked

    @property
    def completion(self) -> float:
        """Mean completion of all trials asked for [%]; one that was never begun counts as 0."""
        return sum(one.completion for one in self.trials) / self.asked

    @property
    def off_tracks(self) -> int:
        """Times off the track, in all trials."""
        return sum(one.off_tracks for one in self.trials)

    @property
    def crashes(self) -> int:
        """Contacts to blame for, in all trials."""
        return sum(one.crashes for one in self.trials)

    @property
    def lap_times_s(self) -> tuple[float, ...]:
        """Times of the complete laps, penalties included [s]."""
        return tuple(one.time_s for one in self.trials if one.complete)

    @property
    def flying_laps_s(self) -> tuple[float, ...]:
        """Times of the clean laps that began at speed [s]."""
        return tuple(one.time_s for one in self.trials if one.clean and not one.standing)

    @property
    def best_lap_s(self) -> float | None:
        """Best complete lap [s]."""
        return min(self.lap_times_s, default=None)

    @property
    def mean_lap_s(self) -> float | None:
        """Mean of the complete laps [s]."""
        times = self.lap_times_s
        return sum(times) / len(times) if times else None

    @property
    def best_flying_s(self) -> float | None:
        """Best clean flying lap [s]."""
        return min(self.flying_laps_s, default=None)

    @property
    def total_s(self) -> float:
        """Time of all trials together [s]."""
        return sum(one.time_s for one in self.trials)

    @property
    def summary(self) -> dict[str, float | int | None]:
        """The figures that describe an evaluation, by name; times in seconds, completion in %."""
        figures = {name: getattr(self, name) for name in _SUMMARY}
        return {
            name: round(value, 4) if isinstance(value, float) else value
            for name, value in figures.items()
        }
