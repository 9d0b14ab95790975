"""`league evaluate` and `league reward`: drivers on laps, and reward files on recorded drives."""

from __future__ import annotations

import json
import re
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg, subcommand

from league import times
from league.atomic_file import check_writable
from league.cli import lazy, tables
from league.cli.race import (
    labels,
    num_obstacles,
    print_remark,
    race_kind,
    race_spec,
    replay_line,
    replay_path,
)
from league.errors import ConfigError, ReplayError
from league.flags import Unset
from league.sim.config import ObstacleConfig, RaceKind, SimConfig

if TYPE_CHECKING:
    from collections.abc import Sequence

    from league.envs.actions import ActionSpace
    from league.racing.table import Evaluation

_PRINTED = 5  # Last lines of what a reward function printed that are shown.


@dataclass
class Evaluate:
    """Drive laps from the start line and print trial, time, % completed, off-tracks, crashes."""

    driver: Annotated[Positional[str], arg(metavar="DRIVER")]
    """A checkpoint (FILE.pt), or the name of a scripted driver (see `league drivers`)."""
    track: tuple[str, ...] = ("reinvent_2018",)
    """Names of tracks (see `league tracks`), or track files; one table for each."""
    kind: Literal["auto", "time_trial", "obstacle_avoidance"] = "auto"
    """Kind of race; auto: a time trial, or obstacle avoidance where obstacles were asked for."""
    laps: int = 3  # Laps of each run.
    trials: int = 1  # Runs from the start line, with seeds counting up.
    variation: float = 1.0
    """How far runs differ: 1 by up to 2 % in grip and mass, 0.3 deg of steering and 0.5 m/s at the
    start; 0: not at all."""
    episode: bool = False  # End a lap at the first mistake, as training does, instead of a penalty.
    seed: int = 0  # Seed of obstacles and noise of the first run.
    solver: Literal["bullet", "planar"] = "bullet"  # Physics.
    obstacles: Unset[int | None] = None
    """Boxes or bots on the track; by default 6 where --kind obstacle_avoidance or --bots asks for
    some, else none."""
    bots: bool = False  # Slow bot cars that change lanes instead of boxes.
    fixed_obstacles: bool = False  # Obstacles evenly spaced instead of at random places.
    opponents: Unset[tuple[str, ...]] = ()
    """Drivers or checkpoints to race against; they start behind."""
    trace: Unset[Path | None] = None
    """Write every step to this CSV, with the 19 columns that community log tools read; or into this
    folder, NAME.run/simtrace for one, in the layout in which they look for it."""
    reward: str = "progress"
    """What the trace's reward column holds: centerline, progress, race or racing_line, or a reward
    file (FILE.py)."""
    replay: str = "none"  # Folder or .race file for a replay of the first run; "none" keeps none.
    json: bool = False  # Print JSON.

    def run(self) -> None:
        _check(self)
        evaluations = []
        for track in self.track:
            evaluation, trace = _one(self, track)
            evaluations.append(evaluation)
            if not self.json:
                print_table(evaluation)
            if trace is not None and self.trace is not None:
                if _is_folder(self.trace):
                    path = lazy.trace.write_evaluation(trace, self.trace)
                else:
                    path = trace.write(self.trace)
                if not self.json:
                    print(f"Trace: {path}")
            if self.replay != "none":
                _keep_replay(self, track)
        if self.json:
            data = [{**one.model_dump(mode="json"), "summary": one.summary} for one in evaluations]
            print(json.dumps(data if len(data) > 1 else data[0], indent=2))


def _check(command: Evaluate) -> None:
    """Refuse what cannot be driven or kept, before anything is driven."""
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
            trace is not None and not trace.suffix and trace.is_file(),
            f"--trace {trace} has no ending, so it means a folder, and {trace} is no folder: "
            "give FILE.csv, or another folder",
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
    for track in tracks if several else ():
        lazy.files.load(track)
    if trace is not None:
        check_writable(trace / "ip" if _is_folder(trace) else trace, "the trace", ConfigError)
    if replay != "none":
        kept = Path(replay) if replay.endswith(".race") else Path(replay) / "one.race"
        check_writable(kept, "the replay", ReplayError)
    print_remark(_kind(command), num_obstacles(command), 1)


