"""`league cup`: begin a knock-out cup, and show its bracket."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from league import times
from league.cli import season, tables
from league.cli.season import Reading
from league.errors import ConfigError

if TYPE_CHECKING:
    from league.matchmaking.store import Cup, Store


@dataclass
class Cups(Reading):
    """Show a cup's bracket, or start a cup: qualifying, then knock-out heats of four."""

    action: Annotated[
        tyro.conf.Positional[Literal["show", "start"]], tyro.conf.arg(metavar="[ACTION]")
    ] = "show"
    """show or start. `league run` races a cup's heats before all others."""
    name: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="[NAME]")] = ""
    """Name (or number) of the cup; by default the last one, or the number of a new one."""
    anchors: bool = False
    """Let the league's own drivers take part in the cup that starts."""

    def run(self) -> None:
        """Run the command."""
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
            document = _document(store, cup)
        if self.json:
            season.print_json(document)
            return
        _print(document)


def _document(store: Store, cup: Cup) -> dict[str, Any]:
    from league.matchmaking import cups

    frozen = store.cup_document(cup.number)
    if frozen is not None:
        return frozen
    entries = {entry.id: entry for entry in store.entries()}
    return cups.document(cup, cups.bracket(store, cup), entries)


def _print(document: dict[str, Any]) -> None:
    for stage in document["stages"]:
        table = tables.table(f"{document['cup']['name']}: {stage['name']}", "heat", "driver", "")
        for heat in stage["heats"]:
            number = str(heat["number"] or "")
            for run in heat["runs"]:
                mark = " *" if run["advances"] else ""
                table.add_row(number, f"{run['name']}{mark}", _result(run, heat["state"]))
                number = ""
        tables.console().print(table)
    if document["order"]:
        print(f"Winner: {document['order'][0]['name']}   (* advanced)")
    else:
        print("Not over yet: `league run` races on.   (* advanced)")


def _result(run: dict[str, Any], state: str | None) -> str:
    """Return a lap, or places; before them what a heat waits for."""
    if run["lap_s"] is not None:
        return times.clock(run["lap_s"])
    if len(run["places"]) > 1:
        return "places " + " + ".join(map(str, run["places"]))
    if state == "done":
        return f"no lap, {run['distance']:.1f} m"
    given_up = state in ("error", "quarantined", "cancelled")
    return f"{state}: `league retry` races it" if given_up else state or "to be planned"


COMMANDS = {"cup": Cups}
