"""The store at its edges: what may be missing or long, the last moment of a lease, cut texts."""

from __future__ import annotations

import json
from typing import get_args

import numpy as np
import pytest
import sqlalchemy as sa

from league.errors import StoreError
from league.matchmaking import store
from league.matchmaking.pairing import heat_spec
from league.matchmaking.pairing.heat_spec import Half, Heat
from league.matchmaking.store import names, queue, race_table, records, schema
from league.matchmaking.store.database import Database
from league.matchmaking.store.records import HeatProgress, Races, Season
from tests.matchmaking import leagues

# Tables: SQLite would take anything


def test_only_these_columns_may_be_null():
    may = {f"{column.table}.{column.name}" for t in schema.metadata.tables.values()
           for column in t.c if column.nullable}  # fmt: skip
    assert may == {
        "tokens.expires_s", "tokens.revoked_s", "tokens.used_s",
        "heats.audits", "heats.worker", "heats.claimed_s", "heats.lease_s", "heats.done_s",
        "results.replay",
        "seasons.until", "seasons.ended_s", "seasons.hash", "seasons.document",
        "cups.season", "cups.ended_s", "cups.hash", "cups.document",
    }  # fmt: skip


def test_columns_have_room_for_the_longest_texts_that_are_let_in():
    digest, worker, name = 64, 200, 100
    longest = {
        "rulesets.hash": digest, "entries.id": digest, "tokens.hash": digest,
        "blobs.digest": digest, "heats.key": digest, "results.hash": digest,
        "results.replay": digest, "seasons.hash": digest, "cups.hash": digest,
        "ledger.chain": digest, "heats.worker": worker, "results.worker": worker,
        "events.actor": worker, "league.name": name, "owners.name": name, "entries.name": name,
        "seasons.name": name, "cups.name": name, "events.subject": 100,
        "entries.state": max(map(len, get_args(records.EntryState))),
        "heats.state": max(map(len, get_args(records.HeatState))),
        "heats.purpose": max(map(len, queue.PRIORITY)),
        "tokens.scopes": len(" ".join(records.SCOPES)),
        "ledger.subject": len(schema.state_record("0" * 64, "provisional", "").subject),
    }  # fmt: skip
    for where, length in longest.items():
        table, column = where.split(".")
        assert schema.metadata.tables[table].c[column].type.length >= length, where


def test_the_audit_log_has_room_for_long_subjects(league):
    with league._writing() as change:
        change.log("a", "deed", "s" * 300, more="kept")
    event = leagues.events(league)[-1]
    assert (event.subject, json.loads(event.detail)) == ("s" * 100, {"more": "kept"})


# Leases and tries


def test_a_lease_of_a_minute_ends_after_its_last_moment(league, clock):
    league.plan(leagues.duels(league, 1))
    (mine,) = league.claim("w")
    clock.now_s += 60.0
    assert league.claim("eager") == []
    assert league.heartbeat("w") == [mine.heat.key]
    clock.now_s += 60.0
    assert league.heartbeat("w") == [mine.heat.key]
    clock.now_s += 60.001
    assert league.heartbeat("w") == []
    assert [one.number for one in league.claim("eager")] == [mine.number]


def test_how_far_a_heat_has_come_is_kept_while_its_worker_holds_it(league, clock):
    league.plan(leagues.duels(league, 2))
    mine, other = league.claim("w", 2)
    revision = league.revision
    league.show("w", [HeatProgress(mine.heat.key, (b"first", b"second"))])
    league.show("w", [HeatProgress(other.heat.key, (b"other",))])
    assert [league.shown(mine.number, half) for half in range(3)] == [b"first", b"second", None]
    league.show("w", [HeatProgress(mine.heat.key, (b"more", b"of it"))])
    league.show("thief", [HeatProgress(mine.heat.key, (b"false", b"false"))])
    league.show("w", [HeatProgress("0" * 64, (b"of no heat",))])
    assert [league.shown(mine.number, half) for half in (0, 1)] == [b"more", b"of it"]
    assert league.revision == revision  # pages are not made again for it
    league.fail("w", mine.heat.key, "", lost=True)
    assert league.shown(mine.number, 0) is None and league.shown(other.number, 0) == b"other"
    (again,) = league.claim("w")
    league.show("w", [HeatProgress(other.heat.key, (b"still",))])
    assert again.number == mine.number and league.shown(again.number, 0) == b"more"
    league.complete("w", leagues.raced([again]))
    league.show("w", [HeatProgress(other.heat.key, (b"still",))])
    database = Database(league.url)
    with database.reading() as connection:
        rows = connection.execute(sa.select(schema.progress.c.heat)).scalars().all()
    database.close()
    assert rows == [other.number]


