"""All commands: parses a command line and runs its command."""

import atexit
import gc
import importlib
import inspect
import io
import re
import shutil
import sys
import textwrap
from contextlib import redirect_stdout, suppress
from dataclasses import dataclass
from typing import Any

import tyro
from tyro import _errors as mistakes  # private to tyro, so its version is pinned

from league.errors import ConfigError, brief, nearest_names


@dataclass
class Train:
    """Train a driver with PPO on many worlds, evaluated in Bullet from the start line."""


GROUPS = {
    "Drive": {
        "race": "race.Race",
        "train": "commands.Train",  # its settings take a while to import: see `_parsed`
        "evaluate": "evaluate.Evaluate",
        "reward": "evaluate.Rewards",
        "drivers": "inventory.Drivers",
    },
    "Watch": {
        "replays": "race.ListReplays",
        "view": "race.View",
        "video": "race.Video",
        "verify": "race.Verify",
    },
    "Tracks": {"tracks": "inventory.Tracks"},
    "League": {
        "init": "season.entries.Init",
        "submit": "season.entries.Submit",
        "pack": "season.entries.Pack",
        "entries": "season.entries.Entries",
        "retire": "season.entries.Retire",
        "upgrade": "season.entries.Upgrade",
        "run": "season.run.RunSeason",
        "work": "season.run.Work",
        "standings": "season.standings.ShowStandings",
        "show": "season.standings.ShowEntry",
        "h2h": "season.standings.ShowHeadToHead",
        "history": "season.standings.ShowHistory",
        "season": "season.standings.Seasons",
        "cup": "season.standings.Cups",
        "heats": "season.heats.Heats",
        "heat": "season.heats.ShowHeat",
        "audit": "season.heats.Audit",
        "retry": "season.heats.Retry",
        "gauntlet": "season.heats.Gauntlet",
        "compare": "season.heats.Compare",
        "serve": "season.run.Serve",
        "site": "season.run.Site",
        "token": "season.entries.ManageTokens",
    },
    "Tools": {"card": "inventory.ShowCard", "export": "inventory.Export"},
}
"""All commands in groups, in the order of the help: where their classes are in this package. Only
the one that runs is imported."""
COMMANDS = {name: place for group in GROUPS.values() for name, place in group.items()}
_SIMULATING = {
    "race", "evaluate", "reward", "verify", "submit", "run", "work", "serve", "audit", "gauntlet",
    "compare",
}  # fmt: skip
"""Commands that drive cars, and so need the compiled simulator."""


def command_class(name: str) -> type:
    """Return the class of a command; its fields are what the command takes."""
    module, _, kind = COMMANDS[name].rpartition(".")
    return getattr(importlib.import_module(f"league.cli.{module}"), kind)


def main(arguments: list[str]) -> int:
    """Parse a command line and run it; return its exit code."""
    # Imports make 100,000 objects that stay: a search for cycles among them every 700 takes an
    # eighth of the start. The one at exit takes a second with torch in memory.
    gc.set_threshold(50_000, 20, 50)
    atexit.register(gc.freeze)
    if not arguments or arguments[0] in ("-h", "--help"):
        print(overview(), file=sys.stdout if arguments else sys.stderr)
        return 0 if arguments else 2
    command = _parsed(arguments)
    if arguments[0] in _SIMULATING:
        from league import precompile  # late: Numba takes a while

        precompile.ensure()
    # `tracks`, `reward` and `token` have commands of their own.
    return getattr(command, "command", command).run() or 0


def overview() -> str:
    """Return the help of the whole program: its commands in groups, a line or two for each."""
    width = min(shutil.get_terminal_size().columns, 100)
    lines = ["usage: league COMMAND ...", "", "The open racing league for learning drivers."]
    for group, commands in GROUPS.items():
        lines += ["", f"{group}:"]
        for name in commands:
            doc = inspect.getdoc(command_class(name)) or ""
            text = re.split(r"[:;.](?:\s|$)", doc, maxsplit=1)[0]
            lead = f"  {name:<11}"
            lines += textwrap.wrap(
                lead + " ".join(text.split()), width, subsequent_indent=" " * len(lead)
            )
    return "\n".join([*lines, "", "`league COMMAND --help` shows what a command takes."])


