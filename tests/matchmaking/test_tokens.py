"""Tokens and quotas: who may do what over HTTP, and how much."""

from __future__ import annotations

import pytest
import sqlalchemy as sa

from league.errors import QuotaError, StoreError
from league.matchmaking import store
from league.matchmaking.store import Quota, Store, schema
from league.matchmaking.store.database import Database
from tests.matchmaking import leagues


@pytest.fixture
def clock() -> leagues.Clock:
    return leagues.Clock()


@pytest.fixture
def league(url, clock):
    store.create(url, name="test", ruleset=leagues.RULES).close()
    with Store(url, clock=clock) as league:
        yield league


def stored(league: Store) -> str:
    """Return all that the database holds of tokens and events, as text."""
    database = Database(league.url)
    with database.reading() as connection:
        rows = [
            list(connection.execute(sa.select(table))) for table in (schema.tokens, schema.events)
        ]
    database.close()
    return repr(rows)


def test_a_token_has_256_random_bits_of_which_only_the_hash_is_kept(league):
    made = [league.tokens.create("ann", ("submit",))[0] for _ in range(20)]
    assert len({secret[:14] for secret in made}) == 20
    assert all(len(secret.removeprefix("league_")) == 43 for secret in made)  # 43 * 6 bits >= 256
    assert not any(secret.removeprefix("league_") in stored(league) for secret in made)
    assert [league.tokens.find(secret).number for secret in made] == list(range(1, 21))


@pytest.mark.parametrize("secret", ["", "league_", "x" * 100_000, "\x00", "\ud800", "1", "%"])
def test_no_other_text_is_a_token(league, secret):
    league.tokens.create("ann", ("submit",))
    assert league.tokens.find(secret) is None


def test_a_token_stands_for_its_owner_and_its_scopes(league):
    token = league.tokens.find(league.tokens.create("ann", ("worker", "submit"))[0])
    assert (token.owner, token.scopes) == ("ann", ("submit", "worker"))
    assert token.allows("submit") and token.allows("worker") and not token.allows("admin")
    admin = league.tokens.find(league.tokens.create("root", ("admin",))[0])
    assert all(admin.allows(scope) for scope in store.SCOPES)


def test_a_token_ends_when_its_life_does(league, clock):
    secret, token = league.tokens.create("ann", ("submit",), life_s=60.0)
    clock.now_s += 59.9
    assert league.tokens.find(secret).number == token.number
    clock.now_s += 0.1
    assert league.tokens.find(secret) is None and league.tokens.active() == []
    assert league.tokens.listed()[0].state(clock.now_s) == "expired"


@pytest.mark.parametrize("by", ["number", "secret"])
def test_a_revoked_token_is_refused_at_once_and_the_others_stay(league, clock, by):
    secrets = [league.tokens.create(name, ("submit",))[0] for name in ("ann", "bob")]
    assert league.tokens.revoke("1" if by == "number" else secrets[0]).state(0.0) == "revoked"
    assert league.tokens.find(secrets[0]) is None
    assert [token.owner for token in league.tokens.active()] == ["bob"]
    clock.now_s += 5.0
    assert league.tokens.revoke("1").revoked_s == clock.now_s - 5.0  # once is enough


def test_the_last_use_is_noted_to_the_hour(league, clock):
    secret, _ = league.tokens.create("ann", ("submit",))
    for wait_s, noted_s in ((0.0, 1000.0), (3000.0, 1000.0), (700.0, 4700.0)):
        clock.now_s += wait_s
        league.tokens.find(secret)
        assert league.tokens.listed()[0].used_s == noted_s


@pytest.mark.parametrize(
    ("owner", "scopes", "life_s", "message"),
    [
        ("ann", (), None, "the scope 'none' is not known"),
        ("ann", ("root",), None, "'root' is not known: give one or more of submit, worker, admin"),
        ("ann", ("submit",), 0.0, "life is 0 days: give more than 0"),
        ("ann", ("submit",), 1e12, "at most 3650"),
        ("ann", ("submit",), float("nan"), "life is nan days"),
        ("", ("submit",), None, "an owner's name is ''"),
        ("ANN\u200b", ("submit",), None, "an owner's name"),
        ("Bob", ("submit",), None, "looks like 'bob'"),
    ],
)
def test_an_impossible_token_is_one_sentence_and_nothing_is_kept(
    league, owner, scopes, life_s, message
):
    league.tokens.create("bob", ("submit",))
    with pytest.raises(StoreError, match=message):
        league.tokens.create(owner, scopes, life_s=life_s)
    assert len(league.tokens.listed()) == 1


