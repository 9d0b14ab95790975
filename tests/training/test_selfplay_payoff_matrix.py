"""The payoff matrix: who is champion, what its past is, and what is written and drawn of it."""

from __future__ import annotations

import json
from itertools import combinations

import pytest
from small_play import CAR, RING, SHORT, blind, learnt

from league.agents.policy import Policy
from league.training.selfplay import matches, payoff_matrix
from league.training.selfplay.payoff_matrix import PayoffMatrix

SNAPSHOT = PayoffMatrix(  # its champion is the second snapshot, which the later two fall short of
    ("centerline", "parent", "000064", "000128", "000192", "final"),
    16,
    (
        (None, 0.5, 0.25, 0.0, 0.25, 0.0),
        (0.5, None, 0.5, 0.25, 0.75, 0.5),
        (0.75, 0.5, None, 0.5, 0.25, 0.5),
        (1.0, 0.75, 0.5, None, 0.375, 0.75),
        (0.75, 0.25, 0.75, 0.625, None, 0.5),
        (1.0, 0.5, 0.5, 0.25, 0.5, None),
    ),
    (0.0,) * 6,
    (0.0,) * 6,
    (None, 6.0, 5.5, 5.25, 5.25, 5.0),
)


def test_the_report_races_everybody(tmp_path):
    play, _ = learnt(tmp_path, blind())
    found = play.report(blind(3))
    assert found.names[0] == "centerline" and found.names[-1] == "final"
    assert found.wins[0][0] is None
    for row, rates in enumerate(found.wins):
        for column, rate in enumerate(rates):
            if rate is not None:
                assert rate + found.wins[column][row] == 1.0
    assert found.smallest == min(found.past.values())


def test_a_pair_races_in_the_report_as_it_does_alone(tmp_path):
    play, _ = learnt(tmp_path, blind())
    found = play.report(blind(3))
    drivers = [Policy(blind(3), CAR), Policy(play.snapshot("parent")[1], CAR)]
    ((one, _),) = matches.race_pairs(RING, CAR, drivers, [(0, 1)], SHORT.match, races=2).values()
    assert found.wins[-1][found.names.index("parent")] == one.win_rate


def test_champion_wins_most_and_of_equals_the_newest():
    def matrix(*rows):
        names = ("centerline", "parent", "000016", "000032", "final")
        return PayoffMatrix(names, 2, rows, (0.0,) * 5, (0.0,) * 5, (None,) * 5)

    parent = (1.0, None, 1.0, 1.0, 1.0)  # the parent is no past self, however it wins
    best = (1.0, 0.0, None, 0.5, 0.75)
    worse = (0.75, 0.0, 0.5, None, 0.5)
    rest = (None, 0.0, 0.0, 0.25, 0.5)
    assert matrix(rest, parent, best, worse, (0.5, 0.0, 0.25, 0.5, None)).champion == "000016"
    assert matrix(rest, parent, worse, worse, (0.75, 0.0, 0.5, 0.5, None)).champion == "final"


def test_champion_is_not_decided_among_selves_alone():
    names = ("centerline", "parent", "000064", "000128", "final")
    wins = (  # a run of the duelist: of like pace, selves win by their slots, and by chance
        (None, 0.38, 0.44, 0.13, 0.06),
        (0.62, None, 0.50, 0.50, 0.31),
        (0.56, 0.50, None, 0.50, 0.56),
        (0.87, 0.50, 0.50, None, 0.56),
        (0.94, 0.69, 0.44, 0.44, None),
    )
    rows = (0.0,) * 5, (0.0,) * 5, (None,) * 5
    assert PayoffMatrix(names, 16, wins, *rows).champion == "final"
    # Alone with the run's past, without a parent or scripted drivers, selves must decide.
    alone = tuple(row[2:] for row in wins[2:])
    assert PayoffMatrix(names[2:], 16, alone, *(row[:3] for row in rows)).champion == "000128"
    assert PayoffMatrix(("final",), 16, ((None,),), (0.0,), (0.0,), (None,)).champion == "final"


def test_the_past_of_a_snapshot_is_its_parent_and_who_is_older():
    assert SNAPSHOT.champion == "000128"
    assert SNAPSHOT.past == {"parent": 0.75, "000064": 0.5}
    assert SNAPSHOT.smallest == 0.5  # .375 is against a later self, which it cannot have forgotten
    last = {"parent": 0.5, "000064": 0.5, "000128": 0.25, "000192": 0.5}
    assert SNAPSHOT.past_of("final") == last
    assert SNAPSHOT.past_of("parent") == {}


def test_the_champions_win_rate_against_each_driver():
    assert SNAPSHOT.against("parent") == 0.75
    assert SNAPSHOT.against("centerline") == 1.0
    assert SNAPSHOT.against("000192") == 0.375
    assert SNAPSHOT.against("000128") is None and SNAPSHOT.against("nobody") is None


def test_the_champion_and_the_last_policy_are_summed_up_apart(tmp_path):
    SNAPSHOT.write(tmp_path / "matrix.json")
    content = json.loads((tmp_path / "matrix.json").read_text())
    assert (content["champion"], content["smallest_win_rate_against_the_past"]) == ("000128", 0.5)
    assert content["win_rates_against_the_past"] == SNAPSHOT.past
    assert content["final"]["smallest_win_rate_against_the_past"] == 0.25
    assert content["final"]["win_rates_against_the_past"] == SNAPSHOT.past_of("final")


@pytest.mark.parametrize("count", [1, 2, 6, 10])
def test_the_picture_shows_few_drivers_and_many(tmp_path, count):
    names = ("centerline", "parent", *(f"{64 * n:06d}" for n in range(1, 8)), "final")[-count:]
    wins: list[list[float | None]] = [[None] * count for _ in names]
    for one, two in combinations(range(count), 2):
        wins[one][two], wins[two][one] = 0.75, 0.25
    rows = tuple(tuple(row) for row in wins)
    found = PayoffMatrix(names, 16, rows, (0.0,) * count, (0.0,) * count, (None,) * count)
    assert (found.champion == "final") == (count == 1)
    payoff_matrix.draw(found, tmp_path / "matrix.png")
    assert (tmp_path / "matrix.png").read_bytes()[:4] == b"\x89PNG"