def parse(kind: type, name: str, arguments: list[str], default: Any = None) -> Any:  # noqa: ANN401
    """Return the command of a class, as a command line sets it.

    `default` is a command that has the defaults; ConfigError says what cannot be parsed.
    """

    def refuse(event: mistakes.ParseErrorEvent) -> None:
        if isinstance(event, mistakes.UnrecognizedArgs):
            raise ConfigError(_unknown(event.tokens, kind, name))
        if sentence := _mistake(event):
            raise ConfigError(f"{sentence}; `league {name} --help` says more")

    with mistakes.on_parse_error(refuse):
        return tyro.cli(
            kind,
            prog=f"league {name}",
            args=arguments,
            default=default,
            # Fields of a command's parts are flags of its own; what may be left out cannot be None.
            config=(tyro.conf.OmitArgPrefixes, tyro.conf.DisallowNone),
        )


def _unknown(tokens: list[str], kind: type, name: str) -> str:
    with redirect_stdout(io.StringIO()) as shown, suppress(SystemExit):
        parse(kind, name, ["--help"])
    flag = next((token.partition("=")[0] for token in tokens if token.startswith("-")), None)
    wrong = f"does not take {brief(tokens[0])}" if flag is None else f"has no flag {brief(flag)}"
    known = re.findall("• ([a-z]+) " if flag is None else "--[a-z][a-z-]*", shown.getvalue())
    known = sorted(set(known) - {"--help"})
    more = nearest_names(flag or tokens[0], known) if known else f"`league {name} --help` says more"
    return f"`league {name}` {wrong}; {more}"


def _mistake(event: mistakes.ParseErrorEvent) -> str | None:
    """Return what is wrong with a value, or None for what tyro itself explains."""
    match event:
        case mistakes.InvalidChoice(argument=argument, value=value, choices=choices):
            return f"{_flag(argument)} is {brief(value)}: give {' or '.join(choices)}"
        case mistakes.BadValue(argument=argument):
            return f"{_flag(argument)} needs {_expected(argument)}"
        case mistakes.InstantiationFailure(argument=argument, message=message) if argument:
            value = re.search(r"\[[^]]*\]|'.*'", message)  # in tyro's or Python's own message
            given = value[0] if value else "no such value"
            return f"{_flag(argument)} is {given[:80]}: give it {_expected(argument)}"
        case mistakes.MissingArgs(missing_arguments=[first, *_]):
            return f"{_flag(first.arg)} is missing"
        case mistakes.MissingSubcommand(subcommand_spec=choice):
            return f"it is not said what to do: give {' or '.join(choice.parser_from_name)}"
        case _:
            return None


def _flag(argument: Any) -> str:  # noqa: ANN401
    """Return how an argument is called on the command line."""
    lowered = argument.lowered
    return lowered.metavar.strip("[]") if argument.is_positional() else lowered.name_or_flags[0]


def _expected(argument: Any) -> str:  # noqa: ANN401
    """Return in words what an argument takes."""
    kinds = {"INT": "whole number", "FLOAT": "number", "PATH": "path"}
    taken = argument.lowered.metavar.split()
    word = kinds.get(taken[0], "value")
    return f"{len(taken)} {word}s" if len(taken) > 1 else f"a {word}"


def _parsed(arguments: list[str]) -> Any:  # noqa: ANN401
    if arguments[:1] == ["train"]:
        from league.cli import train

        return train.parse(arguments[1:])
    if (name := arguments[0]) not in COMMANDS:
        raise ConfigError(
            f"there is no command {brief(name)}; {nearest_names(name, list(COMMANDS))}; "
            "`league --help` says what each does"
        )
    return parse(command_class(name), name, arguments[1:])
