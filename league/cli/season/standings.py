"""`league standings`, `show`, `h2h`, `history`, `season`, `cup`: who is how good, who has won."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import permutations
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import Positional, arg

from league import times
from league.cli import lazy, season, tables
from league.cli.season import Reading
from league.errors import ConfigError, StoreError
from league.flags import Unset

if TYPE_CHECKING:
    from rich.console import RenderableType

    from league.matchmaking.standings import Standings
    from league.matchmaking.store import LeagueEntry, Season, Store

NAMES_WIDTH, CELL_WIDTH = 18, 8  # Of the matrix of all against all, with the gaps between columns.


@dataclass
class ShowStandings(Reading):
    """Rate all entries from all races, and print the table."""

    top: Unset[int | None] = None  # Only so many.

    def run(self) -> None:
        season.at_least(self, "top", 1)
        with self.opened() as store:
            rated = lazy.standings.of(store)
        if self.json:
            return season.print_json(lazy.documents.standings_document(rated, self.top))
        tables.console().print(standings_table(rated, self.top))
        for line in _notes(rated):
            print(line)


@dataclass
class ShowEntry(Reading):
    """Show an entry: rating, record against each opponent, last heats."""

    entry: Annotated[Positional[str], arg(metavar="ENTRY")]  # Name or id.

    def run(self) -> None:
        with self.opened() as store:
            entry = store.entry(self.entry)
            recent = store.heats(entries=[entry.number])[-10:]
            try:
                rated = lazy.standings.of(store)
                row = rated.row(entry.number)
                others = lazy.standings.records(rated, entry.number)
            except StoreError:  # it is not rated yet
                row, others = None, []
        if self.json:
            records = [
                {"name": other.name, **lazy.documents.plain(record)} for other, record in others
            ]
            heats = [{"number": heat.number, "state": heat.state} for heat in recent]
            document = {"entry": entry, "standing": row, "against": records, "heats": heats}
            return season.print_json(document)
        print(f"{entry.name} by {entry.owner}   {entry.id}")
        reason = f", {tables.spelled(entry.reason)}" if entry.reason else ""
        print(f"{entry.state}{reason}, {'anchor' if entry.anchor else entry.kind}")
        if row is not None:
            rating = season.plus_minus(row.elo, row.low95, row.high95)
            print(
                f"rank {row.rank} ({row.best_rank} to {row.worst_rank}), Elo {rating}, "
                f"{row.races} races, score {100 * row.score:.0f} %"
            )
            if row.unfinished is not None:
                clean, best = _laps(row.clean_laps_s), _laps(row.best_laps_s)
                print(f"not finished: {100 * row.unfinished:.0f} %, best clean lap: {clean}")
                print(f"fastest complete lap, penalties included: {best}")
        rows = []
        for other, record in others:
            points = f"{record.points:g}", f"{record.expected:.1f}", f"{record.residual:+.1f}"
            rows.append((other.name, other.owner, f"{other.elo:.0f}", record.races, *points))
        heads = ("entry", "owner", "Elo", "races", "points", "promised", "residual")
        if others:
            tables.table("Against", heads, rows, "owner", "promised")
        print("Last heats: " + (", ".join(f"{h.number} ({h.state})" for h in recent) or "none"))


@dataclass
class ShowHeadToHead(Reading):
    """Compare two entries: who is stronger, how sure that is, and their meetings.

    Without names: all of the best ones against each other, and where the ratings miss something.
    """

    one: Annotated[Positional[str], arg(metavar="[A]")] = ""  # Name or id.
    other: Annotated[Positional[str], arg(metavar="[B]")] = ""  # Name or id.
    top: int = 8
    """Largest size of the matrix, where no names are given; less where there is no space."""

    def run(self) -> None:
        season.at_least(self, "top", 2)
        if self.one and not self.other:
            raise ConfigError(
                f"only {self.one!r} was given: name two entries to compare them, or none for the "
                "matrix of the best"
            )
        with self.opened() as store:
            if self.one:
                _h2h(store, store.entry(self.one), store.entry(self.other), self.json)
            else:
                _matrix(store, self.top, self.json)


@dataclass
class ShowHistory(Reading):
    """Show how an entry's rating came about."""

    entry: Annotated[Positional[str], arg(metavar="ENTRY")]  # Name or id.
    points: int = 20  # How many moments.

    def run(self) -> None:
        season.at_least(self, "points", 1)
        with self.opened() as store:
            entry = store.entry(self.entry)
            moments = lazy.scores.history(store, entry, points=self.points)
        if self.json:
            return season.print_json(moments)
        rows = []
        for moment in moments:
            elo = season.plus_minus(moment.elo, moment.low95, moment.high95)
            between = f"{moment.low95:.0f} to {moment.high95:.0f}"
            rows.append((moment.heat, moment.races, elo, between))
        tables.table(f"{entry.name} over time", ("heat", "races", "Elo, 95 %", "between"), rows)


