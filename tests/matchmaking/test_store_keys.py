"""Keys: the same heat has one key on every machine, and a seed that cannot be guessed."""

from __future__ import annotations

import hashlib
import hmac
from dataclasses import asdict, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from league.matchmaking.pairing import heat_spec
from league.matchmaking.pairing.heat_spec import Half, Heat, Ruleset
from league.matchmaking.store import RaceOutcome

A, B = "a" * 64, "b" * 64
HEAT = heat_spec.mirrored("r" * 64, ("ring", "square"), (A, B), 7)


def test_canonical_json_is_the_same_whatever_the_order_of_keys():
    assert heat_spec.canonical({"b": [1, 0.1], "a": "ü"}) == '{"a":"ü","b":[1,0.1]}'.encode()
    assert heat_spec.canonical({"a": 1, "b": 2}) == heat_spec.canonical({"b": 2, "a": 1})


def test_canonical_json_refuses_numbers_that_are_none():
    with pytest.raises(ValueError, match="JSON"):
        heat_spec.canonical({"time_s": float("inf")})


def test_key_of_a_heat_is_the_hash_of_all_that_it_is():
    # Written out by hand: this text, and so every stored key, must never change.
    halves = f'[{{"grid":["{A}","{B}"],"track":"ring"}},{{"grid":["{B}","{A}"],"track":"square"}}]'
    text = f'{{"audits":"","draw":7,"halves":{halves},"purpose":"rated","ruleset":"{"r" * 64}"}}'
    assert HEAT.key == hashlib.sha256(text.encode()).hexdigest()


@pytest.mark.parametrize(
    "other",
    [
        replace(HEAT, ruleset="s" * 64),
        replace(HEAT, draw=8),
        replace(HEAT, purpose="gauntlet"),
        replace(HEAT, halves=HEAT.halves[::-1]),
        replace(HEAT, halves=HEAT.halves[:1]),
        replace(HEAT, halves=(Half("oval", (A, B)), HEAT.halves[1])),
        heat_spec.audit_of(HEAT),
    ],
)
def test_a_heat_that_differs_in_anything_has_another_key(other):
    assert other.key != HEAT.key


def test_key_is_not_remembered_from_the_heat_it_was_made_of():
    assert HEAT.key  # worked out, and kept
    assert replace(HEAT, draw=7).key == HEAT.key
    assert replace(HEAT, draw=9).key != HEAT.key


def test_seed_is_the_hmac_of_key_and_race_under_the_secret():
    digest = hmac.new(b"secret", f"{HEAT.key}/1".encode(), "sha256").digest()
    assert heat_spec.seed(b"secret", HEAT.key, 1) == int.from_bytes(digest[:8], "big") // 2
    assert HEAT.seeds(b"secret") == tuple(heat_spec.seed(b"secret", HEAT.key, n) for n in (0, 1))


@given(st.binary(min_size=1, max_size=40), st.integers(0, 7))
def test_seeds_fit_a_race_and_differ_with_the_secret(secret, half):
    seed = heat_spec.seed(secret, HEAT.key, half)
    assert 0 <= seed < 2**63
    assert seed != heat_spec.seed(secret + b"x", HEAT.key, half)


def test_an_audit_has_the_seeds_of_the_heat_it_audits():
    assert heat_spec.audit_of(HEAT, 3).seeds(b"secret") == HEAT.seeds(b"secret")
    assert heat_spec.audit_of(HEAT, 3).key != heat_spec.audit_of(HEAT, 4).key


@pytest.mark.parametrize(
    "wrong",
    [
        {"halves": ()},
        {"halves": (Half("ring", ()),)},
        {"halves": (Half("ring", (A,) * 9),)},
        {"purpose": "audit"},
        {"audits": "c" * 64},
    ],
)
def test_a_heat_that_cannot_be_is_refused(wrong):
    with pytest.raises(ValueError, match=r"race|audit"):
        replace(HEAT, **wrong)


def test_ruleset_comes_back_from_its_settings_with_its_hash():
    rules = Ruleset(tracks=("a", "b"), kind="time_trial", laps=5, cars=4, physics="2")
    again = Ruleset.of(asdict(rules))
    assert (again, again.hash) == (rules, rules.hash)
    assert replace(rules, physics="3").hash != rules.hash


def test_ruleset_of_an_older_league_keeps_its_hash_and_its_rules():
    new = Ruleset(physics="4")
    names = ("tracks", "kind", "laps", "cars", "solver", "physics", "sensors", "max_time_s")
    stored = {name: asdict(new)[name] for name in (*names, "variation")}
    old = Ruleset.of(stored)
    assert (old.rules, old.obstacles, old.obstacle_kind) == ("deepracer", 0, "box")
    assert old.hash == heat_spec.digest(heat_spec.canonical(stored))
    hashes = {old.hash, new.hash, replace(new, obstacles=6).hash, replace(old, obstacles=6).hash}
    assert len(hashes) == 4


@pytest.mark.parametrize(
    "wrong", [{"tracks": ()}, {"cars": 0}, {"cars": 9}, {"laps": 0}, {"obstacles": 33}]
)
def test_rules_that_cannot_be_raced_are_refused(wrong):
    with pytest.raises(ValueError):
        Ruleset(**wrong)


def test_hash_of_a_result_does_not_depend_on_the_order_of_keys():
    one, same, other = ({"a": 1, "b": 2}, {"b": 2, "a": 1}, {"a": 1, "b": 2.5})
    assert RaceOutcome((1,), one).hash == RaceOutcome((1,), same).hash
    assert RaceOutcome((1,), one).hash != RaceOutcome((1,), other).hash


def test_entries_of_a_heat_are_named_once():
    assert Heat("r", (Half("ring", (B, A)), Half("ring", (A, B, B)))).entries == (A, B)
