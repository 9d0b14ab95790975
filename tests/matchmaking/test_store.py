"""The store on both databases: founding, entries, queue and leases, results counted once."""

from __future__ import annotations

import sqlite3

import numpy as np
import pytest
import sqlalchemy as sa
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory

from league.errors import StoreError
from league.matchmaking import store
from league.matchmaking.pairing import heat_spec
from league.matchmaking.pairing.heat_spec import Half, Heat, Ruleset
from league.matchmaking.store import database, founding, schema
from league.matchmaking.store.blobs import FolderBlobs
from tests.matchmaking import leagues

# Founding and opening


def test_a_league_opened_again_is_the_league_that_was_made(url):
    with leagues.founded(url, entries=2) as made, store.Store(url) as opened:
        assert opened.settings == made.settings
        assert opened.settings.ruleset == leagues.RULES
        assert [entry.name for entry in opened.entries()] == ["e1", "e2"]


@pytest.mark.parametrize("older", [(), leagues.FIRST_VERSION])
def test_migrations_build_exactly_the_tables_of_the_schema(url, older):
    leagues.founded(url, entries=0).close()
    leagues.change(url, *older)
    store.upgrade(url)
    there = database.Database(url)
    with there.reading() as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": True})
        assert compare_metadata(context, schema.metadata) == []
        assert context.get_current_revision() == founding.SCHEMA
    there.close()
    assert ScriptDirectory(str(founding.MIGRATIONS)).get_heads() == [founding.SCHEMA]


def test_a_second_league_in_the_same_place_is_refused(url):
    leagues.founded(url, entries=1).close()
    with pytest.raises(StoreError, match=r"there is a league in .* already"):
        store.create(url)
    with store.Store(url) as opened:
        assert len(opened.entries()) == 1


def test_founding_that_fails_leaves_nothing_behind(url, monkeypatch):
    def broken(*_):
        raise RuntimeError("the machine dies")

    with monkeypatch.context() as patched:
        patched.setattr(founding, "add_ruleset", broken)
        with pytest.raises(RuntimeError):
            store.create(url)
    with pytest.raises(StoreError, match="holds no league: make one"):
        store.Store(url)
    store.create(url).close()


def test_a_place_without_a_league_is_refused(tmp_path):
    with pytest.raises(StoreError, match=r"there is no league in .*none\.db: make one"):
        store.Store(str(tmp_path / "none.db"))
    assert not (tmp_path / "none.db").exists()


def test_an_empty_postgresql_database_is_refused(new_postgres):
    with pytest.raises(StoreError, match="holds no league: make one"):
        store.Store(new_postgres())


def test_a_newer_league_is_refused(url):
    leagues.founded(url, entries=0).close()
    _set_version(url, "0999")
    match = f"version 0999, this program knows {founding.SCHEMA}: install a newer"
    with pytest.raises(StoreError, match=match):
        store.Store(url)
    with pytest.raises(StoreError, match="version 0999, which this program cannot bring up"):
        store.upgrade(url)


def test_an_older_league_says_how_to_bring_it_up_to_date(url):
    leagues.founded(url, entries=0).close()
    _set_version(url, "0000")
    match = f"version 0000, this program needs {founding.SCHEMA}: make a backup"
    with pytest.raises(StoreError, match=match):
        store.Store(url)


def test_the_newest_heats_are_found_without_sorting_all_that_are_done(url):
    with leagues.founded(url) as league:
        league.plan(leagues.duels(league, 9))
        league.complete("w", leagues.raced(league.claim("w", 7)))
        newest = league.heats(("done",), limit=2, newest=True)
        assert [one.number for one in newest] == [6, 7]
        assert len(league.heats(("planned", "done"), limit=9, newest=True)) == 9
        asked = []

        @sa.event.listens_for(league._database._engine, "before_cursor_execute")
        def note(connection, cursor, statement, parameters, *_):
            asked.append((statement, parameters))

        league.heats(("done",), limit=2, newest=True)
        if league._database.is_sqlite:
            statement, parameters = next(one for one in asked if "halves" in one[0])
            with league._database.reading() as connection:
                plan = connection.exec_driver_sql(f"EXPLAIN QUERY PLAN {statement}", parameters)
                assert not [row.detail for row in plan if "TEMP B-TREE" in row.detail]