def standings_table(rated: Standings, limit: int | None = None) -> RenderableType:
    """Return the standings as a table that fits the terminal."""
    shown = rated.rows[:limit]
    flags = ["*" * row.anchor + "!" * row.one_sided + "~" * (not row.connected) for row in shown]
    most = max(map(len, flags), default=0)
    rows = []
    for row, flag in zip(shown, flags, strict=True):
        elo = f"{row.elo:.0f} ±{(row.high95 - row.low95) / 2:<3.0f} {flag:{most}}"
        unfinished = "" if row.unfinished is None else f"{100 * row.unfinished:.0f}%"
        # On the first track: laps of several are not alike.
        lap_s = row.clean_laps_s.get(rated.tracks[0]) if rated.tracks else None
        lap = "" if lap_s is None else times.clock(lap_s)
        ranks = f"{row.best_rank}-{row.worst_rank}" if row.best_rank < row.worst_rank else ""
        rating = elo, f"{row.listed_by:.0f}", row.state
        rows.append((row.rank, row.name, row.owner, *rating, row.races, unfinished, lap, ranks))
    heads = (
        "", "entry", "owner", "Elo ± 95 %", "by", "state", "races", "DNF", "clean lap", "ranks",
    )  # fmt: skip
    return tables.fitted("Standings", heads, rows, ("owner", "ranks", "DNF", "clean lap", "races"))


def _notes(rated: Standings) -> list[str]:
    """Return the lines that explain the table."""
    front = rated.ratings.slot_advantages
    pole = lazy.scores.pole(rated)
    lines = [
        f"{rated.num_races} races under rules {rated.ruleset[:12]}; the front of the grid is worth "
        f"{front[0] - front[-1]:+.0f} Elo over its end.",
    ]
    if pole:
        lines.append(
            f"Pole: {100 * pole.won:.0f} % of {pole.races} races were won from it "
            f"({100 * pole.low95:.0f} to {100 * pole.high95:.0f}; {100 * pole.even:.0f} if "
            f"slots decided nothing), worth {pole.elo:+.0f} Elo "
            f"({pole.elo_low95:+.0f} to {pole.elo_high95:+.0f}) over the mean slot."
        )
    lines += [
        "by: what the table is sorted by, Elo, or Elo - 2 sd while that is above 50 (or ~)",
        "* anchor, one of the league's own drivers   ! won or lost every pair",
        "ranks: those the races allow   DNF: races not finished",
        "clean lap: the fastest one of a race without a mistake",
    ]
    if len(rated.tracks) > 1:
        lines.append(f"clean lap: on {rated.tracks[0]}; `league show ENTRY` shows those on others")
    if not all(row.connected for row in rated.rows):
        lines.append("~ no chain of races leads to the anchor; such ratings lean on the prior.")
    if rated.goodness.rejected:
        lines.append(
            "One number a driver does not explain these results (p = "
            f"{rated.goodness.p_value:.1g}): `league h2h` shows who beats which other."
        )
    return lines


def _laps(laps_s: Mapping[str, float]) -> str:
    """Return laps [s] by their tracks."""
    return ", ".join(f"{times.clock(lap_s)} on {one}" for one, lap_s in laps_s.items()) or "none"


