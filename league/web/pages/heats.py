"""Heats: the home page, the newest ones, what races now, and all about one of them."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field

from league import times
from league.matchmaking.documents import heat_document
from league.matchmaking.store import DoneHeat, HeatRecord, RaceOutcome, StoredResult
from league.race_spec import RaceResult
from league.replay import Replay
from league.web import charts
from league.web.reader import Document, NotFoundError, Reader, accepted, heat_number, paging
from league.web.replay_data import events, player_data

_Contest = tuple[int, float, int, str]
"""Passes less crashes of a race, minus its gap at the end [s], its heat, and its number in it."""
RECENT = 60
"""Newest heats that are listed, and among which the most contested race is looked for."""
TOP = 8
"""Entries of the standings on the home page."""
LISTED = 6
"""Heats that are racing, and newest results, on the home page at most."""
WINDOW_S = 300.0
"""Time over which heats per minute are counted [s]."""
COUNTED = 1000
"""Newest heats among which they are counted."""
LISTED_LIVE = 20
"""Heats of each list of what races now, at most."""
FAULT_WORDS = {
    "off_track": "off",
    "crash": "contact",
    "touch": "light contact",
    "forced_off": "pushed off",
    "obstacle_contact": "obstacle",
    "wall_contact": "wall",
    "immobilised": "stuck",
    "reversed": "backwards",
}
"""Kinds of events that are the car's own fault, in the words of the page."""
UNPENALISED = ("touch", "wall_contact")
"""Kinds of which the value is no penalty."""


def home(reader: Reader) -> Document:
    """Return the most contested recent race, the standings' top, what races, newest results."""
    now, counts = reader.snapshot(), reader.counts()
    rated = now.rated
    featured = _most_contested(reader)
    return {
        "rules": reader.rules(),
        "counts": counts,
        "races": rated.num_races if rated else 0,
        "featured": summary(reader, *featured) if featured else None,
        "scale": charts.interval_scale(rated.rows) if rated else None,
        "rows": rated.rows[:TOP] if rated else (),
        "entries": len(now.entries),
        "running": [
            heat_document(one, reader.names)
            for one in reader.store.heats(("claimed",), limit=LISTED)
        ],
        "newest": reader.listed(reader.newest(LISTED)),
    }


def _most_contested(reader: Reader) -> tuple[int, str] | None:
    """Return the number of a heat and of its race with the most passes, then the closest one.

    Crashes count against it: a slow car that is hit again and again is no fight.
    """
    rated = [one.number for one in reader.newest(RECENT) if one.heat.purpose == "rated"]
    before: dict[int, list[_Contest]] = reader.kept("contests", dict)
    new = reader.store.results(*(number for number in rated if number not in before))
    contests = {number: before.get(number, []) for number in rated}
    for result in new:
        if result.replay and not result.rejected:
            contests[result.heat] = [*contests[result.heat], _contest(result)]
    reader.keep("contests", contests)
    most = max((one for own in contests.values() for one in own), default=None)
    return most[2:] if most else None


def _contest(result: StoredResult) -> _Contest:
    order = result.result["order"]
    fights = result.result["lead_changes"] + sum(car["overtakes"] - car["crashes"] for car in order)
    finished = [car["total_s"] for car in order if car["finished"]]
    gap_s = finished[1] - finished[0] if len(finished) > 1 else 1e6
    return int(fights), -float(gap_s), result.heat, str(result.half + 1)


def feed(reader: Reader) -> Document:
    """Return the newest heats that are done, the last one first."""
    return {"heats": reader.listed(reader.newest(RECENT))}


def heats(reader: Reader, driver: str = "", season: str = "", page: str = "") -> Document:
    """Return a page of the heats that are done, the newest first, of all, a `driver` or a `season`.

    Those of a driver tell how it did in each race.
    """
    store = reader.store
    entry = reader.entry(heat_number(driver, "driver")) if driver else None
    of = entry.number if entry else None
    chosen = reader.season(season) if season else None
    counts = reader.counts()
    count = store.num_done(of, chosen) if entry or chosen else counts.get("done", 0)
    asked = {name: text for name, text in (("driver", driver), ("season", season)) if text}
    lines, paged = paging(count, page, "heats", "/heats", asked)
    records = store.done(entry=of, season=chosen, skip=lines.start, limit=lines.stop - lines.start)
    row = reader.snapshot().rows.get(of or 0)
    return {
        "heats": reader.listed(records, of=entry),
        "counts": counts,
        "count": count,
        "driver": entry,
        "season": chosen,
        "races": row.races if row else 0,
        **paged,
    }


