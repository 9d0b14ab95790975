"""An audit finds whatever was changed of what the standings are computed from."""

from __future__ import annotations

import json
import sqlite3
import zlib
from contextlib import closing
from dataclasses import replace

import pytest

from league.errors import StoreError
from league.matchmaking import store
from league.matchmaking.pairing import heat_spec
from league.matchmaking.pairing.heat_spec import Half, Heat
from league.matchmaking.store import integrity, schema
from league.matchmaking.store.database import Database
from tests.matchmaking import leagues


@pytest.fixture
def league(url):
    """Return a league with ten heats and a settled dispute."""
    with leagues.founded(url) as league:
        league.plan(leagues.duels(league, 10))
        claims = league.claim("w", 10)
        league.complete("w", leagues.raced(claims))
        lie = store.HeatOutcome(claims[4].heat.key, (store.RaceOutcome((1, 2), {"lie": 1}),) * 2)
        league.complete("liar", [lie])
        league.retry(claims[4].heat.key)
        league.claim("third")
        league.complete("third", leagues.raced([claims[4]]))
        assert league.counts() == {"done": 10}
        league.set_ruleset(replace(leagues.RULES, laps=5))
        league.set_ruleset(leagues.RULES)
        found = league.verify()
        # 2 rulesets, present 3 times, 4 entries and their states, 20 results, 2 more of the lie,
        # 1 settled dispute
        assert (found.races, found.records, found.mismatches) == (20, 36, [])
        assert not found.damaged
        yield league


def _found(league, url, *statements, **values):
    leagues.change(url, *statements, **values)
    return league.verify().mismatches


SWAP = "substr(packed, 1, 28) || substr(packed, 31, 2) || substr(packed, 29, 2)"


@pytest.mark.parametrize(
    ("statement", "sentence"),
    [
        (
            f"UPDATE races SET packed = {SWAP} || substr(packed, 33) WHERE heat = 3 AND half = 1",
            "heat 3 race 2: the standings read something else than its result",
        ),
        ("UPDATE races SET rated = false WHERE heat = 3 AND half = 0", "heat 3 race 1: the stand"),
        ("DELETE FROM races WHERE heat = 3 AND half = 0", "heat 3 race 1: the standings miss it"),
        ("UPDATE entries SET anchor = true WHERE number = 2", "(entry "),
        ("UPDATE entries SET name = 'x' WHERE number = 2", "what it records was changed"),
        ("UPDATE entries SET state = 'retired' WHERE number = 2", "entry 'e2': it is retired, and"),
        ("UPDATE entries SET reason = 'x' WHERE number = 2", "the ledger has another state or"),
        ("UPDATE rulesets SET settings = '{}'", "its settings differ from its hash"),
        ("UPDATE league SET ruleset = 2", "the present rules are "),
        ("UPDATE heats SET halves = replace(halves, '1', '3') WHERE number = 1", "not what was"),
        ("UPDATE heats SET halves = 'x' WHERE number = 1", "heat 1: it is not what was planned"),
        ("UPDATE heats SET purpose = 'validation' WHERE number = 3", "heat 3: it is not what was"),
        ("UPDATE heats SET state = 'cancelled' WHERE number = 3", "heat 3: it is cancelled, and"),
        (
            "UPDATE results SET document = :junk WHERE heat = 3 AND half = 0",
            "differs from its hash",
        ),
        ("UPDATE results SET worker = 'other' WHERE heat = 3", "(result 3/0/"),
        ("DELETE FROM results WHERE heat = 3 AND half = 1", "what it records was deleted"),
        (
            "UPDATE results SET rejected = NOT rejected WHERE heat = 5",
            "heat 5: a result that count",
        ),
        ("DELETE FROM ledger WHERE number = 9", "record 10 of the ledger"),
        ("UPDATE ledger SET chain = :junk WHERE number = 9", "record 9 of the ledger"),
    ],
)
def test_a_change_is_found(league, url, statement, sentence):
    values = (
        {"junk": b"junk" if "document" in statement else "junk"} if ":junk" in statement else {}
    )
    found = _found(league, url, statement, **values)
    assert found and any(sentence in mismatch for mismatch in found), found


def test_present_rules_that_are_missing_are_one_sentence(league, url):
    path, edited = Database(url).path, "UPDATE league SET ruleset = 9"
    if path is None:
        leagues.change(url, "ALTER TABLE league DROP CONSTRAINT fk_league_ruleset", edited)
    else:
        with closing(sqlite3.connect(path)) as raw, raw:  # foreign keys are not enforced
            raw.execute(edited)
    found = league.verify()
    assert found.damaged and found.mismatches == ["the present rules are missing"]
    with pytest.raises(StoreError, match=r"present rules of the league .* are missing: restore"):
        _ = league.settings


@pytest.mark.parametrize(("table", "damaged"), [("heats", True), ("races", False)])
def test_only_heats_that_were_changed_cannot_be_raced_again(league, url, table, damaged):
    changed = {"heats": "purpose = 'validation' WHERE number = 3", "races": "rated = false"}
    leagues.change(url, f"UPDATE {table} SET {changed[table]}")
    found = league.verify()
    assert found.mismatches and found.damaged == damaged


def test_an_edited_document_is_found_with_its_hash_and_races_edited_too(league, url):
    plain = heat_spec.canonical({"places": [1, 2], "result": {"invented": True}})
    document, digest = zlib.compress(plain), heat_spec.digest(plain)
    change = "UPDATE results SET document = :document, hash = :digest WHERE heat = 3 AND half = 0"
    found = _found(league, url, change, document=document, digest=digest)
    assert any("(result 3/0/" in one and "was deleted" in one for one in found)
    assert "heat 3: a result of it is not in the ledger" in found