def test_upgrading_a_league_of_today_changes_nothing(url):
    with leagues.founded(url, entries=2) as league:
        store.upgrade(url)
        assert len(league.entries()) == 2


def _set_version(url, version):
    there = database.Database(url)
    with there.writing() as connection:
        connection.execute(sa.text(f"UPDATE alembic_version SET version_num = '{version}'"))
    there.close()


def test_a_file_that_is_no_database_is_refused_and_left_alone(tmp_path):
    path = tmp_path / "notes.txt"
    path.write_text("Dear diary, " * 100)
    for action in (store.Store, store.create):
        with pytest.raises(StoreError, match="is no SQLite database: give a league's file"):
            action(f"sqlite:///{path}")
    assert path.read_text() == "Dear diary, " * 100


def test_a_database_of_something_else_is_refused(tmp_path):
    path = tmp_path / "shop.db"
    with sqlite3.connect(path) as shop:
        shop.execute("CREATE TABLE events (what TEXT)")
    shop.close()
    with pytest.raises(StoreError, match="holds no league"):
        store.Store(str(path))
    with pytest.raises(StoreError, match=r"holds tables of something else \(events\)"):
        store.create(str(path))


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ("sqlite://", "names no file"),
        ("sqlite:///:memory:", "names no file"),
        ("sqlite:///what?.db", "has a question mark in it"),
        ("what?", "has a question mark in it"),
        ("mysql://host/db", "a league in mysql was asked for"),
        ("://", "is no address of a league"),
        ("sqlite:////", "is a folder|cannot be opened"),
    ],
)
def test_an_address_that_is_none_is_refused(given, sentence):
    with pytest.raises(StoreError, match=sentence):
        store.create(given)


def test_a_server_that_does_not_answer_is_named_without_its_password():
    with pytest.raises(StoreError, match="cannot be reached") as refusal:
        store.Store("postgresql://me:topsecret@127.0.0.1:1/league")
    assert "topsecret" not in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_missing_postgresql_database_is_named(new_postgres):
    with pytest.raises(StoreError, match=r"does not exist|createdb|cannot be reached"):
        store.Store(new_postgres().rsplit("/", 1)[0] + "/nowhere")


# Entries


def test_an_entry_is_found_by_name_id_and_beginning_of_its_id(league):
    entry = league.entries()[0]
    assert entry.id == heat_spec.digest(b"weights 1")
    assert league.entry("e1") == league.entry(entry.id) == league.entry(entry.id[:8]) == entry
    assert league.blobs.get(entry.id) == b"weights 1"


def test_an_unknown_entry_gives_the_nearest_names(league):
    with pytest.raises(StoreError, match=r"no entry 'e11' .*; nearest: e1"):
        league.entry("e11")


def test_the_same_weights_submitted_again_are_the_same_entry(league):
    again = league.submit("another name", "owner 1", weights=b"weights 1")
    assert again == league.entry("e1")
    assert len(league.entries()) == 4


def test_somebody_elses_weights_are_refused(league):
    with pytest.raises(StoreError, match="entered already, as 'e1' by 'owner 1'"):
        league.submit("mine", "thief", weights=b"weights 1")


@pytest.mark.parametrize("name", ["", " e9", "a\nb", "x" * 101, "a\x00b"])
def test_a_name_that_cannot_be_shown_is_refused(league, name):
    with pytest.raises(StoreError, match="give 1 to 100 printable characters"):
        league.submit(name, "owner 9", weights=b"weights 9")
    assert len(league.entries()) == 4


def test_a_name_that_is_taken_is_refused(league):
    with pytest.raises(StoreError, match="the name 'e1' is taken by entry"):
        league.submit("e1", "owner 9", weights=b"weights 9")


def test_a_scripted_driver_is_an_entry_without_weights(league):
    entry = league.submit("anchor", "league", scripted="centerline", anchor=True)
    assert (entry.kind, entry.anchor, entry.card) == ("scripted", True, {"driver": "centerline"})
    assert not leagues.keeps(league, entry.id)


