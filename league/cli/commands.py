"""All commands: parses a command line and runs its command."""

from __future__ import annotations

import atexit
import gc
import inspect
import re
import shutil
import sys
import textwrap
from dataclasses import dataclass
from functools import reduce
from operator import or_
from typing import Annotated, Any

import tyro

from league.cli import drivers, evaluate, race, replays, rewards, tracks
from league.cli.season import entries, gauntlet, heats, run, seasons, standings, tokens


@dataclass
class _Train:
    """Train a driver with PPO on many worlds, evaluated in Bullet from the start line."""


GROUPS: dict[str, dict[str, type]] = {
    "Drive": {
        "race": race.Race,
        "train": _Train,  # its settings take a while to import: see `_parsed`
        "evaluate": evaluate.Evaluate,
        "reward": rewards.Rewards,
        "drivers": drivers.Drivers,
    },
    "Watch": {
        "replays": replays.ListReplays,
        "view": replays.View,
        "video": replays.Video,
        "verify": replays.Verify,
    },
    "Tracks": {"tracks": tracks.Tracks},
    "League": {
        **entries.COMMANDS,
        **run.COMMANDS,
        **standings.COMMANDS,
        **seasons.COMMANDS,
        **heats.COMMANDS,
        **gauntlet.COMMANDS,
        **run.SERVE,
        **tokens.COMMANDS,
    },
    "Tools": {"card": drivers.ShowCard, "export": drivers.Export},
}
"""All commands, in groups and in the order of the help."""
COMMANDS = {name: command for group in GROUPS.values() for name, command in group.items()}
_SIMULATING = (
    race.Race,
    evaluate.Evaluate,
    rewards.Rewards,
    replays.Verify,
    entries.Submit,
    run.Racing,
    run.Serve,
    heats.Audit,
    gauntlet.Gauntlet,
    gauntlet.Compare,
)
"""Commands that drive cars, and so need the compiled simulator."""


def main(arguments: list[str]) -> int:
    """Parse a command line and run it; return its exit code.

    Raises:
        LeagueError: it cannot be run.
    """
    # Imports make 100,000 objects that stay: a search for cycles among them every 700 takes an
    # eighth of the start. The one at exit takes a second with torch in memory.
    gc.set_threshold(50_000, 20, 50)
    atexit.register(gc.freeze)
    if arguments in ([], ["-h"], ["--help"]):
        print(overview(), file=sys.stdout if arguments else sys.stderr)
        return 0 if arguments else 2
    command = _parsed(arguments)
    if isinstance(command, _SIMULATING):
        from league import precompile  # late: Numba takes a while

        precompile.ensure()
    return command.run() or 0


def overview() -> str:
    """Return the help of the whole program: its commands in groups, a line or two for each."""
    width = min(shutil.get_terminal_size().columns, 100)
    lines = ["usage: league COMMAND ...", "", "The open racing league for learning drivers."]
    for group, commands in GROUPS.items():
        lines += ["", f"{group}:"]
        for name, command in commands.items():
            text = re.split(r"[:;.](?:\s|$)", inspect.getdoc(command) or "", maxsplit=1)[0]
            lead = f"  {name:<11}"
            lines += textwrap.wrap(
                lead + " ".join(text.split()), width, subsequent_indent=" " * len(lead)
            )
    return "\n".join([*lines, "", "`league COMMAND --help` shows what a command takes."])


def _parsed(arguments: list[str]) -> Any:  # noqa: ANN401
    if arguments[:1] == ["train"]:
        from league.cli import train

        return train.parse(arguments[1:])
    config = (tyro.conf.OmitArgPrefixes,)
    if command := COMMANDS.get(arguments[0]):
        return tyro.cli(command, prog=f"league {arguments[0]}", args=arguments[1:], config=config)
    # An option or a mistake: the parser of all commands says so.
    commands = [Annotated[each, tyro.conf.subcommand(name)] for name, each in COMMANDS.items()]
    union: Any = reduce(or_, commands)
    return tyro.cli(
        union,
        prog="league",
        description="The open racing league for learning drivers.",
        args=arguments,
        config=config,
    )
