"""A league as it was at the end of one of its seasons, for reading."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import sqlalchemy as sa

from league.errors import StoreError
from league.matchmaking.store.records import (
    Cup,
    Drives,
    EntryState,
    HeatRecord,
    HeatState,
    LeagueEntry,
    LeagueSettings,
    Races,
    Season,
)
from league.matchmaking.store.schema import heats
from league.matchmaking.store.store import Store


class SeasonView(Store):
    """The heats of one season that is over, with the rules, entries and seasons of its end."""

    def __init__(self, store: Store, number: int) -> None:
        """Show a season of a league, over the league's own connections.

        Raises:
            StoreError: there is no such season, or it is not over.
        """
        vars(self).update(vars(store))
        known = store.seasons()
        document = store.season_document(number) if 0 < number <= len(known) else None
        if document is None:
            over = [str(one.number) for one in known if one.ended_s is not None]
            raise StoreError(
                f"this league has no season {number} that is over: "
                + (f"give {', '.join(over)}" if over else "none is over yet")
            )
        self.season = known[number - 1]
        self.rows: list[dict[str, Any]] = document["standings"]["entries"]
        """Its frozen standings, best first."""

    @property
    def settings(self) -> LeagueSettings:
        """The league's settings, with the rules of the season."""
        return replace(super().settings, ruleset=self.rulesets()[self.season.ruleset])

    def seasons(self) -> list[Season]:
        """Return the season and those before it."""
        return super().seasons()[: self.season.number]

    def cups(self) -> list[Cup]:
        """Return the cups of these seasons."""
        return [cup for cup in super().cups() if (cup.season or 0) <= self.season.number]

    def entries(self, states: Sequence[EntryState] | None = None) -> list[LeagueEntry]:
        """Return the entries that the league had then, those rated in the states they had."""
        state_of = {row["number"]: row["state"] for row in self.rows}
        ended_s = self.season.ended_s or 0.0
        found = [
            replace(entry, state=state_of.get(entry.number, entry.state), reason="")
            for entry in super().entries()
            if entry.created_s <= ended_s
        ]
        return [entry for entry in found if states is None or entry.state in states]

    def counts(self) -> dict[HeatState, int]:
        """Return how many heats of the season are done."""
        return {"done": self.num_done()}

    def heat_states(self, entry: int) -> dict[int, HeatState]:
        """Return the states of an entry's heats of the season; see QueueStore.heat_states."""
        states = super().heat_states(entry)
        within = self.season.has(np.array(list(states), int)).tolist()
        return {number: states[number] for number, kept in zip(states, within, strict=True) if kept}

    def races(
        self,
        ruleset: str | None = None,
        *,
        since: int = 0,
        rated: bool | None = True,
        entries: Sequence[int] = (),
    ) -> Races:
        """Return the races of the season; see Store.races."""
        races = super().races(ruleset, since=since, rated=rated, entries=entries)
        return races.where(self.season.has(races.heat))

    def drives(self, ruleset: str, *, since: int = 0) -> Drives:
        """Return how each car drove up to the end of the season; see Store.drives."""
        drives = super().drives(ruleset, since=since)
        return drives.where(drives.heat <= (self.season.until or 0))

    def _heats(
        self, match: sa.ColumnElement[bool], limit: int | None = None, *, newest: bool = False
    ) -> list[HeatRecord]:
        return super()._heats(self._within & match, limit, newest=newest)

    def _done(self, entry: int | None) -> sa.ColumnElement[bool]:
        return self._within & super()._done(entry)

    @property
    def _within(self) -> sa.ColumnElement[bool]:
        return (heats.c.number > self.season.after) & (heats.c.number <= (self.season.until or 0))