def live(reader: Reader) -> Document:
    """Return the running heats, the queue, the workers, the pace, and what needs attention."""
    store, now_s, names = reader.store, time.time(), reader.names
    counts, running = reader.counts(), store.heats(("claimed",))
    newest = reader.newest(LISTED_LIVE)
    done = [one for one in store.newest_done(COUNTED) if now_s - (one.done_s or 0.0) < WINDOW_S]
    finished = [one for one in newest if now_s - (one.done_s or 0.0) < WINDOW_S]
    per_minute = 60 * len(done) / WINDOW_S

    def listed(records: Sequence[HeatRecord]) -> list[Document]:
        return [heat_document(record, names) for record in records[:LISTED_LIVE]]

    return {
        "newest": _newest(reader, [*running[:LISTED], *newest]),
        "counts": counts,
        "per_minute": per_minute,
        "wait_minutes": counts.get("planned", 0) / per_minute if per_minute else None,
        "running": listed(running),
        "progress": {one.number: reader.progress(one) for one in running[:LISTED_LIVE]},
        "queue": listed(store.heats(("planned",), limit=LISTED_LIVE)),
        "workers": _workers(running, done),
        "finished": reader.listed(finished),
        "troubled": listed(store.heats(("error", "quarantined"))[::-1]),
        "joining": [
            {"number": entry.number, "name": entry.name, "state": entry.state}
            for entry in store.entries(("pending", "validating"))
        ],
        "window_s": WINDOW_S,
    }


def _newest(reader: Reader, records: Sequence[HeatRecord]) -> Document | None:
    """Return the first race of the first of some heats that can be watched."""
    for record in records:
        found = summary(reader, record.number)
        if found["shown"]:
            return found
    return None


def _workers(running: Sequence[HeatRecord], done: Sequence[DoneHeat]) -> list[Document]:
    """Return who raced lately, or does: heats under way, heats done, when the last one was."""
    names = sorted({one.worker for one in (*running, *done) if one.worker})
    return [
        {
            "name": name,
            "racing": sum(one.worker == name for one in running),
            "done": sum(one.worker == name for one in done),
            "last_s": max((one.done_s or 0.0 for one in done if one.worker == name), default=None),
        }
        for name in names
    ]


def heat(reader: Reader, number: int, race: str = "", lap: str = "") -> Document:
    """Return a heat, and all about one of its races, by default the first; see PAGES."""
    at = _race(reader, number, race)
    order = at.result.result["order"] if at.result else []
    laps_s = [one for car in order for one in car["lap_times_s"]]
    laps = max((len(car["lap_times_s"]) for car in order), default=0)
    if lap and lap not in map(str, range(1, laps + 1)):
        raise NotFoundError(f"This race has {times.counted(laps, 'lap')}, and no lap {lap[:20]!r}.")
    shown, replay = _summary(reader, at), at.replay
    names = [car["name"] for car in shown["cars"]]
    drawn = _drawn(reader, at)
    wrong = drawn.faults if drawn else []
    return {
        **shown,
        "progress": reader.progress(at.record),
        "queue": reader.counts().get("planned", 0) if not at.result else 0,
        "seed": at.record.seeds[at.half] if at.record.seeds else None,
        "ruleset": at.record.heat.ruleset,
        "best_lap_s": min(laps_s, default=None),
        "positions": charts.position_chart(order, names) if laps else None,
        "gaps": drawn.gaps if drawn else None,
        "laps": laps,
        "faults": wrong,
        "lap_rows": max([laps, *map(len, wrong)]),
        "lap": int(lap) if lap else None,
        "compared": _compared(reader, at, int(lap) if lap else None),
        "events": drawn.events if drawn else [],
        **_proof(reader, at),
        "spec": replay.spec.model_dump(exclude={"entries"}) if replay else None,
        "physics": replay.physics if replay else None,
        "league_version": replay.league_version if replay else None,
    }


def summary(reader: Reader, number: int, race: str = "") -> Document:
    """Return a heat, and the cars, the map and the classification of one of its races."""
    return _summary(reader, _race(reader, number, race))


def result(reader: Reader, number: int, race: int) -> StoredResult:
    """Return the result of a race that was raced."""
    reader.record(number)
    found = accepted(reader.store.results(number), race - 1)
    if found is None:
        raise NotFoundError(f"Heat {number} has no result of a race {race}.")
    return found


def recording(reader: Reader, number: int, race: int) -> str:
    """Return the hash of a race's recording."""
    digest = result(reader, number, race).replay
    if not digest:
        raise NotFoundError(f"Heat {number} has no recording of a race {race}.")
    return digest


def replay(reader: Reader, number: int, race: int) -> Document:
    """Return what the player draws of a race, as far as it has come."""
    if shown := reader.shown(reader.record(number), race - 1):
        return player_data(shown, over=False)
    digest = recording(reader, number, race)
    return reader.kept(("player", digest), lambda: player_data(reader.replay(digest)))


def one_file(reader: Reader, number: int, race: int) -> Document:
    """Return what a file needs that plays a race without a server."""
    return {**summary(reader, number, str(race)), "player_data": replay(reader, number, race)}


