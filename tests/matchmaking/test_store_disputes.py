"""Disputes: two results of one race, and what settles them; what races tell besides places."""

from __future__ import annotations

import pytest

from league.matchmaking import store
from league.matchmaking.pairing import heat_spec
from tests.matchmaking import leagues


@pytest.fixture
def league(url):
    with leagues.founded(url, clock=leagues.Clock()) as league:
        yield league


def _outcome(claim):
    return leagues.raced([claim])[0]


def _turned(race):
    return store.RaceOutcome(race.places[::-1], race.result, race.replay)


def _disputed(league, count=1):
    """Return heats on which `honest` and `liar` differ, by claim."""
    league.plan(leagues.duels(league, count))
    claims = league.claim("honest", count)
    league.complete("honest", leagues.raced(claims))
    lies = [
        store.HeatOutcome(one.heat.key, tuple(_turned(r) for r in _outcome(one).races))
        for one in claims
    ]
    league.complete("liar", lies)
    assert league.counts() == {"quarantined": count}
    return claims, lies


@pytest.mark.parametrize("right", ["honest", "liar"])
def test_a_dispute_is_settled_by_a_third_worker_who_agrees_with_one(league, right):
    (claim,), (lie,) = _disputed(league)
    truth = lie if right == "liar" else _outcome(claim)
    assert league.retry(claim.heat.key) == claim.number
    (again,) = league.claim("third", 1)
    assert (again.number, again.seeds) == (claim.number, claim.seeds)
    assert league.complete("third", [truth, truth]).accepted == (claim.heat.key,)
    assert league.heat(claim.number).state == "done"
    races = league.races()
    assert races.heat.tolist() == [claim.number] * 2
    assert races.places.tolist() == [list(race.places) for race in truth.races]
    verdicts = {(r.worker, r.rejected) for r in league.results(claim.number)}
    assert verdicts == {("honest", right == "liar"), ("liar", right == "honest")}
    assert [e.subject for e in leagues.events(league) if e.action == "settle"] == [
        str(claim.number)
    ]
    # The one who was wrong may send again what it likes.
    wrong = _outcome(claim) if right == "liar" else lie
    assert league.complete("honest", [wrong]).repeated
    assert league.complete("third", [truth]).repeated
    assert len(league.races().heat) == 2 and league.counts() == {"done": 1}


def test_a_dispute_stays_when_the_third_result_is_another_or_comes_from_the_disputants(league):
    (claim, other), (lie, _) = _disputed(league, 2)
    league.retry(claim.heat.key)
    league.claim("third", 1)
    # An old result sent again is no third opinion, though the heat waits for one.
    assert league.complete("liar", [lie]).quarantined
    assert league.heat(claim.number).state == "claimed" and len(league.races().heat) == 0
    odd = tuple(store.RaceOutcome(r.places, {"odd": True}) for r in lie.races)
    assert league.complete("third", [store.HeatOutcome(claim.heat.key, odd)]).quarantined
    assert league.heat(claim.number).state == "quarantined"
    assert len(league.results(claim.number)) == 6 and len(league.races().heat) == 0
    # It may be tried once more, and the other one is as it was.
    assert league.retry(claim.heat.key) == claim.number
    assert league.heat(other.number).state == "quarantined"


def test_a_disputed_audit_is_settled_by_racing_the_heat_it_audits(league):
    league.plan(leagues.duels(league, 1))
    (claim,) = league.claim("w", 1)
    league.complete("w", leagues.raced([claim]))
    league.plan([heat_spec.audit_of(claim.heat)])
    (audit,) = league.claim("auditor", 1)
    lie = store.HeatOutcome(audit.heat.key, tuple(map(_turned, _outcome(claim).races)))
    assert league.complete("auditor", [lie]).quarantined
    assert league.counts() == {"quarantined": 2}
    assert league.retry(audit.heat.key) == claim.number
    assert [one.number for one in league.claim("third", 9)] == [claim.number]
    assert league.complete("third", [_outcome(claim)]).accepted
    assert league.counts() == {"done": 2} and len(league.races().heat) == 2


def test_races_tell_who_finished_and_the_best_laps(league):
    league.plan(leagues.duels(league, 2))
    first, second = league.claim("w", 2)
    order = [
        {"car": 1, "finished": True, "lap_times_s": [12.5, 11.2345]},
        {"car": 0, "finished": False, "lap_times_s": []},
    ]
    outcome = tuple(store.RaceOutcome((2, 1), {"order": order}) for _ in first.seeds)
    league.complete("w", [store.HeatOutcome(first.heat.key, outcome), _outcome(second)])
    races = league.races()
    # 2^31 known, 2^30 finished, 11.2345 s are 11,234 ms (half to even); leagues.race tells nothing.
    assert races.runs.tolist()[:2] == [[2**31, 2**31 + 2**30 + 11234]] * 2
    assert races.runs.tolist()[2:] == [[0, 0]] * 2
    assert races.track.tolist() == [0, 1, 0, 1]  # ring, then square


def test_a_league_of_the_first_version_is_brought_up_to_date_with_its_races(url):
    with leagues.founded(url) as league:
        league.plan(leagues.duels(league, 2))
        claims = league.claim("w", 2)
        order = [{"car": 0, "finished": True, "lap_times_s": [9.5]}]
        for claim in claims:
            outcome = tuple(store.RaceOutcome((1, 2), {"order": order}) for _ in claim.seeds)
            league.complete("w", [store.HeatOutcome(claim.heat.key, outcome)])
        new = league.races()
    leagues.change(
        url,
        # As version 0001 wrote them: heat and half, then entries and places; no runs, no rejected.
        "UPDATE races SET packed = substr(packed, 1, 10) || substr(packed, 13, 20)",
        *leagues.FIRST_VERSION,
    )
    done = store.upgrade(url)
    assert [line.split(":")[0] for line in done[:2]] == ["version 0002", "version 0003"]
    assert done[-3] == "9 records begin the ledger"  # 1 ruleset, 4 entries, 4 results
    with store.Store(url) as league:
        assert league.verify().mismatches == [] and league.verify().races == 4
        old = league.races()
        for name in ("heat", "half", "track", "entries", "places", "runs"):
            assert getattr(old, name).tolist() == getattr(new, name).tolist()
        assert new.runs[0, 0] == 2**31 + 2**30 + 9500 and new.runs[0, 1] == 0
