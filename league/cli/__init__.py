"""The command line: `league ...`; the only wing that prints."""

from league.cli.parser import main

__all__ = ["main"]