@dataclass(frozen=True)
class _Race:
    record: HeatRecord
    half: int
    """Number of the race, from 0."""
    results: list[StoredResult]
    """Of all races of the heat."""
    result: StoredResult | None
    replay: Replay | None
    shown: Replay | None
    """The recording so far, while it is being raced."""


def _race(reader: Reader, number: int, race: str) -> _Race:
    record = reader.record(number)
    valid = [str(half + 1) for half in range(len(record.heat.halves))]
    if (race or "1") not in valid:
        raise NotFoundError(f"Heat {number} has no race {race[:20]!r}, only {' and '.join(valid)}.")
    half = int(race or "1") - 1
    results = reader.store.results(number)
    result = accepted(results, half)
    replay = reader.replay(result.replay) if result and result.replay else None
    shown = reader.shown(record, half) if result is None else None
    return _Race(record, half, results, result, replay, shown)


def _summary(reader: Reader, at: _Race) -> Document:
    race, drawn = at.record.heat.halves[at.half], _drawn(reader, at)
    cars = [reader.entry_of(id) for id in race.grid]
    return {
        "heat": heat_document(at.record, reader.names),
        "race": at.half + 1,
        "track": race.track,
        "cars": [
            {"number": slot, "entry": entry.number, "name": entry.name}
            for slot, entry in enumerate(cars, 1)
        ],
        "result": at.result.result if at.result else None,
        "places": at.result.places if at.result else (),
        "recording": at.result.replay if at.result else None,
        "shown": bool(at.replay or at.shown),
        "map": drawn.map if drawn else charts.track_map(at.shown.track) if at.shown else None,
    }


@dataclass(frozen=True)
class _Drawn:
    """What follows from a recording alone."""

    map: charts.TrackMap
    gaps: charts.Chart
    faults: list[list[LapFaults]]
    events: list[dict[str, object]]


def _drawn(reader: Reader, at: _Race) -> _Drawn | None:
    if at.replay is None or at.result is None:
        return None
    replay = at.replay
    return reader.kept(
        ("drawn", at.result.replay),
        lambda: _Drawn(
            map=charts.track_map(replay.track),
            gaps=charts.gap_chart(replay),
            faults=faults_by_lap(replay.result),
            events=events(replay),
        ),
    )


def _compared(reader: Reader, at: _Race, lap: int | None) -> charts.ComparedLaps | None:
    """Return a lap (from 1) of each car over each other, by default each one's best."""
    if at.replay is None or at.result is None:
        return None
    replay = at.replay
    key = ("compared", at.result.replay, lap)
    return reader.kept(key, lambda: charts.compared_laps(replay, lap))


def _proof(reader: Reader, at: _Race) -> Document:
    """Return what speaks for a result: its hash, who raced it, and whether others found it, too."""
    record, results, result = at.record, at.results, at.result
    numbers = [reader.entry_of(id).number for id in record.heat.entries]
    later = reader.store.heats(entries=numbers, since=record.number)
    audits = [one for one in later if one.heat.audits == record.heat.key]
    halves = {one.half for one in results}
    return {
        "hash": result.hash if result else None,
        "intact": bool(result and RaceOutcome(result.places, result.result).hash == result.hash),
        "worker": result.worker if result else None,
        "machine": result.machine if result else None,
        "disputed": len([one for one in results if not one.rejected]) > len(halves),
        "rejected": sum(one.rejected for one in results),
        "audits": [
            {"number": one.number, "state": one.state, "worker": one.worker, "done_s": one.done_s}
            for one in audits
        ],
    }


@dataclass
class LapFaults:
    """The faults of one car on one lap."""

    counts: dict[str, int] = field(default_factory=dict)
    """How often, by the page's word."""
    penalty_s: float = 0.0
    """Seconds of penalty that they cost."""


def faults_by_lap(result: RaceResult) -> list[list[LapFaults]]:
    """Return the faults of each car, by grid slot, on each of its laps.

    The lap that a car was on when the race ended is the last one, where it did not finish.
    """
    cars = sorted(result.order, key=lambda row: row.car)
    found = [[LapFaults() for _ in range(row.laps + (not row.finished))] for row in cars]
    laps, paid = [0] * len(cars), dict[tuple[int, float], float]()
    for event in result.events:
        car = event.car
        laps[car] += event.kind == "lap"
        if event.kind not in FAULT_WORDS or laps[car] >= len(found[car]):
            continue
        lap, word = found[car][laps[car]], FAULT_WORDS[event.kind]
        lap.counts[word] = lap.counts.get(word, 0) + 1
        if event.kind not in UNPENALISED and event.value:
            # Faults of one step share its penalty.
            paid_s = paid.get((car, event.time_s), 0.0)
            lap.penalty_s += max(event.value - paid_s, 0.0)
            paid[car, event.time_s] = max(event.value, paid_s)
    return found