def test_one_heat_is_lent_unless_more_are_asked_for(league):
    league.plan(leagues.duels(league, 4))
    assert len(league.claim("w")) == 1
    assert len(league.claim("w", 2)) == 2
    assert [one.claimed_s for one in league.heats(("claimed",))] == [1000.0] * 3


def test_cups_and_gauntlets_are_raced_before_rated_heats_and_validation_before_all(league):
    ids = tuple(entry.id for entry in league.entries()[:2])
    planned = [*leagues.duels(league, 1)]
    planned += [
        Heat(leagues.RULES.hash, (Half("ring", ids),), purpose=purpose)
        for purpose in ("cup", "gauntlet", "validation")
    ]
    league.plan(planned)
    order = [one.heat.purpose for one in league.claim("w", 9)]
    assert order == ["validation", "cup", "gauntlet", "rated"]


def test_the_end_of_a_long_traceback_is_kept(league):
    league.plan(leagues.duels(league, 1))
    (claim,) = league.claim("w")
    text = "".join(f"line {k}\n" for k in range(2000))
    league.fail("w", claim.heat.key, text)
    assert league.heat(claim.number).traceback == text[-8000:]
    logged = json.loads(leagues.events(league)[-1].detail)
    assert logged == {"attempt": 1, "traceback": text[-500:]}


def test_a_heat_is_found_by_six_digits_of_its_key_and_not_by_five(league):
    league.plan(leagues.duels(league, 2))
    heat = league.heat(2)
    assert league.heat(heat.heat.key[:6]).number == 2
    with pytest.raises(StoreError, match="names no heat of this league: give its number or"):
        league.heat("abcde" if heat.heat.key[:5].isdigit() else heat.heat.key[:5])
    with pytest.raises(StoreError, match="names no heat"):
        league.heat("9" * 16)  # the beginning of a key, because no number is so long


def test_a_share_of_heats_is_audited_and_each_at_most_once(league):
    league.plan(leagues.duels(league, 40))
    claims = league.claim("w", 40)
    league.complete("w", leagues.raced(claims))
    keys = [one.heat.key for one in claims]
    assert league.audit(keys, 0.0) == 0
    half = league.audit(keys, 0.5)
    assert 8 <= half <= 32
    assert league.audit(keys, 0.5) == 0  # the draw is the same, and planned already
    assert league.audit(keys, 1.0) == 40 - half
    assert league.audit(keys, 1.0) == 0


def test_newest_heats_come_in_order_and_pages_leave_none_out(league):
    league.plan(leagues.duels(league, 5))
    league.complete("w", leagues.raced(league.claim("w", 4)))
    assert [one.number for one in league.done(entry=None, skip=0, limit=2)] == [4, 3]
    assert [one.number for one in league.done(entry=None, skip=2, limit=9)] == [2, 1]
    one = league.entries()[0].number
    assert league.num_done() == 4
    assert [one.number for one in league.done(entry=one, skip=0, limit=9)] == [3, 2, 1]
    assert league.num_done(one) == 3
    over = Season(1, "Spring", 0, {}, 0.0, 1.0, "", "", 0, 2)
    running = Season(2, "Summer", 0, {}, 1.0, None, "", "", 2, None)
    assert [one.number for one in league.done(entry=None, skip=0, limit=9, season=over)] == [2, 1]
    assert [one.number for one in league.done(entry=one, skip=0, limit=9, season=running)] == [3]
    assert (league.num_done(one, over), league.num_done(None, running)) == (2, 2)


