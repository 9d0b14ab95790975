"""`league init`, `submit`, `entries`, `retire`, `token`: a league, its entries and their owners."""

from __future__ import annotations

import getpass
import json
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from tyro.conf import Positional, arg, subcommand

from league import times
from league.atomic_file import replacing
from league.cli import lazy, season, tables
from league.cli.season import OnLeague, OnServer, Reading
from league.errors import ConfigError, PolicyError, StoreError, nearest_names
from league.flags import Unset
from league.sim import PHYSICS

ANCHORS = ("centerline", "racing_line", "cautious", "blocker")
"""Scripted drivers that a new league begins with; the first one is 1000."""

SAID = ("name", "owner", "id", "state", "near_copy_of")  # What is said of an entry.


@dataclass
class Init(OnLeague):
    """Make a league; its rules, on which all ratings depend, cannot be changed later."""

    name: str = "league"  # Name shown to people.
    track: tuple[str, ...] = ("reinvent_2018",)
    """Tracks that heats are drawn from (see `league tracks`)."""
    laps: int = 3  # Laps of each race.
    cars: int = 2  # Cars in each race, 2 to 8.
    solver: Literal["bullet", "planar"] = "bullet"  # Physics.
    sensors: Literal["stock", "any"] = "stock"
    """Stock mounts, lenses and rates only, or whatever a card asks for."""
    max_time_s: float = 0.0  # A race is stopped after this time [s]; 0 chooses by length.
    variation: float = 1.0
    """How much the cars of a race differ, drawn from its seed: 1 is two percent of grip."""
    rules: Literal["league", "deepracer"] = "league"
    """Who is to blame and what it costs: as docs/rules.md has it, or as in the original."""
    obstacles: int = 0  # Boxes or bots on the track.
    bots: bool = False  # Slow bot cars that change lanes instead of boxes.
    format: Literal["standing", "reverse", "qualifying", "pursuit"] = "standing"
    """How cars line up: standing, twice, with the grid swapped; reverse, the best rated last;
    qualifying, the best lap so far first; pursuit, spread evenly round the lap."""
    anchors: tuple[str, ...] = ANCHORS
    """Scripted drivers that tie the scale; the first one is pinned to 1000."""
    blobs: str = ""
    """Directory or bucket (s3://...) for weights and recordings; by default the database."""

    def run(self) -> None:
        rules = _rules(self)
        with lazy.store.create(
            self.address, name=self.name, ruleset=rules, blobs=self.blobs
        ) as store:
            lazy.matchmaker.enter_anchors(store, self.anchors)
            print(f"League {self.name!r}: {store.url}")
        parts = [times.counted(rules.laps, "lap"), f"{rules.cars} cars", *rules.tracks]
        parts += [rules.format] if rules.format != "standing" else []
        print(f"Rules {rules.hash[:12]}: {', '.join(parts)}")
        print(f"Anchors: {', '.join(self.anchors) or 'none'}")


@dataclass
class Submit(OnServer):
    """Submit a checkpoint; it is read here, and its weights are sent as plain numbers."""

    driver: Annotated[Positional[str], arg(metavar="DRIVER")]
    """A checkpoint (FILE.pt), or the name of a driver (see `league drivers`)."""
    name: str = ""  # Name shown to people; by default the file's.
    owner: Unset[str | None] = None
    """Its owner; by default your login name, and with --to the owner of the token. Entries of one
    owner do not meet."""
    download: bool = False  # Let everyone download the weights from the driver's page.

    def run(self) -> None:
        name = self.name or Path(self.driver).stem
        entered = self._sent(name) if self.to else self._entered(name)
        known, owner, id, state, model = (entered[key] for key in SAID)
        if state == "retired":
            raise StoreError(
                f"this driver was entered as {known} by {owner}, and retired: it cannot come back, "
                "submit another one"
            )
        if known != name:
            print(f"These weights are entered already, as {known}; {name} is not a new entry.")
        already = " is entered already" if known == name and not entered["new"] else ""
        print(f"{known} by {owner}{already}: entry {id[:12]}, {state}")
        if model:
            print(f"Its weights are nearly those of {model}: it is labelled a near-copy.")
        if self.download and entered["downloadable"] is not True:
            print("It cannot be downloaded: only a policy can, from its first submission on.")
        if state == "pending":
            follow = entered.get("page") or "`league run`, then `league entries`"
            print(f"It races itself and an anchor first: {follow}.")

    def _entered(self, name: str) -> dict[str, Any]:
        """Enter the driver here, and return what became of it."""
        owner = getpass.getuser() if self.owner is None else self.owner
        with self.opened() as store:
            before = {entry.id for entry in store.entries()}
            if self.driver not in lazy.roster.NAMES:
                path = lazy.roster.checkpoint_path(self.driver)
                entry = lazy.submission.submit(store, path, name, owner, download=self.download)
            else:
                entry = store.submit(name, owner, scripted=self.driver, card={"name": name})
        said = {key: getattr(entry, key) for key in (*SAID, "downloadable")}
        return {**said, "new": entry.id not in before}

    def _sent(self, name: str) -> dict[str, Any]:
        """Send the driver to a served league, and return what became of it."""
        client = self.client()
        if self.owner is not None:
            raise ConfigError("--owner with --to: the token says who the owner is, leave it out")
        sent = client.submit(_packed(self.driver), name, download=self.download)
        said = {key: tables.spelled(str(sent.get(key, ""))) for key in SAID}
        page = client.url + tables.spelled(str(sent.get("page", "")))
        # The answer to a new entry and to a pending one is the same.
        new = said["state"] == "pending"
        return {**said, "page": page, "downloadable": sent.get("downloadable"), "new": new}


