"""The command line, `league ...`: runs a command, and turns errors into one sentence."""

import os
import sys


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; return its exit code."""
    # Imports come later: Ctrl-C may be pressed while they last.
    try:
        return _answer(sys.argv[1:] if arguments is None else arguments)
    except (KeyboardInterrupt, RuntimeError) as error:
        # Python 3.11 turns what is raised while a class names its attributes into a RuntimeError.
        if not isinstance(error.__cause__ or error, KeyboardInterrupt):
            raise
        print("league: stopped.", file=sys.stderr)
        return 130


def _answer(arguments: list[str]) -> int:
    """Run the command line; return its exit code, and say in one sentence what was wrong."""
    from league.errors import LeagueError

    try:
        try:
            from league.cli import commands

            return commands.main(arguments)
        finally:
            if sys.stdout:  # None where it was closed before the start
                sys.stdout.flush()  # a full disk shows here, and not as Python ends
    except LeagueError as error:
        print(f"league: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        if error.filename is not None:
            raise
        # Nothing that is still held can be written, so it goes nowhere.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(error, BrokenPipeError):
            return 0  # the reader of our output has closed it (`league ... | head`)
        print(f"league: the output cannot be written ({error.strerror})", file=sys.stderr)
        return 2