def test_an_entry_moves_only_along_its_way(league):
    first = league.entries()[0].id
    assert league.move({first: "validating"}) == 1
    assert league.move({first: "validating"}) == 0
    with pytest.raises(StoreError, match="is validating and cannot become ranked"):
        league.move({first: "ranked", league.entries()[1].id: "validating"})
    assert [entry.state for entry in league.entries()[:2]] == ["validating", "pending"]
    league.move({first: "refused"}, reason="NaN actions")
    assert league.entry("e1").reason == "NaN actions"
    with pytest.raises(StoreError, match="possible is nothing more"):
        league.move({first: "placement"})


def test_heats_of_an_entry_that_retires_are_cancelled_unless_under_way(league):
    heats = leagues.duels(league, 6)  # each pair of four meets once
    league.plan(heats)
    under_way = league.claim("w", 1)[0]
    gone = under_way.heat.entries[0]
    league.move({gone: "retired"})
    assert league.counts() == {"claimed": 1, "cancelled": 2, "planned": 3}
    assert league.complete("w", leagues.raced([under_way])).accepted


# The queue


def test_a_heat_planned_twice_is_raced_once(league):
    heats = leagues.duels(league, 5)
    assert league.plan(heats) == 5
    assert league.plan(heats + leagues.duels(league, 2, first=5)) == 2
    assert league.plan([]) == 0
    assert league.counts() == {"planned": 7}


def test_a_claimed_heat_is_the_heat_that_was_planned(league):
    heats = leagues.duels(league, 3)
    league.plan(heats)
    claims = league.claim("w", 5)
    assert [claim.heat for claim in claims] == heats
    assert [claim.heat.key for claim in claims] == [heat.key for heat in heats]
    assert [claim.attempts for claim in claims] == [1, 1, 1]
    assert league.claim("other", 5) == []


def test_newcomers_are_validated_before_rated_heats_are_raced(league):
    rated = leagues.duels(league, 2)
    own = league.entries()[3].id
    check = Heat(leagues.RULES.hash, (Half("ring", (own, own)),), purpose="validation")
    league.plan([*rated, check])
    assert [claim.heat for claim in league.claim("w", 3)] == [check, *rated]


def test_a_heat_lost_with_its_machine_is_lent_again_and_has_not_failed(league, clock):
    league.plan(leagues.duels(league, 1))
    key = leagues.duels(league, 1)[0].key
    for number in range(5):
        (claim,) = league.claim(f"w{number}", 1, lease_s=60)
        assert claim.attempts == 1
        clock.now_s += 59
        assert league.claim("eager", 1) == []
        clock.now_s += 2
    (claim,) = league.claim("w5", 1)
    assert "worker w4 gave no sign until its lease ended" in league.heat(key).traceback
    assert league.fail("w5", key, "killed", lost=True) == "planned"
    # Only races that fail count, and three of them make an error.
    states = [league.fail(league.claim("w", 1) and "w", key, "broken") for _ in range(3)]
    assert states == ["planned", "planned", "error"]
    assert league.retry(key)
    assert league.claim("w6", 1)[0].attempts == 1


def test_a_heartbeat_keeps_only_the_workers_own_leases(league, clock):
    league.plan(leagues.duels(league, 2))
    (mine,), (_,) = league.claim("w", 1, lease_s=60), league.claim("other", 1, lease_s=60)
    clock.now_s += 50
    assert league.heartbeat("w", lease_s=60) == [mine.heat.key]
    clock.now_s += 50
    (lost,) = league.claim("third", 1, lease_s=120)
    assert lost.attempts == 1
    held = [record.heat for record in league.heats(["claimed"]) if record.worker == "w"]
    assert held == [mine.heat]
    clock.now_s += 50
    assert league.heartbeat("w", lease_s=60) == []  # too late: it may be lent already


def test_three_failures_make_an_error_with_the_traceback(league):
    league.plan(leagues.duels(league, 1))
    key = leagues.duels(league, 1)[0].key
    states = []
    for attempt in (1, 2, 3):
        league.claim("w", 1)
        states.append(league.fail("w", key, f"Traceback: try {attempt}\x00"))
    assert states == ["planned", "planned", "error"]
    assert league.heat(key).traceback == "Traceback: try 3?"
    assert len(league.races().heat) == 0


