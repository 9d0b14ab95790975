"""`league token create`, `list` and `revoke`: secrets by which owners and workers are known."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Annotated, Literal

import tyro

from league import times
from league.cli import season, tables
from league.cli.season import OnLeague, Reading
from league.errors import ConfigError


@dataclass
class Create(OnLeague):
    """Make a token and print it, once: only its hash is kept."""

    owner: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="OWNER")]
    """The owner that it stands for: entries submitted with it are this owner's."""
    scope: tuple[Literal["submit", "worker", "admin"], ...] = ("submit",)
    """submit: enter and retire the owner's drivers; worker: race heats; admin: all of it, and
    retire anybody's drivers."""
    days: float = 365.0
    """It ends after so many days; 0 for never."""

    def run(self) -> None:
        if not 0 <= self.days < 1e6:
            raise ConfigError(f"--days {self.days:g}: give 0 (never) or more")
        life_s = 86400.0 * self.days or None
        with self.opened() as store:
            secret, token = store.tokens.create(self.owner, self.scope, life_s=life_s)
        print(secret)
        ends = times.day(token.expires_s) if token.expires_s else "never"
        print(
            f"Token {token.number} of {token.owner}: {', '.join(token.scopes)}; ends {ends}. It is "
            "shown only now; give it to its owner as LEAGUE_TOKEN."
        )


@dataclass
class List(Reading):
    """List all tokens, without their secrets."""

    def run(self) -> None:
        with self.opened() as store:
            tokens = store.tokens.listed()
        if self.json:
            season.print_json(tokens)
            return
        rows, now_s = [], time.time()
        for token in tokens:
            scopes, state = " ".join(token.scopes), token.state(now_s)
            ends, used = _day(token.expires_s), _day(token.used_s)
            rows.append((token.number, token.owner, scopes, state, ends, used))
        heads = ("number", "owner", "scopes", "state", "ends", "last used")
        tables.table("Tokens", heads, rows, "last used", "ends")


@dataclass
class Revoke(OnLeague):
    """End a token at once; entries made with it stay."""

    token: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="TOKEN")]
    """Its number, or the token itself."""

    def run(self) -> None:
        with self.opened() as store:
            token = store.tokens.revoke(self.token)
        print(f"Token {token.number} of {token.owner} is revoked.")


@dataclass
class ManageTokens:
    """Make, list or revoke the tokens by which owners and workers are known over HTTP."""

    command: (
        Annotated[Create, tyro.conf.subcommand("create")]
        | Annotated[List, tyro.conf.subcommand("list")]
        | Annotated[Revoke, tyro.conf.subcommand("revoke")]
    )


def _day(seconds: float | None) -> str:
    return "never" if seconds is None else times.day(seconds)[:10]
