"""`league season` and `league cup`: seasons with their trophies, and knock-out cups in them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import Positional, arg

from league import times
from league.cli import season, tables
from league.cli.season import Reading
from league.errors import ConfigError

if TYPE_CHECKING:
    from league.matchmaking.store import Season, Store


@dataclass
class Seasons(Reading):
    """List the seasons; start one, or end it: its standings are frozen, its trophies given."""

    action: Annotated[Positional[Literal["list", "start", "end"]], arg(metavar="[ACTION]")] = "list"
    """list, start or end. The first season has all heats so far, each other one those after the
    one before; ratings carry over, less sure, if the rules stay."""
    name: Annotated[Positional[str], arg(metavar="[NAME]")] = ""
    """Name of the season that starts; by default its number."""
    division_size: int = 20  # Entries of a division, of the season that starts.
    least_safety: float = 2.0  # Safety rating, 0 to 5, that its top division asks for; 0 for none.

    def run(self) -> None:
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
                _print_trophies(store, ended)
                return
            self._list(store)

    def _list(self, store: Store) -> None:
        known = store.seasons()
        if self.json:
            season.print_json([{"season": one, "frozen": store.frozen(one)} for one in known])
            return
        if not known:
            print("This league has no seasons: all its races are one. `league season start` begins")
            print("the first one, which has all races so far, and `league season end` ends it.")
            return
        rows = []
        for one in known:
            heats = f"{one.after + 1}-{one.until or ''}"
            ended = times.day(one.ended_s)[:10] if one.ended_s else "running"
            started = times.day(one.started_s)[:10]
            rows.append((one.number, one.name, heats, started, ended, one.hash[:12]))
        heads = ("", "season", "heats", "from", "to", "standings")
        tables.table("Seasons", heads, rows, "standings", "from")
        for one in known:
            if one.ended_s:
                print(f"{one.name}:")
                _print_trophies(store, one)


def _print_trophies(store: Store, over: Season) -> None:
    document = store.frozen(over) or {}
    for trophy in document.get("trophies", ()):
        where = f", heat {trophy['heat']}" if trophy["heat"] else ""
        print(f"  {trophy['title']}: {trophy['name']} ({trophy['value']}{where})")


@dataclass
class Cups(Reading):
    """Show a cup's bracket, or start a cup: qualifying, then knock-out heats of four."""

    action: Annotated[Positional[Literal["show", "start"]], arg(metavar="[ACTION]")] = "show"
    """show or start. `league run` races a cup's heats before all others."""
    name: Annotated[Positional[str], arg(metavar="[NAME]")] = ""
    """Name (or number) of the cup; by default the last one, or the number of a new one."""
    anchors: bool = False  # Let the league's own drivers take part in the cup that starts.

    def run(self) -> None:
        from league.matchmaking import cups

        if self.anchors and self.action != "start":
            raise ConfigError("--anchors is for `league cup start`: leave it out")
        with self.opened() as store:
            if self.action == "start":
                cup = cups.start(store, self.name, anchors=self.anchors)
                entrants = len(cup.settings["entrants"])
                print(f"{cup.name} has begun with {entrants} entrants: `league run` races it.")
                return
            cup = cups.named(store, self.name)
            document = store.frozen(cup)
            if document is None:
                entries = {entry.id: entry for entry in store.entries()}
                document = cups.document(cup, cups.bracket(store, cup), entries)
        if self.json:
            season.print_json(document)
        else:
            _print_bracket(document)


def _print_bracket(document: dict[str, Any]) -> None:
    for stage in document["stages"]:
        rows = []
        for heat in stage["heats"]:
            number = str(heat["number"] or "")
            for run in heat["runs"]:
                mark = " *" if run["advances"] else ""
                rows.append((number, f"{run['name']}{mark}", _outcome(run, heat["state"])))
                number = ""
        title = f"{document['cup']['name']}: {stage['name']}"
        tables.table(title, ("heat", "driver", ""), rows)
    if document["order"]:
        print(f"Winner: {document['order'][0]['name']}   (* advanced)")
    else:
        print("Not over yet: `league run` races on.   (* advanced)")


def _outcome(run: dict[str, Any], state: str | None) -> str:
    """Return a lap, or places; before them what a heat waits for."""
    if run["lap_s"] is not None:
        return times.clock(run["lap_s"])
    if len(run["places"]) > 1:
        return "places " + " + ".join(map(str, run["places"]))
    if state == "done":
        return f"no lap, {run['distance']:.1f} m"
    given_up = state in ("error", "quarantined", "cancelled")
    return f"{state}: `league retry` races it" if given_up else state or "to be planned"