def _one(command: Evaluate, track: str) -> tuple[Evaluation, lazy.trace.Trace | None]:
    course = lazy.files.load(track)
    tracks, sim = lazy.track.TrackSet(course), SimConfig()
    driver = lazy.roster.load(command.driver, tracks, sim.car)
    trace = reward = None
    if command.trace is not None:
        space: ActionSpace | None = getattr(getattr(driver, "card", None), "action_space", None)
        trace = lazy.trace.Trace(space, driver.sensors, started_s=time.time())
        reward = partial(named, command.reward, tracks, sim, cars=(0,))
    done = lazy.evaluate.evaluate(
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
            count=num_obstacles(command),
            kind="bot" if command.bots else "box",
            random_places=not command.fixed_obstacles,
        ),
        opponents=command.opponents,
        reward=reward,
        watch=None if trace is None else trace.add,
    )
    return done.model_copy(update={"driver": labels([command.driver])[0]}), trace


def _kind(command: Evaluate) -> RaceKind:
    return "head_to_head" if command.opponents else race_kind(command, 1)


def _is_folder(path: Path) -> bool:
    return path.is_dir() or not path.suffix


def _keep_replay(command: Evaluate, track: str) -> None:
    """Drive the first run once more, as a race that is recorded: the same race to the bit."""
    course = lazy.files.load(track)
    spec = race_spec(command, course.name, _kind(command), [command.driver, *command.opponents])
    started = lazy.evaluate.start_speed(command.variation, len(spec.entries))
    spec = spec.model_copy(update={"variation": command.variation, "start_speed": started})
    recorded = lazy.race.run(spec, track=course).replay
    assert recorded is not None
    path = lazy.replay.write(recorded, replay_path(command.replay, spec, course))
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


@dataclass
class CheckReward:
    """Try a DeepRacer reward file on recorded drives of every kind of race."""

    file: Annotated[Positional[Path], arg(metavar="FILE.py")]
    """The Python file that defines reward_function(params); it is your own program, and is run."""
    kind: Unset[RaceKind | None] = None
    """Kind of race that it is written for; by default it is tried in every kind, and may need
    objects."""
    json: bool = False  # Print JSON.

    def run(self) -> int:
        """Run the command; 1 if the function fails anywhere."""
        report = lazy.check.check(self.file, kind=self.kind)
        if self.json:
            print(json.dumps(_as_json(report), indent=2))
        else:
            _print_report(report)
        return 1 if report.failures else 0


@dataclass
class ScoreReplay:
    """Score a recorded race with another reward function, and plot it with a second one."""

    replay: Annotated[Positional[Path], arg(metavar="REPLAY")]  # The replay file.
    reward: Annotated[Positional[str], arg(metavar="REWARD")]
    """A reward file (FILE.py), or centerline, progress, race or racing_line."""
    against: str = "progress"  # The second one: another reward file, or a built-in reward.
    out: Unset[Path | None] = None
    """Where to write the picture; by default next to the replay, with the ending .reward.png."""
    json: bool = False  # Print JSON.

    def run(self) -> None:
        race = lazy.replay.read(self.replay)
        scores = []
        for name in (self.reward, self.against):
            reward = named(name, race.tracks, race.sim, 1, range(race.num_cars))
            shown = Path(name).name if name.endswith(".py") else f"{name} (built in)"
            scores.append(lazy.rescore.score(race, reward, shown))
        path = self.out or self.replay.with_suffix(".reward.png")
        lazy.rescore.draw(race, scores, path)
        cars = list(enumerate(race.names))
        if self.json:
            documents = []
            for one in scores:
                totals = [
                    {"car": k, "name": name, "total": float(one.totals[k])} for k, name in cars
                ]
                documents.append({"reward": one.name, "totals": totals})
            print(json.dumps({"picture": str(path), "scores": documents}, indent=2))
            return
        rows = [(name, "", *(f"{one.totals[k]:,.2f}" for one in scores)) for k, name in cars]
        heads = ("driver", "", *(one.name for one in scores))
        tables.table("Reward of the whole race", heads, rows)
        print(f"Picture: {path}")