def test_a_failure_reported_after_the_lease_was_lost_takes_nothing_from_the_next(league, clock):
    league.plan(leagues.duels(league, 1))
    (old,) = league.claim("old", 1, lease_s=10)
    clock.now_s += 11
    league.claim("new", 1, lease_s=60)
    assert league.fail("old", old.heat.key, "late") == "claimed"
    assert league.heat(old.heat.key).worker == "new"


@pytest.mark.parametrize(
    ("heat", "sentence"),
    [
        (lambda ids: Heat("0" * 64, (Half("ring", ids),)), "which this league does not have"),
        (
            lambda ids: Heat(leagues.RULES.hash, (Half("ring", ("9" * 64,)),)),
            r"there is no entry '9{12}' in",
        ),
        (
            lambda ids: Heat(
                leagues.RULES.hash, (Half("ring", ids),), purpose="audit", audits="8" * 64
            ),
            "an audit of heat 8{12} was planned, .* audit a heat that is done",
        ),
    ],
)
def test_a_heat_that_cannot_be_raced_here_is_refused_and_none_is_planned(league, heat, sentence):
    ids = tuple(entry.id for entry in league.entries()[:2])
    with pytest.raises(StoreError, match=sentence):
        league.plan([*leagues.duels(league, 2), heat(ids)])
    assert league.counts() == {}


# Results


def test_results_sent_twice_count_once(league):
    league.plan(leagues.duels(league, 3))
    outcomes = leagues.raced(league.claim("w", 3))
    assert len(league.complete("w", outcomes).accepted) == 3
    again = league.complete("w", outcomes + outcomes)
    assert (len(again.accepted), len(again.repeated)) == (0, 6)
    assert len(league.races().heat) == 6
    assert league.counts() == {"done": 3}


def test_a_late_result_counts_if_no_other_came_first(league, clock):
    league.plan(leagues.duels(league, 1))
    late = league.claim("slow", 1, lease_s=10)
    clock.now_s += 11
    again = league.claim("quick", 1)
    assert league.complete("slow", leagues.raced(late)).accepted
    assert league.complete("quick", leagues.raced(again)).repeated
    assert len(league.races().heat) == 2
    assert league.claim("idle", 1) == []


def test_two_different_results_of_a_heat_void_both(league):
    league.plan(leagues.duels(league, 2))
    disputed, fine = league.claim("honest", 2)
    league.complete("honest", leagues.raced([disputed, fine]))
    assert len(league.races().heat) == 4
    lie = store.HeatOutcome(disputed.heat.key, tuple(_turned(r) for r in _outcome(disputed).races))
    assert league.complete("liar", [lie]).quarantined == (disputed.heat.key,)
    races = league.races()
    assert set(races.heat.tolist()) == {fine.number}
    assert races.voided == 1
    kept = league.results(disputed.number)
    assert sorted((r.half, r.worker) for r in kept) == [
        (0, "honest"), (0, "liar"), (1, "honest"), (1, "liar")
    ]  # fmt: skip
    # Neither side can bring its result back.
    assert league.complete("honest", [_outcome(disputed)]).quarantined
    assert league.counts() == {"quarantined": 1, "done": 1}
    assert [e.actor for e in leagues.events(league) if e.action == "quarantine"] == [
        "liar",
        "honest",
    ]


def test_a_heat_is_voided_when_only_one_of_its_races_differs(league):
    league.plan(leagues.duels(league, 1))
    (claim,) = league.claim("w", 1)
    first, second = _outcome(claim).races
    both = [_outcome(claim), store.HeatOutcome(claim.heat.key, (first, _turned(second)))]
    received = league.complete("w", both)  # within one call, too
    assert (received.accepted, received.quarantined) == ((claim.heat.key,), (claim.heat.key,))
    assert len(league.races().heat) == 0
    assert len(league.results(claim.number)) == 3


def test_an_audit_that_agrees_changes_nothing_and_one_that_differs_voids_the_heat(league):
    league.plan(leagues.duels(league, 2))
    claims = league.claim("w", 2)
    league.complete("w", leagues.raced(claims))
    assert league.plan([heat_spec.audit_of(claim.heat) for claim in claims]) == 2
    audits = league.claim("auditor", 2)
    assert [audit.seeds for audit in audits] == [claim.seeds for claim in claims]
    good, bad = leagues.raced(audits)
    bad = store.HeatOutcome(bad.key, tuple(map(_turned, bad.races)))
    received = league.complete("auditor", [good, bad])
    assert (received.accepted, received.quarantined) == ((good.key,), (bad.key,))
    assert set(league.races().heat.tolist()) == {claims[0].number}
    assert league.heat(claims[1].heat.key).state == "quarantined"


