"""`league evaluate`: laps from the start line as the table of the original's console."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from league import times
from league.cli import tables
from league.cli.race import (
    labels,
    num_obstacles,
    print_remark,
    race_spec,
    replay_line,
    replay_path,
)
from league.errors import ConfigError
from league.sim.config import CarConfig, ObstacleConfig, RaceKind, SimConfig

if TYPE_CHECKING:
    from collections.abc import Callable

    from league.envs.actions import ActionSpace
    from league.envs.rewards import Reward
    from league.racing.table import Evaluation
    from league.racing.trace import Trace
    from league.track.track import TrackSet


@dataclass
class Evaluate:
    """Drive laps from the start line and print trial, time, % completed, off-tracks, crashes."""

    driver: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="DRIVER")]
    """A checkpoint (FILE.pt), or the name of a scripted driver (see `league drivers`)."""
    track: tuple[str, ...] = ("reinvent_2018",)
    """Names of tracks (see `league tracks`), or track files; one table for each."""
    kind: Literal["auto", "time_trial", "obstacle_avoidance"] = "auto"
    """Kind of race; auto: a time trial, or obstacle avoidance where obstacles were asked for."""
    laps: int = 3
    """Laps of each run."""
    trials: int = 1
    """Runs from the start line, with seeds counting up."""
    variation: float = 1.0
    """How far runs differ: 1 by up to 2 % in grip and mass, 0.3 deg of steering and 0.5 m/s at the
    start; 0: not at all."""
    episode: bool = False
    """End a lap at the first mistake, as training does, instead of a penalty."""
    seed: int = 0
    """Seed of obstacles and noise of the first run."""
    solver: Literal["bullet", "planar"] = "bullet"
    """Physics."""
    obstacles: int | None = None
    """Boxes or bots on the track; by default 6 where --kind obstacle_avoidance or --bots asks for
    some, else none."""
    bots: bool = False
    """Slow bot cars that change lanes instead of boxes."""
    fixed_obstacles: bool = False
    """Obstacles evenly spaced instead of at random places."""
    opponents: tuple[str, ...] = ()
    """Drivers or checkpoints to race against; they start behind."""
    trace: Path | None = None
    """Write every step to this CSV, with the 19 columns that community log tools read; or into this
    folder, NAME.run/simtrace for one, in the layout in which they look for it."""
    reward: str = "progress"
    """What the trace's reward column holds: centerline, progress, race or racing_line, or a reward
    file (FILE.py)."""
    replay: str = "none"
    """Folder or .race file for a replay of the first run; "none" keeps none."""
    json: bool = False
    """Print JSON."""

    def run(self) -> None:
        from league.racing.trace import Trace, write_evaluation

        _check(self)
        evaluations = []
        for track in self.track:
            evaluation, trace = _one(self, track)
            evaluations.append(evaluation)
            if not self.json:
                print_table(evaluation)
            if trace is not None and self.trace is not None:
                write = write_evaluation if _is_folder(self.trace) else Trace.write
                path = write(trace, self.trace)
                if not self.json:
                    print(f"Trace: {path}")
            if self.replay != "none":
                _keep_replay(self, track)
        if self.json:
            data = [{**one.model_dump(mode="json"), "summary": one.summary} for one in evaluations]
            print(json.dumps(data if len(data) > 1 else data[0], indent=2))


def _check(command: Evaluate) -> None:
    """Refuse flags that contradict each other before anything is driven."""
    tracks, trace, replay = command.track, command.trace, command.replay
    several = len(tracks) > 1
    for contradicts, sentence in (
        (not tracks, "no track was named: give --track NAME, `league tracks` lists them"),
        (
            trace is not None and several and not _is_folder(trace),
            f"--trace {trace} was asked for {len(tracks)} tracks: a file holds one track, "
            "give one, or a folder",
        ),
        (
            replay.endswith(".race") and several,
            f"--replay {replay} was asked for {len(tracks)} tracks: give a folder, or one track",
        ),
        (
            replay != "none" and command.episode,
            "--replay keeps a race, and with --episode there is none: omit one of the two",
        ),
        (
            command.reward != "progress" and trace is None,
            f"--reward {command.reward} fills a column of the trace, and none was asked for: "
            "give --trace FILE.csv as well",
        ),
        (
            bool(command.opponents) and command.kind == "time_trial",
            "--opponents were named for time_trial, which is driven alone: "
            "omit --kind for a head-to-head race",
        ),
    ):
        if contradicts:
            raise ConfigError(sentence)
    print_remark(_kind(command), _num_obstacles(command), 1)


def _one(command: Evaluate, track: str) -> tuple[Evaluation, Trace | None]:
    from league.agents import roster
    from league.racing.evaluate import evaluate
    from league.racing.trace import Trace
    from league.track import files
    from league.track.track import TrackSet

    course = files.load(track)
    tracks, car = TrackSet(course), SimConfig().car
    driver = roster.load(command.driver, tracks, car)
    opponents = [roster.load(name, tracks, car) for name in command.opponents]
    trace = None
    if command.trace is not None:
        space: ActionSpace | None = getattr(getattr(driver, "card", None), "action_space", None)
        trace = Trace(space, driver.sensors, started_s=time.time())
    done = evaluate(
        driver,
        course,
        laps=command.laps,
        trials=command.trials,
        kind=_kind(command),
        mode="episode" if command.episode else "race",
        seed=command.seed,
        solver=command.solver,
        variation=command.variation,
        obstacles=ObstacleConfig(
            count=_num_obstacles(command),
            kind="bot" if command.bots else "box",
            random_places=not command.fixed_obstacles,
        ),
        opponents=opponents,
        reward=None if trace is None else _reward(command.reward, tracks, car),
        watch=None if trace is None else trace.add,
    )
    return done.model_copy(update={"driver": labels([command.driver])[0]}), trace


def _num_obstacles(command: Evaluate) -> int:
    return num_obstacles(command, avoiding=command.kind == "obstacle_avoidance")


def _kind(command: Evaluate) -> RaceKind:
    if command.opponents:
        return "head_to_head"
    if command.kind == "auto":
        return "obstacle_avoidance" if _num_obstacles(command) else "time_trial"
    return command.kind


def _is_folder(path: Path) -> bool:
    return path.is_dir() or not path.suffix


def _reward(name: str, tracks: TrackSet, car: CarConfig) -> Callable[[int], Reward]:
    """Return what makes the reward of so many worlds, in which car 0 is paid."""
    if name.endswith(".py"):
        from league.deepracer import user_reward

        return lambda num_worlds: user_reward(name, num_worlds, (0,))
    from league.envs.rewards import built_in

    paid = built_in(name, tracks, car)
    return lambda num_worlds: paid


def _keep_replay(command: Evaluate, track: str) -> None:
    """Drive the first run once more, as a race that is recorded: the same race to the bit."""
    from league import replay as replays
    from league.racing import race
    from league.racing.evaluate import start_speed
    from league.track import files

    course = files.load(track)
    spec = race_spec(command, course.name, _kind(command), [command.driver, *command.opponents])
    started = start_speed(command.variation, len(spec.entries))
    spec = spec.model_copy(update={"variation": command.variation, "start_speed": started})
    recorded = race.run(spec, track=course).replay
    assert recorded is not None
    path = replays.write(recorded, replay_path(command.replay, spec, course))
    if not command.json:
        print(replay_line(path))


def print_table(done: Evaluation) -> None:
    """Print the console's table of trials and a line that sums it up."""
    title = f"{done.driver}: {done.kind.replace('_', ' ')} on {done.track}"
    heads = ["trial", "status", "time", "% done", "off", "crash", "penalty"]
    rows = []
    for one in done.trials:
        ended = one.status.replace("_", " "), times.clock(one.time_s), f"{one.completion:.1f}"
        penalty = f"{one.penalty_s:g} s" if one.penalty_s else ""
        rows.append((one.trial, *ended, one.off_tracks, one.crashes, penalty))
    if not any(one.penalty_s for one in done.trials):
        heads, rows = heads[:-1], [row[:-1] for row in rows]
    tables.table(title, heads, rows, "trial", "crash", "off")
    print(summary(done))


def summary(done: Evaluation) -> str:
    """Return the line below the table."""
    parts = [f"{done.complete_laps} of {done.asked} laps complete, {done.clean_laps} clean"]
    if done.runs > 1:
        parts.append(f"{done.clean_runs} of {done.runs} runs clean")
    if not done.all_complete:
        parts.append(f"{done.completion:.1f} % completed")
    for name, seconds in (
        ("best", done.best_lap_s),
        ("mean", done.mean_lap_s),
        ("best flying", done.best_flying_s),
        ("total", done.total_s),
    ):
        if seconds is not None:
            parts.append(f"{name} {times.clock(seconds)}")
    if done.places:
        won = sum(place == 1 for place in done.places)
        parts.append(f"{won} of {len(done.places)} races won")
    return " · ".join(parts)
