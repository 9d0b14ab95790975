"""`league reward check` and `league reward score`: try reward files on drives and races."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from league.cli import tables
from league.sim.config import RaceKind

if TYPE_CHECKING:
    from league.deepracer.check import DriveReport, Report
    from league.deepracer.rescore import Score
    from league.replay import Replay

_PRINTED = 5


@dataclass
class CheckReward:
    """Try a DeepRacer reward file on recorded drives of every kind of race."""

    file: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FILE.py")]
    """The Python file that defines reward_function(params); it is your own program, and is run."""
    kind: RaceKind | None = None
    """Kind of race that it is written for; by default it is tried in every kind, and may need
    objects."""
    json: bool = False
    """Print JSON."""

    def run(self) -> int:
        """Run the command; 1 if the function fails anywhere."""
        from league.deepracer import check

        report = check.check(self.file, kind=self.kind)
        if self.json:
            print(json.dumps(_as_json(report), indent=2))
        else:
            _print_report(report)
        return 1 if report.failures else 0


@dataclass
class ScoreReplay:
    """Score a recorded race with another reward function, and plot it with a second one."""

    replay: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="REPLAY")]
    """The replay file."""
    reward: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="REWARD")]
    """A reward file (FILE.py), or centerline, progress, race or racing_line."""
    against: str = "progress"
    """The second one: another reward file, or a built-in reward."""
    out: Path | None = None
    """Where to write the picture; by default next to the replay, with the ending .reward.png."""
    json: bool = False
    """Print JSON."""

    def run(self) -> None:
        from league import replay as replays
        from league.deepracer import rescore

        race = replays.read(self.replay)
        scores = [_score(race, name) for name in (self.reward, self.against)]
        path = self.out or self.replay.with_suffix(".reward.png")
        rescore.draw(race, scores, path)
        if self.json:
            documents = [
                {
                    "reward": one.name,
                    "totals": [
                        {"car": car, "name": name, "total": float(one.totals[car])}
                        for car, name in enumerate(race.names)
                    ],
                }
                for one in scores
            ]
            print(json.dumps({"picture": str(path), "scores": documents}, indent=2))
            return
        rows = []
        for car, name in enumerate(race.names):
            rows.append((name, "", *(f"{one.totals[car]:,.2f}" for one in scores)))
        heads = ("driver", "", *(one.name for one in scores))
        tables.table("Reward of the whole race", heads, rows)
        print(f"Picture: {path}")


@dataclass
class Rewards:
    """Check a reward function, or score a recorded race with one."""

    command: (
        Annotated[CheckReward, tyro.conf.subcommand("check")]
        | Annotated[ScoreReplay, tyro.conf.subcommand("score")]
    )


def _score(race: Replay, name: str) -> Score:
    from league.deepracer import rescore, user_reward
    from league.envs.rewards import built_in

    if not name.endswith(".py"):
        paid = built_in(name, race.tracks, race.sim.car)
        return rescore.score(race, paid, f"{name} (built in)")
    paid = user_reward(name, num_worlds=1, cars=range(race.num_cars), sim=race.sim)
    return rescore.score(race, paid, Path(name).name)


def _print_report(report: Report) -> None:
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
    printed = report.source.prints.lines
    if printed:
        print(f"It prints; the last {min(len(printed), _PRINTED)} lines:")
        for line in printed[-_PRINTED:]:
            print(f"  {line[:160]}")


def _failures(report: Report) -> list[str]:
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


def _row(one: DriveReport) -> tuple[str, ...]:
    state = "fails" if one.failure else "ok"
    if not one.rewards:
        return one.title, state, f"0 of {one.calls}", "", "", "", ""
    steps = f"{len(one.rewards)} of {one.calls}" if one.failure else str(one.calls)
    numbers = (_short(value) for value in (min(one.rewards), one.mean, max(one.rewards)))
    return one.title, state, steps, *numbers, f"{one.median_us:.1f}"


def _short(value: float) -> str:
    """Return a number in few characters."""
    return f"{value:.2f}" if value == 0 or 0.01 <= abs(value) < 1e4 else f"{value:.0e}"


def _as_json(report: Report) -> dict[str, object]:
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
