"""The command line's door: finds the command, runs it, and turns errors into one sentence."""

from __future__ import annotations

import atexit
import gc
import os
import sys
from functools import reduce
from operator import or_
from typing import Annotated, Any

import tyro

from league.cli import checkpoints, drivers, evaluate, race, replays, rewards, tracks, train
from league.cli.season import entries, gauntlet, heats, run, standings
from league.errors import LeagueError

ROOMS = (
    race,
    train,
    evaluate,
    rewards,
    checkpoints,
    tracks,
    drivers,
    replays,
    entries,
    run,
    standings,
    heats,
    gauntlet,
)
"""Where the commands are, in the order of the help; each room's `COMMANDS` names its own."""


SIMULATING = (
    race.Race,
    train.Train,
    evaluate.Evaluate,
    rewards.Rewards,
    replays.Verify,
    entries.Submit,
    run.Work,
    heats.Audit,
    gauntlet.Gauntlet,
    gauntlet.Compare,
)
"""Commands that drive cars, and so need the compiled simulator."""


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; return its exit code."""
    # All goes at once in the end: to look for cycles first takes a second with torch in memory.
    atexit.register(gc.freeze)
    try:
        command = _parsed(arguments)
        if isinstance(command, SIMULATING):
            from league import precompile  # late: Numba takes a while

            precompile.ensure()
        return command.run()
    except LeagueError as error:
        print(f"league: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("league: stopped.", file=sys.stderr)
        return 130
    except BrokenPipeError:
        # Whoever read our output has had enough (`league ... | head`); nothing more can be told.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


def _parsed(arguments: list[str] | None) -> Any:  # noqa: ANN401
    """Return the command that was asked for, with its settings."""
    return tyro.cli(
        _command(),
        prog="league",
        description="The open racing league for learning drivers.",
        args=arguments,
        config=(tyro.conf.OmitArgPrefixes, tyro.conf.FlagCreatePairsOff),
    )


def _command() -> Any:  # noqa: ANN401
    """Return the union of all commands, as the parser wants it."""
    named = [
        Annotated[command, tyro.conf.subcommand(name)]
        for room in ROOMS
        for name, command in room.COMMANDS.items()
    ]
    return reduce(or_, named)
