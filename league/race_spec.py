"""The data of a race: its settings (RaceSpec), its events (Event), its end (RaceResult).

They cross files and the command line, so they are pydantic models: checked, and refused with a
reason.
"""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

from league import times
from league.errors import ConfigError, brief, first_problem
from league.sim.config import (
    MAX_OBSTACLES,
    USUAL_OBSTACLES,
    RaceFormat,
    RaceKind,
    RulesName,
    SolverName,
)

EventKind = Literal[
    "start", "lap", "finish", "off_track", "crash", "contact", "touch", "forced_off",
    "obstacle_contact", "wall_contact", "immobilised", "reversed", "put_back", "overtake",
    "lead_change", "driver_fault",
]  # fmt: skip


class FrozenModel(BaseModel):
    """Checked data that does not change; no unknown fields, no NaN or infinity."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def printable(text: str) -> str:
    """Return a text, or refuse one with line ends or escape sequences."""
    if not text.isprintable():
        raise ValueError("it holds characters that cannot be printed: give plain text on one line")
    return text


Name = Annotated[str, AfterValidator(printable)]
"""Text that is shown to people and may come from a stranger: no line ends, no escapes."""


class Entry(FrozenModel):
    """The driver of one car."""

    name: Name = Field(min_length=1, max_length=200)  # of a scripted driver, or a label
    digest: str = Field(default="", max_length=64)  # SHA-256 of the checkpoint; none of a script
    # where the checkpoint was when the race was asked for; empty for scripted drivers
    path: str = Field(default="", max_length=1000, pattern=r"^(|.*\.pt)$")


class RaceSpec(FrozenModel):
    """All that decides a race, besides the drivers' own weights; same spec, same race."""

    track: str = Field(default="reinvent_2018", min_length=1, max_length=200)  # name of a track
    kind: RaceKind = "head_to_head"  # kind of race
    laps: int = Field(default=3, ge=1, le=1000)  # laps to drive
    seed: int = Field(default=0, ge=0, lt=2**63)  # seed of obstacles, noise and randomisation
    solver: SolverName = "bullet"  # physics solver
    # order by total time, best lap, or best mean of consecutive laps
    ranking: Literal["total", "best", "average"] = "total"
    # how many consecutive laps a mean is of, or all where fewer are raced
    average_laps: int = Field(default=2, ge=1, le=1000)
    rules: RulesName = "league"  # this league's, or the original's, which older races had
    entries: tuple[Entry, ...] = Field(min_length=1, max_length=8)  # the field, in grid order
    # How the cars line up: standing, in the order of a race's organiser; qualifying, the fastest
    # first; reverse, the fastest last; pursuit, spread evenly round the lap. `entries` are in the
    # order that this gave.
    format: RaceFormat = "standing"
    # boxes or bots; by default six in obstacle avoidance, and none in the other kinds
    obstacles: int = Field(default=0, ge=0, le=MAX_OBSTACLES)
    obstacle_kind: Literal["box", "bot"] = "box"  # boxes, or slow bot cars that change lanes
    random_obstacles: bool = True  # at random places for each seed; otherwise evenly spaced
    off_track_penalty_s: float = Field(default=2.0, ge=0, le=600)  # frozen after leaving the road
    crash_penalty_s: float = Field(default=5.0, ge=0, le=600)  # after the hardest contact by fault
    max_time_s: float = Field(default=0.0, ge=0, le=36_000)  # longest race [s]; 0: by length
    # how much cars of one kind differ, drawn from the seed; 0: not at all, 1: as in a league
    variation: float = Field(default=0.0, ge=0, le=10)
    start_speed: float = Field(default=0.0, ge=0, le=12)  # most at the start [m/s], by the seed

    @property
    def title(self) -> str:
        """Kind, track and laps for people, "time trial on reinvent_2018, 3 laps"."""
        return f"{self.kind.replace('_', ' ')} on {self.track}, {times.counted(self.laps, 'lap')}"

    def laps_on(self, *, closed: bool) -> int:
        """Return how many laps are driven: on a track that is not closed, one."""
        return self.laps if closed else 1

    @model_validator(mode="before")
    @classmethod
    def _with_usual_obstacles(cls, settings: object) -> object:
        if isinstance(settings, dict) and settings.get("kind") == "obstacle_avoidance":
            return {"obstacles": USUAL_OBSTACLES, **settings}
        return settings


