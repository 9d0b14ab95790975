"""Plain data of a league's standings, entries and heats, for `--json` and for the web."""

from collections.abc import Mapping, Sequence
from typing import Any

from pydantic_core import to_jsonable_python

from league.matchmaking.scores import pole
from league.matchmaking.standings import Standings
from league.matchmaking.store import HeatRecord, LeagueEntry

FIT_FIELDS = ("chi_square", "freedom", "p_value", "rejected")  # numbers of the test of fit


def plain(value: object) -> Any:  # noqa: ANN401
    """Return frozen data as JSON knows it; infinities and NaN become null."""
    return to_jsonable_python(value, inf_nan_mode="null")


def names_of(entries: Sequence[LeagueEntry]) -> dict[str, str]:
    """Return the names of entries by their ids."""
    return {entry.id: entry.name for entry in entries}


def standings_document(rated: Standings, top: int | None = None) -> dict[str, object]:
    """Return the standings, how well they explain the results, and all entries or the `top`."""
    return {
        "ruleset": rated.ruleset,
        "races": rated.num_races,
        "prior_sd": rated.ratings.prior_sd,
        "slot_advantages": rated.ratings.slot_advantages.tolist(),
        "pole": plain(pole(rated)),
        "fit": {name: getattr(rated.goodness, name) for name in FIT_FIELDS},
        "entries": plain(rated.rows[:top]),
    }


def heat_document(record: HeatRecord, names: Mapping[str, str]) -> dict[str, object]:
    """Return a heat without its results."""
    return {
        "number": record.number,
        "key": record.heat.key,
        "purpose": record.heat.purpose,
        "state": record.state,
        "races": [
            {"track": half.track, "grid": [names[id] for id in half.grid]}
            for half in record.heat.halves
        ],
        "seeds": record.seeds,
        "worker": record.worker,
        "attempts": record.attempts,
        "traceback": record.traceback,
        "audits": record.heat.audits,
        "claimed_s": record.claimed_s,
        "done_s": record.done_s,
    }