@dataclass
class Pack:
    """Write a checkpoint as the file that a league's upload form takes: plain numbers and card."""

    driver: Annotated[Positional[str], arg(metavar="FILE.pt")]
    """A checkpoint, or the name of one (see `league drivers`)."""
    out: Unset[Path | None] = None
    """Where to write it; by default here, under the checkpoint's name, ending in .safetensors."""

    def run(self) -> None:
        content = _packed(self.driver)
        path = self.out or Path(f"{Path(self.driver).stem}.safetensors")
        with replacing(path, "the packed checkpoint", PolicyError) as file:
            file.write_bytes(content)
        print(f"{path}: {len(content):,} bytes")


def _packed(driver: str) -> bytes:
    """Return a checkpoint as the bytes of an entry."""
    if driver in lazy.roster.NAMES:
        raise ConfigError(
            f"{driver} is a scripted driver, which has no weights: give a checkpoint (FILE.pt)"
        )
    return lazy.submission.pack(lazy.checkpoint.load(lazy.roster.checkpoint_path(driver)))


@dataclass
class Entries(Reading):
    """List the entries and their states."""

    def run(self) -> None:
        with self.opened() as store:
            entries = lazy.matchmaker.entries_with_reasons(store)
        if self.json:
            return season.print_json(entries)
        rows = []
        for entry in entries:
            kind = "anchor" if entry.anchor else entry.kind
            submitted = times.day(entry.created_s)[:10]
            rows.append((entry.name, entry.owner, entry.state, entry.id[:8], kind, submitted))
        heads = ("name", "owner", "state", "id", "kind", "submitted")
        tables.table("Entries", heads, rows, "submitted", "id", "owner")
        for entry in entries:
            if entry.reason:
                print(f"{entry.name} is {entry.state}: {tables.spelled(entry.reason)}")
            if entry.near_copy_of:
                print(f"{entry.name} is nearly a copy of {entry.near_copy_of}.")


@dataclass
class Retire(OnServer):
    """Take an entry out of the league; its results stay, and there is no way back."""

    entry: Annotated[Positional[str], arg(metavar="ENTRY")]  # Name or id.
    reason: str = ""  # Why, for people to read.
    yes: bool = False  # Do not ask first.

    def run(self) -> int:
        if self.to:
            client, asked = self.client(), {"entry": self.entry, "reason": self.reason}
            if not self.yes and not _confirmed(f"{self.entry} at {self.to}"):
                print(f"{self.entry} stays as it is.")
                return 1
            sent = client.ask("/api/v1/entries/retire", json.dumps(asked).encode())
            name, changed = tables.spelled(str(sent.get("name", ""))), bool(sent.get("changed"))
        else:
            with self.opened() as store:
                entry = store.entry(self.entry)
                name, what = entry.name, f"{entry.name} by {entry.owner} ({entry.state})"
                if not self.yes and entry.state != "retired" and not _confirmed(what):
                    print(f"{name} stays {entry.state}.")
                    return 1
                changed = bool(
                    store.move({entry.id: "retired"}, reason=self.reason, actor=entry.owner)
                )
        print(f"{name} {'is retired' if changed else 'was retired already'}.")
        return 0