# Entries


def test_nothing_of_a_refused_submission_is_kept(league):
    with pytest.raises(StoreError, match="is taken"):
        league.submit("e1", "owner 9", weights=b"weights 9")
    assert not leagues.keeps(league, heat_spec.digest(b"weights 9"))
    assert "owner 9" not in {entry.owner for entry in league.entries()}


def test_a_driver_is_either_weights_or_a_script(league, tmp_path):
    for given in ({}, {"weights": b"w", "scripted": "centerline"}):
        with pytest.raises(ValueError, match="either weights or"):
            league.submit("e9", "owner 9", **given)
    with leagues.founded(str(tmp_path / "b.db"), entries=0, blobs=str(tmp_path / "files")) as other:
        assert other.submit("anchor", "league", scripted="centerline").kind == "scripted"


def test_entries_of_one_beginning_get_more_digits(league):
    with league._writing() as change:
        for number, id in ((1, "abcdef0" + "0" * 57), (2, "abcdef1" + "0" * 57)):
            own = schema.entries.c.number == number
            change.update(schema.entries, own, id=id)
    with pytest.raises(StoreError, match="begins the ids of 2 entries: give more digits"):
        league.entry("abcdef")
    assert league.entry("abcdef1").name == "e2"
    with pytest.raises(StoreError, match="there is no entry"):
        league.entry("abcde")


@pytest.mark.parametrize("sign", ["\u180b", "\u180f", "\ufe00", "\ufe0f", "\U000e0100", "\u2800"])
def test_signs_that_show_nothing_are_no_part_of_a_name(sign):
    with pytest.raises(StoreError, match="cannot be seen"):
        names.check_name(f"ra{sign}cer", "a name")


@pytest.mark.parametrize("name", ["cafe\u0301", "jose\u0301 2"])
def test_a_name_may_end_in_an_accent_but_not_begin_with_one(name):
    names.check_name(name, "a name")
    with pytest.raises(StoreError, match="cannot be seen"):
        names.check_name(f"\u0301{name}", "a name")


def test_a_name_may_have_a_hundred_characters():
    names.check_name("x" * 100, "a name")
    with pytest.raises(StoreError, match="give 1 to 100"):
        names.check_name("x" * 101, "a name")


# Results, races and drives


def test_a_result_names_its_heat_when_it_is_refused(league):
    league.plan(leagues.duels(league, 1))
    (claim,) = league.claim("w")
    wrong = store.HeatOutcome(claim.heat.key, (store.RaceOutcome((1, 2, 3), {}),) * 2)
    said = rf"heat {claim.heat.key[:12]} has races of \[2, 2\] cars, results for \[3, 3\] cars"
    with pytest.raises(StoreError, match=said):
        league.complete("w", [wrong])
    with pytest.raises(StoreError, match=f"no heat '{'7' * 12}' in this league"):
        league.complete("w", [store.HeatOutcome("7" * 64, wrong.races)])


def test_a_league_without_races_has_empty_arrays(league):
    races, drives = league.races(), league.drives(leagues.RULES.hash)
    assert races.entries.shape == races.places.shape == races.runs.shape == (0, 2)
    assert len(drives.entry) == 0 and (races.last, drives.last) == (0, 0)


def drawn_races(count: int, cars: int, seed: int) -> Races:
    generator = np.random.default_rng(seed)
    entries = np.argsort(generator.random((count, 30)), axis=1)[:, :cars].astype(np.int32)
    entries[:, 2:][generator.random((count, max(cars - 2, 0))) < 0.5] = -1
    heat = generator.permutation(count).astype(np.int64) // 2 + 1
    half = generator.integers(0, 2, count).astype(np.uint8)
    small = np.zeros((count, cars), np.uint8)
    return Races(heat, half, half, entries, small, small.astype(np.uint32))


