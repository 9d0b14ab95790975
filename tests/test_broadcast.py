"""What is said about a race, and what a camera shows of it, on scenes made by hand."""

import numpy as np
import pytest

from league.race_spec import CarResult, Entry, Event, RaceResult, RaceSpec
from league.replay.broadcast import (
    HOLD_S,
    PACK,
    SHORTEST_S,
    Commentator,
    Director,
    Remark,
    length_of_race,
    shortened,
)
from tests.scenes import make_ring, make_straight

STEP_S = 1 / 15


def spec(cars: int = 2, **settings) -> RaceSpec:
    return RaceSpec(laps=3, entries=tuple(Entry(name="ABCD"[k]) for k in range(cars)), **settings)


def scene(distance, speed=2.0, ghost=(), laps=0):
    """Return cars along a straight along x."""
    distance = np.array(distance, float)
    zero = np.zeros(len(distance))
    return {
        "x": distance,
        "y": zero,
        "velocity_x": zero + speed,
        "velocity_y": zero,
        "distance": distance,
        "laps": zero + laps,
        "ghost": np.array([car in ghost for car in range(len(distance))], float),
    }


def story_of(gaps, events=None, cars=2):
    """Return what is said while car 1 is so far behind car 0 [m], a number for each step."""
    commentator, lines = Commentator(spec(cars), "ABCD"[:cars]), []
    for step, gap in enumerate(gaps):
        lead = 10 + 0.13 * step
        at = (events or {}).get(step, ())
        lines += commentator.add(2 + step * STEP_S, scene([lead, lead - gap]), at)
    return lines


def kinds(lines):
    return [line.kind for line in lines]


def event(kind, car=0, other=None, value=None, step=0):
    return Event(time_s=2 + step * STEP_S, kind=kind, car=car, other=other, value=value)


def test_a_car_that_comes_closer_attacks_with_the_gap_in_seconds():
    (line,) = story_of([0.9, 0.75, 0.6, 0.6, 0.6])
    assert (line.kind, line.car, line.lap) == ("attack", 1, 1)
    assert line.text == "B attacks A, 0.30 s behind"  # 0.6 m at 2 m/s
    assert line.stamped == "lap 1, 0:02.1: B attacks A, 0.30 s behind"


def test_who_only_follows_attacks_nobody():
    assert story_of([0.6] * 30) == []


def test_an_attacker_that_falls_back_was_held_off_and_after_a_pass_nobody_was():
    there_and_back = [0.9, 0.6, 0.4, 0.6, 1.0, 1.6]
    assert [line.text for line in story_of(there_and_back)][1:] == ["A defends against B"]
    passing = [0.9, 0.6, 0.4, 0.0, -0.4, -1.0, -1.6]
    lines = story_of(passing, {4: [event("overtake", 1, 0, step=4)]})
    assert kinds(lines) == ["attack", "side_by_side", "overtake"]
    assert lines[-1].text == "B passes A for the lead"


def test_cars_are_side_by_side_before_one_passes_in_the_same_step():
    lines = story_of([0.5, -0.1], {1: [event("overtake", 1, 0, step=1)]})
    assert kinds(lines) == ["side_by_side", "overtake"]


def test_a_pass_soon_answered_is_a_pass_back():
    swaps = {3: [event("overtake", 1, 0, step=3)], 9: [event("overtake", 0, 1, step=9)]}
    gaps = [0.6, 0.3, 0.0, -0.3, -0.4, -0.4, -0.3, 0.0, 0.2, 0.3]
    passes = [line.text for line in story_of(gaps, swaps) if line.kind == "overtake"]
    assert passes == ["B passes A for the lead", "A passes B back for the lead"]


def test_pairs_close_to_each_other_for_long_are_not_mentioned_all_the_time():
    wobble = [0.5 + 0.15 * np.sin(step) for step in range(90)]
    assert kinds(story_of(wobble)).count("attack") == 1


def test_cars_that_cannot_collide_do_not_fight():
    commentator = Commentator(spec(), "AB")
    for step in range(20):
        cars = scene([10.0, 9.5 + 0.02 * step], ghost=[0])
        assert commentator.add(2 + step * STEP_S, cars) == []


