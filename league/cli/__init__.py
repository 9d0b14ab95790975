"""The command line, `league ...`: parses, runs the command, and turns errors into one sentence."""

from __future__ import annotations

import atexit
import gc
import os
import sys
from dataclasses import dataclass
from functools import reduce
from operator import or_
from typing import Annotated, Any

import tyro

from league.cli import drivers, evaluate, race, replays, rewards, tracks
from league.cli.season import entries, gauntlet, heats, run, serve, standings
from league.errors import LeagueError


@dataclass
class _Train:
    """Train a driver with PPO on many worlds, evaluated in Bullet from the start line."""


COMMANDS: dict[str, type] = {
    **race.COMMANDS,
    "train": _Train,  # its settings take a while to import: see `_parsed`
    **evaluate.COMMANDS,
    **rewards.COMMANDS,
    **drivers.COMMANDS,
    **tracks.COMMANDS,
    **replays.COMMANDS,
    **entries.COMMANDS,
    **run.COMMANDS,
    **standings.COMMANDS,
    **heats.COMMANDS,
    **gauntlet.COMMANDS,
    **serve.COMMANDS,
}
"""All commands, in the order of the help."""
_SIMULATING = (
    race.Race,
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
    # Skip the search for cycles at exit, which takes a second with torch in memory.
    atexit.register(gc.freeze)
    try:
        command = _parsed(arguments)
        if isinstance(command, _SIMULATING):
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
        # The reader of our output has closed it (`league ... | head`).
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


def _parsed(arguments: list[str] | None) -> Any:  # noqa: ANN401
    arguments = sys.argv[1:] if arguments is None else arguments
    if arguments[:1] == ["train"]:
        from league.cli import train

        return train.parse(arguments[1:])
    commands = [
        Annotated[command, tyro.conf.subcommand(name)] for name, command in COMMANDS.items()
    ]
    union: Any = reduce(or_, commands)
    return tyro.cli(
        union,
        prog="league",
        description="The open racing league for learning drivers.",
        args=arguments,
        config=(tyro.conf.OmitArgPrefixes,),
    )