@pytest.mark.parametrize("cars", [[3, 4, 2], [1, 1, 1]])
def test_races_of_an_entry_are_found_among_earlier_and_later_ones(cars):
    races, *more = map(drawn_races, (400, 7, 90), cars, (1, 2, 3))
    assert len(races.of_entry(5).heat)
    for later in more:
        races = races.joined(later)
        for number in range(32):
            own = races.of_entry(number)
            kept = races.where((races.entries == number).any(axis=1))
            order = np.lexsort((kept.half, kept.heat))
            assert own.heat.tolist() == kept.heat[order].tolist()
            assert own.half.tolist() == kept.half[order].tolist()
            assert (own.entries == number).any(axis=1).all()


def _driven(**row):
    car = {"car": 0, "distance": 12.345, "lap_times_s": [9.5, 9.25], **row}
    text = race_table.driven({"order": [car]}, 1)
    return np.frombuffer(bytes.fromhex(text), race_table.DRIVEN).tolist() if text else []


def test_how_a_car_drove_is_packed_within_its_digits():
    assert _driven() == [(0, 1234, 9250)]  # half to even
    assert _driven(distance=-3.0, crashes=1) == [(4, 0, 0)]
    assert _driven(off_tracks=2, touches=3, crashes=1)[0][0] == 2 * 1 + 3 * 1 + 1 * 4
    assert _driven(crashes=20_000)[0][0] == 0xFFFF
    for fault in race_table.FAULTS:
        assert _driven(**{fault: 1})[0][2] == 0  # a lap is clean in a race without a fault
    assert _driven(lap_times_s=[]) == [(0, 1234, 0)]
    assert _driven(distance=0, lap_times_s=[]) == []
    assert _driven(car=1) == []  # there is no such car


def test_drives_are_of_rated_races_and_races_are_unless_all_are_asked_for(league):
    ids = tuple(entry.id for entry in league.entries()[:2])
    check = Heat(leagues.RULES.hash, (Half("ring", ids),), purpose="validation")
    league.plan([*leagues.duels(league, 1), check])
    result = {"order": [{"car": k, "distance": 1.0 + k, "lap_times_s": []} for k in (0, 1)]}
    for claim in league.claim("w", 2):
        races = (store.RaceOutcome((1, 2), result),) * len(claim.heat.halves)
        league.complete("w", [store.HeatOutcome(claim.heat.key, races)])
    assert len(league.drives(leagues.RULES.hash).entry) == 4  # two races of two cars
    assert len(league.races().heat) == 2 and len(league.races(rated=None).heat) == 3
    assert len(league.races(rated=False).heat) == 1


@pytest.mark.parametrize(
    ("until", "own"), [(None, [False, True, True, True]), (6, [False, True, True, False])]
)
def test_a_season_has_the_heats_after_the_last_one_up_to_its_own_last(until, own):
    season = Season(2, "two", 0, {}, 0.0, None, "", "", 4, until)
    assert season.has(np.array([4, 5, 6, 7])).tolist() == own


def test_no_moves_between_divisions_are_no_new_ones(league):
    season = league.start_season("", {})
    assert season.name == "Season 1"
    assert league.move_divisions(1, []) == 0
    one, two = (entry.number for entry in league.entries()[:2])
    moves = [store.Move(1, number, 1, 0, "new") for number in (one, two)]
    assert league.move_divisions(1, moves) == 2
    assert league.move_divisions(1, moves) == 0
    assert league.division_moves(1, one) == moves[:1]
    assert league.division_moves(1) == moves


def test_an_event_makes_the_revision_grow(league):
    before = league.revision
    league.submit("e9", "owner 9", weights=b"weights 9")
    assert league.revision == before + 1


def test_many_values_are_asked_for_in_parts(league):
    from league.matchmaking.store.database import chunked

    numbers = [1, *range(10, 40_000), 2]  # more than SQLite has room for at once
    with league._database.reading() as connection:
        query = sa.select(schema.entries.c.number)
        found = chunked(connection, query, schema.entries.c.number, numbers)
    assert [row.number for row in found] == [1, 2]