def test_a_contact_names_who_is_to_blame_and_how_hard_it_was():
    commentator = Commentator(spec(), "AB")
    cars = scene([10.0, 9.7])
    cars["velocity_x"] = np.array([1.0, 2.5])
    commentator.add(2.0, cars)
    hit = [event("crash", 1, 0, 3.2), event("contact", 0)]
    (line,) = [one for one in commentator.add(2.1, cars, hit) if one.kind != "attack"]
    assert line.text == "B runs into A at 1.5 m/s, 3.2 s penalty"
    light = [event("touch", 1, 0, 0.12), event("contact", 0)]
    assert [one.text for one in commentator.add(2.2, cars, light)] == [
        "B touches A lightly at 0.1 m/s"
    ]


def test_the_gap_at_the_line_is_that_of_the_lap_times_and_the_last_one_is_the_margin():
    commentator, lines = Commentator(spec(), "AB"), []
    for lap, (first, second) in enumerate([(10.0, 10.5), (9.0, 9.25), (9.0, 9.0)], 1):
        laps = [event("lap", 0, value=first), event("lap", 1, value=second)]
        lines += commentator.add(10.0 * lap, scene([40.0, 30.0], laps=lap), laps)
    assert [(line.lap, line.text) for line in lines if line.kind in ("gap", "winner")] == [
        (1, "A leads B by 0.50 s at the line"),
        (2, "A leads B by 0.75 s at the line"),
        (3, "A wins, 0.75 s before B"),
    ]


def result(finished, **settings):
    order = tuple(
        CarResult(
            car=car, name="AB"[car], place=car + 1, finished=done, laps=3 if done else 1,
            total_s=30.0, lap_times_s=(), distance=17.0, off_tracks=0, crashes=0,
            contacts_taken=0, immobilised=0, reversed=0, penalty_s=0.0, overtakes=0,
        )
        for car, done in enumerate(finished)
    )  # fmt: skip
    return RaceResult(
        spec=spec(**settings), order=order, steps=450, race_s=30.0, lead_changes=0, events=()
    )


@pytest.mark.parametrize(
    ("finished", "settings", "text"),
    [
        ((True, False), {}, "A wins, the only one to finish"),
        ((False, False), {}, "A comes first with 1 lap and 17.0 m"),
        ((True, True), {"ranking": "best"}, "A wins by its best lap time, before B"),
    ],
)
def test_every_race_has_a_winner_however_it_ends(finished, settings, text):
    lines = Commentator(spec(**settings), "AB").end(result(finished, **settings))
    assert [line.text for line in lines] == [text]


def test_a_short_story_keeps_what_matters_in_order_of_time():
    lines = [Remark(float(k), "attack", 0, 1, "") for k in range(20)]
    lines += [Remark(3.5, "overtake", 0, 1, ""), Remark(21.0, "winner", 0, 3, "")]
    short = shortened(lines, 4)
    assert [line.time_s for line in short] == [3.5, 18.0, 19.0, 21.0]


# The director.


def shots(distances, ghosts=None):
    """Return the shot at each step."""
    director = Director()
    return [
        director.add(step * STEP_S, scene(distance, ghost=(ghosts or {}).get(step, ())))
        for step, distance in enumerate(distances)
    ]


def test_the_camera_shows_the_closest_fight_and_not_the_leader():
    director = Director()
    shot = director.add(0.0, scene([20.0, 10.0, 9.5]))
    assert (shot.front, shot.rear) == (1, 2)
    assert director.sentence(("A", "B", "C"), scene([20.0, 10.0, 9.5])) == "C attacks B, 0.2 s"
    assert director.sentence(("A", "B", "C"), scene([20.0, 10.0, 9.9])) == "C and B side by side"


def test_cars_that_stand_for_a_penalty_are_not_shown_as_a_fight():
    director = Director()
    director.add(0.0, scene([20.0, 10.0, 9.9]))
    for ghost in ([1], [2], [1, 2]):
        assert director.sentence(("A", "B", "C"), scene([20.0, 10.0, 9.9], ghost=ghost)) == ""


def test_without_a_fight_the_camera_shows_the_leader():
    assert {(shot.front, shot.rear) for shot in shots([[10.0, 20.0, 0.0]] * 20)} == {(1, 1)}


def test_in_a_pursuit_cars_that_have_driven_as_far_are_no_fight():
    # The lead goes to and fro between cars that are a third of a lap of 30 m apart.
    director = Director(30.0)
    driven = [[10.0 + k, 10.0 + k + 0.1 * (-1) ** k, 9.5 + k] for k in range(90)]
    seen = [director.add(k * STEP_S, scene(driven[k])) for k in range(90)]
    assert {(shot.front, shot.rear) for shot in seen} == {(1, 1)}
    assert director.sentence(("A", "B", "C"), scene(driven[-1])) == ""
    # The first comes to lead by more than a fight is long.
    seen = [director.add((90 + k) * STEP_S, scene([112.0, 110.0, 109.5])) for k in range(60)]
    assert (seen[-1].front, seen[-1].rear) == (0, 0)