@dataclass
class Upgrade(OnLeague):
    """Bring the tables of a league that an older version made up to date; make a backup first."""

    physics: bool = False
    """Also race with this program's physics from now on: heats that wait are cancelled, and ratings
    begin again, because results of different physics cannot be compared."""

    def run(self) -> None:
        for step in lazy.store.upgrade(self.address):
            print(step)
        with self.opened() as league:
            rules = league.settings.ruleset
            if rules.physics != PHYSICS and not self.physics:
                print(
                    f"Its races were driven with physics {rules.physics}, and this program has "
                    f"{PHYSICS}: `league upgrade --physics` lets it go on, with ratings that begin "
                    "again."
                )
            elif rules.physics != PHYSICS:
                cancelled = league.set_ruleset(replace(rules, physics=PHYSICS))
                print(
                    f"Races are driven with physics {PHYSICS} now, no longer {rules.physics}: "
                    f"ratings begin again. Cancelled: {times.counted(cancelled, 'waiting heat')}."
                )
            print(f"The league in {league.url} is up to date.")


def _confirmed(what: str) -> bool:
    """Ask whether an entry is to be retired."""
    if not sys.stdin.isatty():
        raise ConfigError(
            f"{what} cannot come back once it is retired, and there is no terminal to ask on: "
            "confirm with --yes"
        )
    question = f"Retire {what}? There is no way back [y/N] "
    return input(question).strip().lower() in ("y", "yes")


def _rules(command: Init) -> lazy.heat_spec.Ruleset:
    """Return the rules that were asked for, checked before anything is written."""
    if not command.name.strip():
        raise ConfigError("the league was given no name: name it, as in --name club")
    for name in command.anchors:
        if name not in lazy.roster.NAMES:
            nearest = nearest_names(name, list(lazy.roster.NAMES))
            raise ConfigError(f"there is no scripted driver {name!r}; {nearest}")
    if command.bots and not command.obstacles:
        raise ConfigError("--bots means nothing without --obstacles: give both, or neither")
    from league.sim.config import MAX_CARS  # late: NumPy takes a while

    if not 2 <= command.cars <= MAX_CARS:
        raise ConfigError(
            f"--cars {command.cars}: a league's races have 2 to {MAX_CARS} cars, give --cars 2"
        )
    for names in (command.track, command.anchors):
        if len(set(names)) < len(names):
            raise ConfigError("a track or an anchor was named twice: name each once")
    tracks = []
    for name in command.track:
        track = lazy.files.load(name)
        if name != track.name:
            raise ConfigError(
                f"the track {name!r} is a file: a league's workers know the tracks that ship "
                "with the program, `league tracks` lists them"
            )
        if command.format == "pursuit" and not track.closed:
            raise ConfigError(
                f"{name} is an open track, and the cars of a pursuit start round a lap: "
                "choose closed tracks, or another --format"
            )
        tracks.append(track.name)
    try:
        rules = lazy.heat_spec.Ruleset
        given = {name: vars(command)[name] for name in vars(command).keys() & vars(rules())}
        kind = "bot" if command.bots else "box"
        return rules(**given, tracks=tuple(tracks), obstacle_kind=kind)
    except ValueError as error:
        raise ConfigError(f"these rules are not possible: {error}") from error


@dataclass
class Create(OnLeague):
    """Make a token and print it, once: only its hash is kept."""

    owner: Annotated[Positional[str], arg(metavar="OWNER")]
    """The owner that it stands for: entries submitted with it are this owner's."""
    scope: tuple[Literal["submit", "worker", "admin"], ...] = ("submit",)
    """submit: enter and retire the owner's drivers; worker: race heats; admin: all of it, and
    retire anybody's drivers."""
    days: float = 365.0  # It ends after so many days; 0 for never.

    def run(self) -> None:
        if not 0 <= self.days < 1e6:
            raise ConfigError(f"--days {self.days:g}: give 0 (never) or more")
        life_s = 86400.0 * self.days or None
        with self.opened() as store:
            secret, token = store.tokens.create(self.owner, self.scope, life_s=life_s)
        print(secret)
        ends = times.day(token.expires_s) or "never"
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
            return season.print_json(tokens)
        rows, now_s = [], time.time()
        for token in tokens:
            days = (times.day(one)[:10] or "never" for one in (token.expires_s, token.used_s))
            scopes = " ".join(token.scopes)
            rows.append((token.number, token.owner, scopes, token.state(now_s), *days))
        heads = ("number", "owner", "scopes", "state", "ends", "last used")
        tables.table("Tokens", heads, rows, "last used", "ends")


@dataclass
class Revoke(OnLeague):
    """End a token at once; entries made with it stay."""

    token: Annotated[Positional[str], arg(metavar="TOKEN")]  # Its number, or the token itself.

    def run(self) -> None:
        with self.opened() as store:
            token = store.tokens.revoke(self.token)
        print(f"Token {token.number} of {token.owner} is revoked.")


@dataclass
class ManageTokens:
    """Make, list or revoke the tokens by which owners and workers are known over HTTP."""

    command: (
        Annotated[Create, subcommand("create")]
        | Annotated[List, subcommand("list")]
        | Annotated[Revoke, subcommand("revoke")]
    )
