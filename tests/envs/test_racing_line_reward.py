"""The reward that knows the racing line, by hand: on a ring the line and its speed are known."""

import math

import numpy as np
import pytest

from league.envs import rewards
from league.envs.rewards import BuiltIn, RacingLineReward, built_in
from league.errors import ConfigError
from league.racing_line.racing_line import optimal_line
from league.racing_line.search import CarLimits
from league.sim.config import CarConfig, RaceRules, SimConfig
from league.track.track import TrackSet
from tests.scenes import Stages, go_to, make_ring, make_square, make_straight, put_cars

CAR = CarConfig()
TWO = SimConfig(kind="head_to_head", num_cars=2, rules=RaceRules(laps=1))
INSIDE = 0.4 + CAR.wheel_track / 2
"""Where the line of a ring 0.8 m wide is: with two wheels outside the road."""


def speed_at(radius):
    return math.sqrt(CarLimits.of(CAR).lateral * radius)


@pytest.fixture(scope="module")
def of_the_ring():
    """Return the ring and its reward; its line takes a while to find."""
    tracks = TrackSet(make_ring())
    return tracks, RacingLineReward(tracks, CAR)


def paid(tracks, reward, aside, speed, track=0):
    """Return what two cars earn for 0.1 m at these distances from the centreline."""
    start, end = ([(3.0 + way, aside), (5.0 + way, -0.3)] for way in (0.0, 0.1))
    before = put_cars(tracks, TWO, start, num_worlds=2)
    before.worlds["track"] = track
    after = go_to(tracks, before, end, speed=speed)
    verdicts, after = Stages(tracks, TWO).judge(before, after)
    inputs = tracks, before, after, np.zeros((2, 2, 2), np.float32), verdicts
    total, terms = reward(*inputs)
    assert list(terms) == list(reward.terms)
    assert np.allclose(total, sum(terms.values()))
    earned, _ = BuiltIn(rewards.preset("progress"))(*inputs)
    assert np.allclose(total - terms["racing_line"], earned, atol=1e-6)
    return terms["racing_line"]


def near(metres, metres_per_second):
    return max(0.0, 1 - (metres / 0.7) ** 2 - (metres_per_second / 1.4) ** 2)


@pytest.mark.parametrize("aside", [INSIDE, 0.3, 0.0, -0.3])
@pytest.mark.parametrize("slower", [0.0, 0.5, -0.5, 1.6])
def test_a_step_pays_for_being_on_the_line_at_its_speed(of_the_ring, aside, slower):
    radius = 0.025 / math.sin(math.pi / 240)
    speed = speed_at(radius - INSIDE)
    found = paid(*of_the_ring, aside, speed - slower)
    assert found.shape == (2, 2)
    wanted = [near(INSIDE - aside, slower), near(INSIDE + 0.3, slower)]
    assert found[1].tolist() == pytest.approx(wanted, abs=0.03)


def test_far_from_the_line_nothing_is_paid_and_nothing_taken(of_the_ring):
    assert paid(*of_the_ring, INSIDE, 0.1)[0, 0] == 0.0


def test_who_drives_the_wrong_way_or_stands_is_not_paid(of_the_ring):
    tracks, reward = of_the_ring
    speed = speed_at(0.025 / math.sin(math.pi / 240) - INSIDE)
    before = put_cars(tracks, TWO, [(3.0, INSIDE), (5.0, INSIDE)])
    after = go_to(tracks, before, [(2.8, INSIDE), (5.0, INSIDE)], speed=speed)
    verdicts, after = Stages(tracks, TWO).judge(before, after)
    _, terms = reward(tracks, before, after, np.zeros((1, 2, 2), np.float32), verdicts)
    assert terms["racing_line"].tolist() == [[0.0, 0.0]]


def test_each_world_has_the_line_of_its_own_track():
    tracks = TrackSet(make_ring(points=400), make_ring(clockwise=True))
    small = 0.025 / math.sin(math.pi / 240)
    reward = RacingLineReward(tracks, CAR)
    found = paid(tracks, reward, -INSIDE, speed_at(small - INSIDE), track=1)
    assert float(found[0, 0]) == pytest.approx(1.0, abs=0.03)


def test_on_a_square_the_line_is_that_of_the_place_where_a_car_is():
    track = make_square()
    tracks, line = TrackSet(track), optimal_line(track, CAR, -CAR.wheel_track / 2)
    reward, alone = RacingLineReward(tracks, CAR), SimConfig()
    for place in (0.2, 1.5, 3.4, 7.0, track.length - 0.05):
        there = [(place, float(np.interp(place, line.s, line.lateral, period=track.length)))]
        speed = float(np.interp(place, line.s, line.speed, period=track.length))
        before = put_cars(tracks, alone, [(place - 0.05, there[0][1])])
        after = go_to(tracks, before, there, speed=speed)
        verdicts, after = Stages(tracks, alone).judge(before, after)
        _, terms = reward(tracks, before, after, np.zeros((1, 1, 2), np.float32), verdicts)
        assert terms["racing_line"].item() == pytest.approx(1.0, abs=2e-3), place


def test_an_open_track_has_a_line_to_its_end():
    track = make_straight()
    reward = RacingLineReward(TrackSet(track), CAR)
    there = np.array([[0.0, 0.5, 1.0]])
    _, speed = reward.line_at(np.zeros(there.shape, np.int64), there)
    assert speed.tolist() == [pytest.approx([CAR.max_speed] * 3, rel=0.02)]


def test_a_lap_ends_where_it_begins():
    # On the square the line comes to the start from the side, and faster from place to place.
    reward = RacingLineReward(TrackSet(make_square()), CAR)
    there = np.array([[0.0, 1.0]])
    lateral, speed = reward.line_at(np.zeros(there.shape, np.int64), there)
    assert lateral[0, 0] == pytest.approx(float(lateral[0, 1]), abs=1e-4)
    assert speed[0, 0] == pytest.approx(float(speed[0, 1]), abs=1e-3)


def test_it_is_found_by_its_name_and_others_are_presets(ring):
    assert isinstance(built_in("racing_line", ring(), CAR), RacingLineReward)
    assert built_in("race", ring(), CAR).terms == rewards.preset("race").terms
    with pytest.raises(ConfigError, match="nearest: racing_line"):
        built_in("racingline", ring(), CAR)


def test_so_many_tracks_that_their_lines_take_minutes_are_refused(ring, monkeypatch):
    monkeypatch.setattr(rewards, "MOST_TRACKS", 2)
    with pytest.raises(ConfigError, match=r"on each of 3 tracks.*give at most 2"):
        RacingLineReward(TrackSet(*[make_ring()] * 3), CAR)
    rewards.check_name("racing_line", 2)