@pytest.mark.parametrize(
    ("places", "sentence"),
    [((1, 2, 3), "give all places of all its races"), ((0, 1), "count places from 1")],
)
def test_places_that_cannot_be_are_refused_and_nothing_of_the_call_is_kept(
    league, places, sentence
):
    league.plan(leagues.duels(league, 2))
    good, bad = leagues.raced(league.claim("w", 2))
    wrong = store.RaceOutcome(places, {})
    with pytest.raises(StoreError, match=sentence):
        league.complete("w", [good, store.HeatOutcome(bad.key, (wrong, wrong))])
    assert league.counts() == {"claimed": 2}
    assert len(league.races().heat) == 0


def test_a_result_with_a_number_that_is_none_is_refused(league):
    league.plan(leagues.duels(league, 1))
    (claim,) = league.claim("w", 1)
    races = (store.RaceOutcome((1, 2), {"time_s": float("nan")}),) * 2
    with pytest.raises(StoreError, match="is no plain data"):
        league.complete("w", [store.HeatOutcome(claim.heat.key, races)])


def test_a_result_comes_back_as_it_was_given_with_its_recording(league):
    league.plan(leagues.duels(league, 1))
    (claim,) = league.claim("w", 1)
    result = {"winner": "e1 – ümlaut", "laps_s": [1.25, 0.1], "best": None}
    races = (store.RaceOutcome((1, 1), result, b"replay"), store.RaceOutcome((2, 1), result))
    league.complete("w", [store.HeatOutcome(claim.heat.key, races)])
    first, second = league.results(claim.number)
    assert (first.places, first.result, first.worker) == ((1, 1), result, "w")
    assert first.replay is not None
    assert league.blobs.get(first.replay) == b"replay"
    assert second.replay is None


def test_seeds_are_known_only_when_the_heat_is_over(league):
    league.plan(leagues.duels(league, 1))
    (claim,) = league.claim("w", 1)
    assert league.heat(claim.number).seeds is None
    league.complete("w", leagues.raced([claim]))
    assert league.heat(claim.number).seeds == claim.seeds
    assert league.heat(claim.heat.key[:10]).heat == claim.heat


def test_two_leagues_draw_other_seeds_for_the_same_heat(tmp_path):
    seeds = []
    for name in ("one.db", "two.db"):
        with leagues.founded(str(tmp_path / name)) as league:
            league.plan(leagues.duels(league, 1))
            seeds.append(league.claim("w", 1)[0].seeds)
    assert seeds[0] != seeds[1]


def test_races_are_read_as_arrays_padded_to_the_largest_field(league):
    ids = [entry.id for entry in league.entries()]
    number = {entry.id: entry.number for entry in league.entries()}
    field = tuple(ids[:3])
    league.plan(
        [
            Heat(leagues.RULES.hash, (Half("ring", field), Half("ring", field[::-1]))),
            Heat(leagues.RULES.hash, (Half("ring", (ids[3], ids[0])),)),
        ]
    )
    big, small = league.claim("w", 2)
    results = [
        store.HeatOutcome(
            big.heat.key, (store.RaceOutcome((1, 3, 1), {}), store.RaceOutcome((2, 3, 1), {}))
        ),
        store.HeatOutcome(small.heat.key, (store.RaceOutcome((2, 1), {}),)),
    ]
    league.complete("w", results)
    races = league.races()
    order = np.lexsort((races.half, races.heat))
    a, b, c, d = (number[i] for i in ids)
    assert races.heat[order].tolist() == [big.number, big.number, small.number]
    assert races.half[order].tolist() == [0, 1, 0]
    assert races.entries[order].tolist() == [[a, b, c], [c, b, a], [d, a, -1]]
    assert races.places[order].tolist() == [[1, 3, 1], [2, 3, 1], [2, 1, 0]]