def test_a_deleted_heat_is_found(league, url):
    tables = ("races", "results", "heat_entries", "heats")
    columns = ("heat", "heat", "heat", "number")
    change = [f"DELETE FROM {t} WHERE {c} = 3" for t, c in zip(tables, columns, strict=True)]
    found = _found(league, url, *change)
    assert [one.split("(")[1][:11] for one in found] == ["result 3/0/", "result 3/1/"]


def test_an_invented_entry_and_result_are_found(league, url):
    copy = "INSERT INTO entries SELECT 9, 'id', 'nine', owner, kind, anchor, state, reason, card, "
    result = "INSERT INTO results SELECT heat, half, 'x', worker, received_s, document, replay, "
    found = _found(
        league,
        url,
        f"{copy} created_s FROM entries WHERE number = 1",
        f"{result} rejected, machine FROM results WHERE heat = 3 AND half = 0",
    )
    assert "entry id: not in the ledger" in found
    assert "heat 3: a result of it is not in the ledger" in found
    assert "heat 3: it is done, and has not one result a race" in found


def test_a_ledger_written_again_is_found_with_an_earlier_head(league, url):
    head = league.verify().head
    assert league.verify(head[:16]).mismatches == []
    league.plan(leagues.duels(league, 1, first=50))
    league.complete("w", leagues.raced(league.claim("w")))
    assert league.verify(head[:16]).mismatches == []  # it only grew
    leagues.change(
        url,
        "DELETE FROM races WHERE heat >= 10",
        "DELETE FROM results WHERE heat >= 10",
        "DELETE FROM heat_entries WHERE heat >= 10",
        "DELETE FROM heats WHERE number >= 10",
        "DELETE FROM ledger WHERE subject LIKE '10/%' OR subject LIKE '12/%' OR kind = 'settle'",
        "DELETE FROM ledger WHERE number > 29",
    )
    assert any(head[:12] in one for one in league.verify(head[:16]).mismatches)


def test_changes_of_states_by_the_program_are_not_reported(league, url):
    one, two, *_ = league.entries()
    league.move({one.id: "validating", two.id: "validating"})
    league.plan([Heat(leagues.RULES.hash, (Half("ring", (one.id, one.id)),), purpose="validation")])
    (claim,) = league.claim("w")
    league.complete("w", leagues.raced([claim]))
    lie = store.HeatOutcome(claim.heat.key, (store.RaceOutcome((2, 1), {"lie": 1}),))
    league.complete("liar", [lie])
    league.move({one.id: "refused"}, reason="its validation went two ways")
    league.move({two.id: "retired"}, reason="of age")
    assert league.verify().mismatches == []
    league.retry(claim.heat.key)  # which lets the refused one come back
    assert [one.state for one in league.entries()] == [
        "validating",
        "retired",
        "pending",
        "pending",
    ]
    assert league.verify().mismatches == []
    edited = "UPDATE entries SET state = 'refused' WHERE number = 1"
    assert len(_found(league, url, edited)) == 1


def test_states_of_an_older_league_count_from_its_upgrade(league, url):
    leagues.change(url, "DELETE FROM ledger")
    with schema.changing(league._database, lock=True) as change:
        integrity.adopt(change)  # as a version before this did, without the states
    assert league.verify().mismatches == []
    edited = "UPDATE entries SET state = 'retired' WHERE number = 2"
    assert _found(league, url, edited) == []  # docs/league.md says so
    moved = "UPDATE league SET ruleset = 2"
    assert _found(league, url, moved) == []
    assert store.upgrade(url) == [
        "states of 4 entries begin in the ledger",
        "the present rules begin in the ledger",
    ]
    assert store.upgrade(url) == [] and league.verify().mismatches == []
    assert len(_found(league, url, moved.replace("2", "1"))) == 1
    leagues.change(url, moved)
    undone = "UPDATE entries SET state = 'pending' WHERE number = 2"
    assert len(_found(league, url, undone)) == 1


def test_an_audit_on_another_class_of_machine_quarantines_nothing(league):
    league.plan(leagues.duels(league, 2, first=20))
    claims = league.claim("w", 2)
    league.complete("w", [_on("x86", one) for one in leagues.raced(claims)])
    audits = [heat_spec.audit_of(one.heat) for one in claims]
    league.plan(audits)
    other = [
        store.HeatOutcome(one.key, (store.RaceOutcome((1, 2), {"bits": 1}),) * 2, "arm")
        for one in audits
    ]
    received = league.complete("auditor", other)
    assert received.unverified == tuple(one.key for one in audits)
    assert league.counts() == {"done": 12, "cancelled": 2} and league.verify().mismatches == []
    # On a machine of the same class the same answer is evidence.
    same = [store.HeatOutcome(other[0].key, other[0].races, "x86")]
    assert league.complete("auditor", same).quarantined == (audits[0].key,)
    agreeing = leagues.raced([claims[1]])[0].races
    agrees = [store.HeatOutcome(audits[1].key, agreeing, "arm")]
    assert league.complete("auditor", agrees).accepted == (audits[1].key,)
    assert league.results(claims[1].number)[0].machine == "x86"


def _on(machine, outcome):
    return store.HeatOutcome(outcome.key, outcome.races, machine)


def test_hostile_rows_are_reported_and_not_obeyed(league, url):
    document = json.dumps({"places": ["a"], "result": {"order": 3}}).encode()
    found = _found(
        league,
        url,
        "UPDATE results SET document = :document, hash = :digest WHERE heat = 3 AND half = 0",
        "UPDATE ledger SET subject = 'x/y' WHERE number = 9",
        document=zlib.compress(document),
        digest=heat_spec.digest(document),
    )
    assert "heat 3 race 1: its result differs from its hash, or cannot be read" in found
