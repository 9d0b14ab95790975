"""Divisions: sizes, promotion beyond chance, newcomers, and what safety asks for."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from league.matchmaking import divisions
from league.matchmaking.divisions import SeasonSettings
from league.matchmaking.safety import Safety

SETTINGS = SeasonSettings(division_size=2, least_safety=2.0)


def field(**elo):
    """Return ratings, sure to 20 Elo, of entries a = 1, b = 2, ..."""
    numbers = np.array([ord(name) - ord("a") + 1 for name in elo])
    values = np.array(list(elo.values()), float)
    order = np.argsort(-values, kind="stable")
    sd = np.full(len(values), 20.0)
    fitted: Any = SimpleNamespace(entries=numbers, elo=values, sd=sd, order=lambda: order)
    return fitted


def safe(rating, corners=200.0):
    return Safety(rating, 0.0, 0, corners, 50, ())


def after(current, fitted, safety=None, settings=SETTINGS):
    """Return who is in which division afterwards, by letters, and why who moved."""
    members = fitted.entries.tolist()
    moves = divisions.next_moves(current, fitted, members, safety or {}, settings, round=3, heat=17)
    now = {**current, **{one.entry: one.division for one in moves}}
    letters = {chr(ord("a") + entry - 1): division for entry, division in sorted(now.items())}
    return letters, {chr(ord("a") + one.entry - 1): one.reason for one in moves}


def test_a_season_starts_by_rating():
    now, why = after({}, field(a=900, b=1200, c=1100, d=1000, e=800))
    assert now == {"b": 1, "c": 1, "d": 2, "a": 2, "e": 3}
    assert set(why.values()) == {"start"}


def test_near_equals_do_not_change_places_and_clear_ones_do():
    current = {1: 1, 2: 1, 3: 2, 4: 2}
    # 95 % of a difference of two with 20 each lie within 1.96 * 28.3 = 55.4 Elo.
    assert after(current, field(a=1200, b=1000, c=1054, d=900))[1] == {}
    now, why = after(current, field(a=1200, b=1000, c=1056, d=900))
    assert now == {"a": 1, "b": 2, "c": 1, "d": 2} and why == {"b": "rating", "c": "rating"}
    # Hysteresis: back only beyond chance again.
    moved = {1: 1, 2: 2, 3: 1, 4: 2}
    assert after(moved, field(a=1200, b=1054, c=1000, d=900))[1] == {}


def test_one_far_too_low_rises_one_division_after_another():
    current = {1: 1, 2: 1, 3: 2, 4: 2, 5: 3, 6: 3}
    now, _ = after(current, field(a=1200, b=1190, c=1000, d=990, e=1500, f=700))
    assert now["e"] == 2  # upper boundaries are judged first: the next round takes it on
    now, _ = after({**current, 5: 2, 4: 3}, field(a=1200, b=1190, c=1000, d=990, e=1500, f=700))
    assert now["e"] == 1 and now["b"] == 2


def test_newcomers_begin_at_the_bottom_and_free_places_are_filled():
    current = {1: 1, 2: 1, 3: 2}
    now, why = after(current, field(a=1200, b=1190, c=1000, d=1195))
    assert now["d"] == 2 and why == {"d": "new"}
    now, why = after({1: 1, 2: 1, 3: 2, 4: 2}, field(a=1200, c=1000, d=1010))
    assert now == {"a": 1, "b": 0, "c": 2, "d": 1} and why == {"b": "left", "d": "place"}
    now, why = after({1: 1, 2: 1, 3: 2, 4: 2}, field(a=1200, b=1190, c=1000, d=1010, e=500))
    assert now["e"] == 3 and why == {"e": "new"}


def test_the_top_division_asks_for_safety_with_a_margin():
    current = {1: 1, 2: 1, 3: 2, 4: 2}
    ratings = field(a=1200, b=1190, c=1000, d=990)
    assert after(current, ratings, {1: safe(1.75)})[1] == {}
    now, why = after(current, ratings, {1: safe(1.65)})
    assert now == {"a": 2, "b": 1, "c": 1, "d": 2}
    assert why == {"a": "safety", "c": "place"}
    # Back only from 2.0 on; one of which little is known may enter.
    current = {1: 2, 2: 1, 3: 1, 4: 2}
    assert after(current, ratings, {1: safe(1.95)})[1] == {}
    assert after(current, ratings, {1: safe(2.0)})[0]["a"] == 1
    assert after(current, ratings, {1: safe(0.5, corners=99)})[0]["a"] == 1


def test_no_one_enters_the_top_division_by_being_unsafe_but_first():
    now, _ = after({}, field(a=1200, b=1100, c=1000), {1: safe(1.0)})
    assert now == {"a": 2, "b": 1, "c": 1}


@pytest.mark.parametrize("seed", range(5))
def test_sizes_hold_whatever_comes_and_a_settled_table_stays(seed):
    generator = np.random.default_rng(seed)
    settings = SeasonSettings(division_size=3)
    current = {}
    for _ in range(12):
        names = [chr(ord("a") + n) for n in range(14) if generator.random() < 0.8]
        fitted = field(**{name: float(generator.normal(1000, 200)) for name in names})
        members = fitted.entries.tolist()
        moves = divisions.next_moves(current, fitted, members, {}, settings, round=1, heat=1)
        current = divisions.assigned([*_as_moves(current), *moves])
        assert sorted(current) == sorted(members)
        sizes = np.bincount(list(current.values()))[1:].tolist()
        assert all(size == 3 for size in sizes[:-1]) and 1 <= sizes[-1] <= 3
        again = current
        for _ in range(5):
            moves = divisions.next_moves(again, fitted, members, {}, settings, round=1, heat=1)
            again = divisions.assigned([*_as_moves(again), *moves])
        assert divisions.next_moves(again, fitted, members, {}, settings, round=1, heat=1) == []


def _as_moves(current):
    return [divisions.Move(0, entry, division, 0, "place") for entry, division in current.items()]