def test_races_since_the_last_reading_are_only_the_new_ones(league):
    league.plan(leagues.duels(league, 4))
    league.complete("w", leagues.raced(league.claim("w", 3)))
    first = league.races()
    assert len(first.heat) == 6
    assert len(league.races(since=first.last).heat) == 0
    (late,) = league.claim("w", 1)
    league.complete("w", leagues.raced([late]))
    assert league.races(since=first.last).heat.tolist() == [late.number] * 2


def test_races_of_another_ruleset_or_purpose_are_not_rated(league):
    ids = tuple(entry.id for entry in league.entries()[:2])
    rated = leagues.duels(league, 1)
    gauntlet = Heat(leagues.RULES.hash, (Half("ring", ids),), purpose="gauntlet")
    league.plan([*rated, gauntlet])
    league.complete("w", leagues.raced(league.claim("w", 2)))
    assert len(league.races().heat) == 2
    assert len(league.races(rated=None).heat) == 3
    leagues.set_ruleset(league, Ruleset(tracks=leagues.TRACKS, laps=5))
    assert len(league.races().heat) == 0
    assert len(league.races(leagues.RULES.hash).heat) == 2
    assert list(league.rulesets().values()) == [leagues.RULES, league.settings.ruleset]


def test_heats_are_listed_by_state_and_by_who_took_part(league):
    league.plan(leagues.duels(league, 12))  # each of six pairs twice
    league.complete("w", leagues.raced(league.claim("w", 6)))
    a, b = (entry.number for entry in league.entries()[:2])
    assert len(league.heats(["done"])) == 6
    assert len(league.heats(entries=[a])) == 6
    assert len(league.heats(["done"], entries=[a, b])) == 1
    assert [record.number for record in league.heats(since=10)] == [11, 12]
    assert len(league.heats(limit=3)) == 3
    with pytest.raises(StoreError, match="999 names no heat"):
        league.heat(999)


def test_every_deed_is_in_the_diary(league, clock):
    league.plan(leagues.duels(league, 1))
    (claim,) = league.claim("w", 1, lease_s=1)
    clock.now_s += 2
    (claim,) = league.claim("w", 1)
    league.fail("w", claim.heat.key, "broken")
    league.complete("w", leagues.raced(league.claim("w", 1)))
    league.move({league.entries()[0].id: "retired"}, actor="owner 1")
    actions = [(event.actor, event.action) for event in leagues.events(league)]
    assert actions[0] == ("league", "found")
    assert actions[1:5] == [(f"owner {n}", "submit") for n in (1, 2, 3, 4)]
    assert actions[5:] == [
        ("league", "plan"), ("w", "claim"), ("league", "reap"), ("w", "claim"), ("w", "fail"),
        ("w", "claim"), ("w", "complete"), ("owner 1", "retired"),
    ]  # fmt: skip


@pytest.mark.parametrize("worker", ["", "w\n", "x" * 201])
def test_a_worker_without_a_proper_name_is_refused(league, worker):
    with pytest.raises(StoreError, match="a worker's name is"):
        league.claim(worker)


def test_a_league_keeps_its_files_in_a_folder_if_asked_to(url, tmp_path):
    place = tmp_path / "files"
    with leagues.founded(url, entries=2, blobs=str(place)) as league:
        entry = league.entry("e1")
        assert (place / entry.id[:2] / entry.id).read_bytes() == b"weights 1"
        assert league.blobs.get(entry.id) == b"weights 1"
        league.plan(leagues.duels(league, 1))
        (claim,) = league.claim("w", 1)
        races = (store.RaceOutcome((1, 2), {}, b"replay"),) * 2
        league.complete("w", [store.HeatOutcome(claim.heat.key, races)])
        replay = league.results(claim.number)[0].replay
        assert replay == heat_spec.digest(b"replay")
        assert league.blobs.get(replay) == b"replay"
    assert not list(place.rglob("*.part")) and isinstance(league.blobs, FolderBlobs)


def _outcome(claim):
    return leagues.raced([claim])[0]


def _turned(race):
    return store.RaceOutcome(race.places[::-1], race.result, race.replay)


def test_the_audit_log_cuts_long_names(league):
    entry = league.submit("a", "ann", weights=b"a")
    league.move({entry.id: "retired"}, actor="x" * 300)
    assert max(len(event.actor) for event in leagues.events(league)) == 200
