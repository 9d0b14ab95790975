"""The commands of a league, and what they share: address, checks of flags, workers, JSON."""

from __future__ import annotations

import json
import os
from contextlib import closing
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from league.cli import lazy
from league.errors import ConfigError, brief

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

DEFAULT = "sqlite:///league.db"


@dataclass(kw_only=True)
class OnLeague:
    """A command that needs a league."""

    league: str = ""
    """Address of the league: sqlite:///FILE or postgresql://...; by default LEAGUE_URL, else
    sqlite:///league.db."""

    @property
    def address(self) -> str:
        """The league's address."""
        return self.league or os.environ.get("LEAGUE_URL", "") or DEFAULT

    def opened(self) -> lazy.store.Store:
        """Open the league; close it when done."""
        return lazy.store.Store(self.address)


@dataclass(kw_only=True)
class OnServer(OnLeague):
    """A command that also reaches a league that another machine serves."""

    to: str = ""
    """Address of a served league, such as https://league.example.org, instead of --league."""
    token: str = ""
    """Token for --to; by default the environment variable LEAGUE_TOKEN, which other users of this
    machine cannot read in the list of processes."""
    insecure: bool = False  # Let the token travel unencrypted (http://) to another machine.

    def client(self) -> lazy.remote.Client:
        """Return the served league."""
        secret = self.token or os.environ.get("LEAGUE_TOKEN", "")
        return lazy.remote.Client.of(self.to, secret.strip(), insecure=self.insecure)


@dataclass(kw_only=True)
class Reading(OnLeague):
    """A command that only reads a league."""

    json: bool = False  # Print JSON.


def at_least(command: DataclassInstance, name: str, least: int) -> None:
    """Refuse a field that is smaller than what makes sense."""
    value = getattr(command, name)
    if value is not None and value < least:
        raise ConfigError(f"--{name.replace('_', '-')} {value}: give {least} or more")


def share(text: str, flag: str) -> float:
    """Return the share that a flag gives in percent; refuse what is none."""
    try:
        number = float(text.strip().removesuffix("%")) / 100
    except ValueError:
        number = -1.0
    if not 0 <= number <= 1:
        raise ConfigError(f"{flag} {brief(text)} is no share: give percent, as in {flag} 2%")
    return number


def local_workers(
    num_workers: int, kind: Literal["processes", "ray"] = "processes"
) -> closing[lazy.workers.Executor]:
    """Start workers, one for each core if 0 were asked for; `with` ends them afterwards."""
    return closing(lazy.workers.make_executor(kind, num_workers or lazy.threads.processors()))


def print_json(value: object) -> None:
    """Print data as JSON."""
    print(json.dumps(lazy.documents.plain(value), indent=2, ensure_ascii=False))


def plus_minus(elo: float, low: float, high: float) -> str:
    """Return a rating with its 95 % interval."""
    return f"{elo:.0f} ±{(high - low) / 2:.0f}"