def remark_on(kind: RaceKind, num_obstacles: int, num_cars: int) -> str:
    """Return what to say of obstacle avoidance on an empty track; nothing of other races."""
    if kind != "obstacle_avoidance" or num_obstacles:
        return ""
    same = "a time trial" if num_cars == 1 else "a head-to-head race"
    return (
        f"obstacle avoidance with 0 obstacles is {same}: give a larger number, or none for the "
        f"usual {USUAL_OBSTACLES}"
    )


def of_older_version(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of a spec written before specs named their rules, as they were meant."""
    avoiding = settings.get("kind") == "obstacle_avoidance"
    return {
        **settings,
        "rules": "deepracer",
        # The mean was of all laps, and in other kinds the number of obstacles was not read.
        "average_laps": settings.get("laps", 3),
        "obstacles": settings.get("obstacles", USUAL_OBSTACLES) if avoiding else 0,
    }


def checked(settings: Mapping[str, Any]) -> RaceSpec:
    """Build a spec from settings of unknown origin; ConfigError says what is wrong with them."""
    try:
        return RaceSpec.model_validate(dict(settings))
    except ValidationError as error:
        first, where, reason = first_problem(error, "the spec")
    if first["type"] == "missing":
        raise ConfigError(f"the race lacks the field {where}: say what it is to be")
    if first["type"] == "extra_forbidden":
        raise ConfigError(
            f"{where} is no field of a race: they are {', '.join(RaceSpec.model_fields)}"
        )
    if first["loc"] == ("entries",) and isinstance(first["input"], (list, tuple)):
        raise ConfigError(f"{len(first['input'])} drivers were named: give 1 to 8")
    if first["loc"][:1] == ("entries",) and first["loc"][-1] == "name":
        raise ConfigError(
            f"a driver's name is {brief(first['input'])}: give 1 to 200 printable characters on "
            "one line"
        )
    raise ConfigError(f"{where} is {brief(first['input'])}: {_wanted(where) or reason}")


def _wanted(name: str) -> str:
    """Return what a setting may be, if it is a number within limits or one of a few words."""
    about = RaceSpec.model_json_schema()["properties"].get(name, {})
    if "enum" in about:
        return f"choose one of {', '.join(about['enum'])}"
    if "minimum" not in about:
        return ""
    number = "a whole number" if about["type"] == "integer" else "a number"
    largest = about.get("maximum") or f"below {about['exclusiveMaximum']}"
    return f"give {number} from {about['minimum']} to {largest}"


class Event(FrozenModel):
    """An event of a race."""

    time_s: float  # race time [s]
    kind: EventKind
    car: int  # the car it happened to
    other: int | None = None  # the other car or the obstacle, where there is one
    value: float | None = None  # lap time [s], penalty [s] or place, by kind


class CarResult(FrozenModel):
    """How one car's race ended."""

    car: int = Field(description="Grid slot, from 0.")
    name: Name  # name of its driver
    place: int = Field(description="From 1; equal places do not occur.")
    finished: bool = Field(description="Whether all laps were driven.")
    laps: int = Field(description="Complete laps.")
    total_s: float = Field(
        description="Time of the last complete lap's end, penalties included [s]; race time if "
        "not finished."
    )
    lap_times_s: tuple[float, ...] = Field(description="Each complete lap [s], with penalties.")
    distance: float = Field(description="Driven along the track [m].")
    off_tracks: int = Field(description="Times off the track.")
    crashes: int = Field(description="Contacts penalised.")
    touches: int = Field(0, description="Contacts to blame for, too light for a penalty.")
    contacts_taken: int = Field(description="Contacts that another car was to blame for.")
    immobilised: int = Field(description="Times immobilised.")
    reversed: int = Field(description="Times driving backwards.")
    penalty_s: float = Field(description="Penalties in all [s].")
    overtakes: int = Field(description="Cars passed on the road.")

    @property
    def best_lap_s(self) -> float | None:
        """Best complete lap [s]."""
        return min(self.lap_times_s, default=None)


class RaceResult(FrozenModel):
    """The classification of a race."""

    spec: RaceSpec  # its settings
    order: tuple[CarResult, ...]  # cars by place
    steps: int  # control steps raced
    race_s: float  # race time [s]
    lead_changes: int  # how often another car took the lead
    events: tuple[Event, ...]  # all events, by time