def test_what_is_no_token_cannot_be_revoked(league):
    for which in ("7", "league_x", "", "9" * 500):
        with pytest.raises(StoreError, match="no such token"):
            league.tokens.revoke(which)


def entered(league: Store, name: str, quota: Quota, owner: str = "ann"):
    return league.submit(name, owner, weights=name.encode(), quota=quota)


def test_an_owner_has_so_many_entries_at_once(league):
    quota = Quota(entries=2, per_day=100)
    first, _ = (entered(league, name, quota) for name in ("a", "b"))
    with pytest.raises(QuotaError, match="'ann' has 2 entries, and an owner may have 2"):
        entered(league, "c", quota)
    assert entered(league, "a", quota) == first  # known already: not one more
    assert entered(league, "d", quota, "bob").owner == "bob"
    league.move({first.id: "retired"})
    assert entered(league, "c", quota).state == "pending"
    assert [entry.name for entry in league.entries()] == ["a", "b", "d", "c"]


def test_an_owner_makes_so_many_submissions_within_24_hours(league, clock):
    quota = Quota(entries=100, per_day=2)
    for name in ("a", "b"):
        entered(league, name, quota)
        clock.now_s += 3600.0
    with pytest.raises(QuotaError, match=r"2 submissions within 24 hours.*try again in 22 h"):
        entered(league, "c", quota)
    clock.now_s += 22 * 3600.0
    entered(league, "c", quota)
    with pytest.raises(QuotaError, match="try again in 1 h"):
        entered(league, "d", quota)
    clock.now_s += 3600.0 - 60.0
    with pytest.raises(QuotaError, match="try again in 1 h"):  # not in 0
        entered(league, "d", quota)


@pytest.fixture
def raced(url):
    """Return a league in which a worker of owner 1 has raced all heats but two."""
    with leagues.founded(url) as league:
        for owner in ("owner 1", "owner 1", "lender"):
            league.tokens.create(owner, ("worker",))
        league.plan(leagues.duels(league, 6))
        league.complete("3/lender/w", leagues.raced(league.claim("3/lender/w", 4)))
        yield league


def test_an_owners_workers_are_not_lent_heats_of_own_entries(raced):
    own = {record.number for record in raced.heats(entries=[raced.entry("e3").number])}
    waiting = {record.number for record in raced.heats(("planned",))}
    assert own & waiting and waiting - own
    lent = raced.claim("9/owner 3/w", 99, lender="owner 3")
    assert {record.number for record in lent} == waiting - own


def test_an_owners_workers_do_not_audit_what_the_owners_workers_raced(raced):
    done = raced.heats(("done",))
    assert raced.audit([record.heat.key for record in done], 1.0) == 4
    lent = raced.claim("3/lender/v", 99, lender="lender")
    assert len(lent) == 2 and not any(record.heat.audits for record in lent)
    # 13 is no token of the lender, although its name begins like one; an owner of no entries.
    others = raced.claim("13/other/w", 99, lender="other")
    assert [record.heat.audits for record in others] == [record.heat.key for record in done]
    assert raced.complete("13/other/w", leagues.raced(others)).accepted


def test_audits_are_raced_in_turn_with_rated_heats(raced):
    done = raced.heats(("done",))[0]
    raced.audit([done.heat.key], 1.0)
    raced.plan(leagues.duels(raced, 2, first=50))
    purposes = [record.heat.purpose for record in raced.claim("w", 99)]
    assert purposes == ["rated", "rated", "audit", "rated", "rated"]


def test_a_heartbeat_renews_only_the_heats_that_it_names(url, clock):
    leagues.founded(url).close()
    with Store(url, clock=clock) as league:
        league.plan(leagues.duels(league, 3))
        keys = [claim.heat.key for claim in league.claim("w", 3, lease_s=10.0)]
        clock.now_s += 6.0
        assert league.heartbeat("w", lease_s=10.0, keys=keys[:1]) == keys[:1]
        assert league.heartbeat("w", lease_s=10.0, keys=[]) == []
        clock.now_s += 6.0
        assert {claim.heat.key for claim in league.claim("v", 9)} == set(keys[1:])