@pytest.mark.parametrize("caught_by", [(0, 2), (1, 0), (2, 1)])
@pytest.mark.parametrize("laps", [0, 1, 7])
def test_in_a_pursuit_who_catches_a_car_on_the_road_fights_with_it(caught_by, laps):
    # The rear one begins a third of a lap of 30 m behind the front one, and so has driven farther.
    rear, front = caught_by
    commentator, director = Commentator(spec(3), "ABC", pursuit_m=30.0), Director(30.0)
    lines, seen, cars = [], [], {}
    for step in range(60):
        driven = 30.0 * laps + 26.0 + 0.1 * step
        distance = np.full(3, driven)
        distance[rear] = driven + 9.0 + 0.02 * step
        distance[3 - rear - front] = driven - 5.0
        cars = scene(distance)
        lines += commentator.add(2 + step * STEP_S, cars)
        seen.append(director.add(2 + step * STEP_S, cars))
    assert (seen[-1].front, seen[-1].rear) == (front, rear)
    one, other = "ABC"[rear], "ABC"[front]
    assert (lines[0].kind, lines[0].car) == ("attack", rear)
    assert lines[0].text.startswith(f"{one} attacks {other}, 0.3")
    assert lines[1].kind == "side_by_side"
    assert len(lines) == 2
    passes = commentator.add(6.0, cars, [Event(time_s=6.0, kind="overtake", car=rear, other=front)])
    assert [line.text for line in passes] == [f"{one} passes {other}"]


def test_a_pass_is_no_cut_and_side_by_side_the_camera_stays():
    gaps = [0.5, 0.2, -0.05, 0.05, -0.05, -0.2, -0.5]
    seen = shots([[10.0, 10.0 - gap] for gap in gaps])
    assert [shot.rear for shot in seen] == [1, 1, 1, 1, 1, 1, 0]
    assert {shot.since_s for shot in seen} == {0.0}


def test_the_camera_cuts_when_a_fight_is_decided_and_no_shot_is_too_short():
    # A and B part after 2 s; C and D fight all the time.
    distances = [[40.0, 39.4 if k < 30 else 35.0, 10.0, 9.2] for k in range(120)]
    seen = shots(distances)
    cut = next(k for k, shot in enumerate(seen) if shot.front != seen[0].front)
    assert (seen[0].front, seen[-1].front, seen[-1].rear) == (0, 2, 3)
    assert cut * STEP_S == pytest.approx(29 * STEP_S + HOLD_S, abs=1.1 * STEP_S)


@pytest.mark.parametrize("second_m", [21.0, 2.0], ids=["alone", "chased"])
def test_the_winner_is_seen_to_cross_the_line(second_m):
    # A leads; C and D fight far behind. A has driven the race of 60 m in step 100.
    director, seen = Director(race_m=60.0), []
    for step in range(300):
        first = 50.0 + 0.1 * step
        home = [0] if step >= 100 else []
        cars = scene([first, first - second_m, first - 30.0, first - 30.3], ghost=home)
        seen.append(director.add(step * STEP_S, cars))
    assert (seen[49].front, seen[49].rear) == (2, 3)
    winner = (0, 1) if second_m < PACK else (0, 0)
    assert {(shot.front, shot.rear) for shot in seen[51 : 100 + int(HOLD_S / STEP_S)]} == {winner}
    assert (seen[-1].front, seen[-1].rear) == (2, 3)


def test_a_race_is_as_long_as_its_laps_where_the_first_at_the_line_wins():
    ring, straight = make_ring(), make_straight()
    assert length_of_race(spec(), ring) == spec().laps * ring.length
    assert length_of_race(spec(), straight) == straight.length
    assert length_of_race(spec(ranking="best"), ring) == np.inf


def test_two_fights_as_close_as_each_other_make_no_flicker():
    draw = np.random.default_rng(4)
    gaps = draw.uniform(0.2, 1.4, (900, 2))
    distances = [[40.0, 40.0 - one, 10.0, 10.0 - other] for one, other in gaps]
    starts = sorted({shot.since_s for shot in shots(distances)})
    assert len(starts) > 1
    assert np.diff(starts).min() >= SHORTEST_S