def _h2h(store: Store, one: LeagueEntry, other: LeagueEntry, as_json: bool) -> None:
    if one.id == other.id:
        raise StoreError(f"{one.name!r} was given twice: name two entries")
    rated = lazy.standings.of(store)
    for entry in (one, other):
        rated.row(entry.number, entry.name)
    gap = rated.ratings.difference(one.number, other.number)
    record = lazy.standings.head_to_head(rated, one.number, other.number)
    heats = [heat.number for heat in store.heats(("done",), entries=[one.number, other.number])]
    if as_json:
        document = {"one": one.name, "other": other.name, "difference": gap, "record": record}
        return season.print_json({**document, "heats": heats})
    print(f"{one.name} - {other.name}: {gap.elo:+.0f} Elo ({gap.low95:+.0f} to {gap.high95:+.0f})")
    print(f"{one.name} is the stronger one with probability {gap.sureness}")
    print(
        f"{record.races} races: {record.wins} won, {record.ties} tied, "
        f"{record.races - record.wins - record.ties} lost; {record.expected:.1f} points were "
        f"promised, residual {record.residual:+.1f}"
    )
    print("Heats: " + (", ".join(map(str, heats[-20:])) or "none"))


def _matrix(store: Store, top: int, as_json: bool) -> None:
    rated = lazy.standings.of(store)
    rows = rated.rows[: min(top, max(2, (tables.console().width - NAMES_WIDTH) // CELL_WIDTH))]
    documents, cells = [], {(row.rank, row.rank): "" for row in rows}
    for one, other in permutations(rows, 2):
        record = lazy.standings.head_to_head(rated, one.number, other.number)
        mark = "*" if abs(record.residual) > 3 else ""
        met = f"{record.points:g}/{record.races}\n{record.residual:+.1f}{mark}"
        cells[one.rank, other.rank] = met if record.races else ""
        if one.rank < other.rank:
            names = {"one": one.name, "other": other.name, "points": record.points}
            documents.append(names | lazy.documents.plain(record))
    if as_json:
        return season.print_json(documents)
    lines = [(row.rank, row.name, *(cells[row.rank, one.rank] for one in rows)) for row in rows]
    tables.table("Head to head", ("", "entry", *(str(row.rank) for row in rows)), lines)
    print("points of races; below: (points - promised) / standard deviation, * beyond 3")
    if rated.goodness.rejected:
        print("One number a driver does not explain these results: see `league standings`.")


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
        if self.name and self.action != "start":
            raise ConfigError(
                f"`league season {self.action}` takes no name, {self.name!r} was given: "
                "only `league season start` does"
            )
        with self.opened() as store:
            if self.action == "start":
                settings = lazy.divisions.SeasonSettings(self.division_size, self.least_safety)
                begun = lazy.seasons.start(store, self.name, settings)
                print(f"{begun.name} has begun: `league run` races it.")
                return
            if self.action == "end":
                ended = lazy.seasons.end(store)
                print(f"{ended.name} has ended; its standings have the hash {ended.hash[:16]}.")
                _print_trophies(store, ended)
                return
            self._list(store)

    def _list(self, store: Store) -> None:
        known = store.seasons()
        if self.json:
            return season.print_json(
                [{"season": one, "frozen": store.frozen(one)} for one in known]
            )
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
        if self.anchors and self.action != "start":
            raise ConfigError("--anchors is for `league cup start`: leave it out")
        with self.opened() as store:
            if self.action == "start":
                cup = lazy.cups.start(store, self.name, anchors=self.anchors)
                entrants = len(cup.settings["entrants"])
                print(f"{cup.name} has begun with {entrants} entrants: `league run` races it.")
                return
            cup = lazy.cups.named(store, self.name)
            document = store.frozen(cup)
            if document is None:
                entries = {entry.id: entry for entry in store.entries()}
                document = lazy.cups.document(cup, lazy.cups.bracket(store, cup), entries)
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