@dataclass
class Rewards:
    """Check a reward function, or score a recorded race with one."""

    command: (
        Annotated[CheckReward, subcommand("check")] | Annotated[ScoreReplay, subcommand("score")]
    )


def named(
    name: str, tracks: lazy.track.TrackSet, sim: SimConfig, num_worlds: int, cars: Sequence[int]
) -> lazy.rewards.Reward:
    """Return a built-in reward, or that of a reward file (FILE.py), which pays these cars."""
    if name.endswith(".py"):
        return lazy.reward_file.user_reward(name, num_worlds, cars, sim=sim)
    return lazy.rewards.built_in(name, tracks, sim.car)


def _print_report(report: lazy.check.Report) -> None:
    heads = ("drive", "", "steps", "min", "mean", "max", "us")
    tables.table(f"{report.source.path}", heads, map(_row, report.drives), "us", "steps")
    print(f"Keys read ({len(report.keys)} of 27): {', '.join(report.keys) or 'none'}")
    for failure in _failures(report):
        print(f"Fails: {failure}")
    if report.needs_objects:
        alone = next(one for one in report.drives if one.failure)
        print(
            f"Note: without boxes or other cars it fails, so a time trial cannot be trained with "
            f"it: {alone.failure}"
        )
    for warning in report.warnings:
        print(f"Note: {warning}")
    if printed := report.source.prints.lines[-_PRINTED:]:
        print(f"It prints; the last {len(printed)} lines:")
        for line in printed:
            print(f"  {line[:160]}")


def _failures(report: lazy.check.Report) -> list[str]:
    """Return each fault once, with the first drive on which it came."""
    failures: dict[str, list[str]] = {}
    for one in report.failures:
        failure = one.failure or ""
        fault = re.sub(rf" \({re.escape(one.title)}, steps \d+\)", "", failure)
        failures.setdefault(fault, []).append(failure)
    return [
        failure + (f" (and on {len(others)} more drives)" if others else "")
        for failure, *others in failures.values()
    ]


def _row(one: lazy.check.DriveReport) -> tuple[str, ...]:
    state = "fails" if one.failure else "ok"
    if not one.rewards:
        return one.title, state, f"0 of {one.calls}", "", "", "", ""
    steps = f"{len(one.rewards)} of {one.calls}" if one.failure else str(one.calls)
    numbers = (_short(value) for value in (min(one.rewards), one.mean, max(one.rewards)))
    return one.title, state, steps, *numbers, f"{one.median_us:.1f}"


def _short(value: float) -> str:
    return f"{value:.2f}" if value == 0 or 0.01 <= abs(value) < 1e4 else f"{value:.0e}"


def _as_json(report: lazy.check.Report) -> dict[str, object]:
    return {
        "file": str(report.source.path),
        "digest": report.source.digest,
        "ok": not report.failures,
        "needs_objects": report.needs_objects,
        "keys": report.keys,
        "unknown_keys": report.unknown_keys,
        "warnings": report.warnings,
        "printed": report.source.prints.lines,
        "drives": [
            {
                "title": one.title,
                "kind": one.kind,
                "steps": one.calls,
                "min": min(one.rewards, default=None),
                "mean": one.mean if one.rewards else None,
                "max": max(one.rewards, default=None),
                "median_us": round(one.median_us, 3),
                "failure": one.failure,
            }
            for one in report.drives
        ],
    }
