"""`league season`: begin and end seasons, list them with their trophies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from league import times
from league.cli import season, tables
from league.cli.season import Reading
from league.errors import ConfigError

if TYPE_CHECKING:
    from league.matchmaking.store import Store


@dataclass
class Seasons(Reading):
    """List the seasons; start one, or end it: its standings are frozen, its trophies given."""

    action: Annotated[
        tyro.conf.Positional[Literal["list", "start", "end"]], tyro.conf.arg(metavar="[ACTION]")
    ] = "list"
    """list, start or end. The first season has all heats so far, each other one those after the
    one before; ratings carry over, less sure, if the rules stay."""
    name: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="[NAME]")] = ""
    """Name of the season that starts; by default its number."""
    division_size: int = 20
    """Entries of a division, of the season that starts."""
    least_safety: float = 2.0
    """Safety rating, 0 to 5, that its top division asks for; 0 for none."""

    def run(self) -> None:
        """Run the command."""
        from league.matchmaking import seasons
        from league.matchmaking.divisions import SeasonSettings

        if self.name and self.action != "start":
            raise ConfigError(
                f"`league season {self.action}` takes no name, {self.name!r} was given: "
                "only `league season start` does"
            )
        with self.opened() as store:
            if self.action == "start":
                settings = SeasonSettings(self.division_size, self.least_safety)
                begun = seasons.start(store, self.name, settings)
                print(f"{begun.name} has begun: `league run` races it.")
                return
            if self.action == "end":
                ended = seasons.end(store)
                print(f"{ended.name} has ended; its standings have the hash {ended.hash[:16]}.")
                _print_trophies(store, ended.number)
                return
            self._list(store)

    def _list(self, store: Store) -> None:
        known = store.seasons()
        if self.json:
            documents = {one.number: store.season_document(one.number) for one in known}
            season.print_json([{"season": one, "frozen": documents[one.number]} for one in known])
            return
        if not known:
            print("This league has no seasons: all its races are one. `league season start` begins")
            print("the first one, which has all races so far, and `league season end` ends it.")
            return
        table = tables.table("Seasons", "", "season", "heats", "from", "to", "standings")
        for one in known:
            heats = f"{one.after + 1}-{one.until or ''}"
            ended = times.day(one.ended_s)[:10] if one.ended_s else "running"
            started = times.day(one.started_s)[:10]
            table.add_row(str(one.number), one.name, heats, started, ended, one.hash[:12])
        tables.console().print(table)
        for one in known:
            if one.ended_s:
                print(f"{one.name}:")
                _print_trophies(store, one.number)


def _print_trophies(store: Store, number: int) -> None:
    document = store.season_document(number) or {}
    for trophy in document.get("trophies", ()):
        where = f", heat {trophy['heat']}" if trophy["heat"] else ""
        print(f"  {trophy['title']}: {trophy['name']} ({trophy['value']}{where})")


COMMANDS = {"season": Seasons}
