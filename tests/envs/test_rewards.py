"""The built-in reward terms, each by hand."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from league.envs import rewards
from league.envs.config import RewardConfig
from league.sim.config import RaceRules, SimConfig
from league.sim.records import World
from tests.scenes import Stages, go_to, put_cars, touch

TWO = SimConfig(kind="head_to_head", num_cars=2, rules=RaceRules(laps=1, light_contact=0.0))
NOTHING = RewardConfig(progress=0.0, off_track=0.0, crash=0.0)


def pay(tracks, cfg, world, verdicts) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    actions = np.zeros((*world.cars.shape, 2), np.float32)
    return rewards.BuiltIn(cfg)(tracks, world, world, actions, verdicts)


def paid(tracks, cfg, start, end, pairs=(), num_worlds=1):
    before = put_cars(tracks, TWO, start, num_worlds=num_worlds)
    after = go_to(tracks, before, end)
    verdicts, after = Stages(tracks, TWO).judge(before, after, touch(after, *pairs))
    return pay(tracks, cfg, after, verdicts)


def test_the_page_gives_the_weights_of_the_ready_rewards():
    page = (Path(__file__).parents[2] / "docs" / "rewards.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| `(\w+)` \| (.*) \|$", page, re.MULTILINE)[:4])
    for name, weights in rewards.PRESETS.items():
        written = {float(number) for number in re.findall(r"-?[0-9.]*[0-9]", rows[name])}
        assert {getattr(weights, term) for term in weights.terms} <= written, name


@pytest.mark.parametrize("num_worlds", [1, 3])
def test_progress_is_metres_along_the_track_with_sign(ring, num_worlds):
    total, terms = paid(
        ring(),
        replace(NOTHING, progress=2.0),
        [(11.9, 0.1), (5.0, 0.1)],
        [(12.1, 0.1), (4.9, 0.1)],
        num_worlds=num_worlds,
    )
    assert total.shape == (num_worlds, 2)
    assert total[-1].tolist() == pytest.approx([0.4, -0.2], abs=1e-3)
    assert terms.keys() == {"progress"}


@pytest.mark.parametrize(
    ("lateral", "reward"),
    [(0.07, 1.0), (-0.07, 1.0), (0.09, 0.5), (0.19, 0.5), (0.21, 0.1), (0.41, 0.001)],
)
def test_centerline_pays_by_the_three_bands(ring, lateral, reward):
    # Bands end at 10, 25 and 50 % of the 0.8 m.
    end = [(3.1, lateral), (5.1, 0.0)]
    total, _ = paid(ring(), replace(NOTHING, centerline=1.0), [(3.0, lateral), (5.0, 0.0)], end)
    assert total[0].tolist() == pytest.approx([reward, 1.0])


@pytest.mark.parametrize(("lateral", "reward"), [(0.1, 1.0), (0.25, 0.5), (0.5, 0.1)])
def test_a_band_of_the_centerline_includes_its_end(ring, lateral, reward):
    # As in DeepRacer's example; of a road 1 m wide the bands end at these places.
    tracks = ring(width=1.0)
    world = put_cars(tracks, TWO, [(3.0, lateral), (5.0, -lateral)])
    verdicts, _ = Stages(tracks, TWO).judge(world, world)
    total, _ = pay(tracks, replace(NOTHING, centerline=1.0), world, verdicts)
    assert total[0].tolist() == pytest.approx([reward, reward])


@pytest.mark.parametrize(
    ("name", "start", "end", "pairs", "wanted"),
    [
        ("lap", [(11.9, 0.1), (5.0, 0.1)], [(12.1, 0.1), (5.1, 0.1)], (), [1, 0]),
        ("off_track", [(3.0, 0.4), (5.0, 0.1)], [(3.1, 0.5), (5.1, 0.1)], (), [1, 0]),
        ("crash", [(3.0, 0.1), (3.3, 0.1)], [(3.1, 0.1), (3.4, 0.1)], ((0, 1),), [1, 0]),
        ("contact", [(3.0, 0.1), (3.3, 0.1)], [(3.1, 0.1), (3.4, 0.1)], ((0, 1),), [0, 1]),
        ("touch", [(3.0, 0.1), (3.3, 0.1)], [(3.1, 0.1), (3.4, 0.1)], ((0, 1),), [1, 0]),
        ("overtake", [(3.0, 0.2), (3.1, -0.2)], [(3.3, 0.2), (3.1, -0.2)], (), [1, -1]),
        # No car is near a car 1.6 m ahead, and across the start line 0.4 m is near.
        ("gain", [(3.0, 0.2), (4.4, -0.2)], [(3.25, 0.2), (4.85, -0.2)], (), [0, 0]),
    ],
)
def test_event_pays_its_weight_to_whom_it_happened(ring, name, start, end, pairs, wanted):
    total, terms = paid(ring(), replace(NOTHING, **{name: -3.0}), start, end, pairs)
    assert total[0].tolist() == [-3.0 * one for one in wanted]
    assert list(terms) == [name]


def test_gain_is_what_one_car_drove_more_than_those_near_it(ring):
    lap = float(ring().length[0])
    start, end = [(lap - 0.3, 0.1), (0.1, -0.1)], [(lap - 0.05, 0.1), (0.2, -0.1)]
    total, _ = paid(ring(), replace(NOTHING, gain=2.0), start, end, ())
    assert total[0].tolist() == pytest.approx([2.0 * 0.15, -2.0 * 0.15], abs=1e-4)


def test_closing_pays_the_square_of_the_speed_to_who_is_to_blame(straight):
    # The rear car comes 0.1 m nearer within a step of 1/15 s, at 1.5 m/s.
    start, end = [(3.0, 0.1), (3.3, 0.1)], [(3.2, 0.1), (3.4, 0.1)]
    total, _ = paid(straight(), replace(NOTHING, closing=-2.0), start, end, ((0, 1),))
    assert total[0].tolist() == pytest.approx([-2.0 * 1.5**2, 0.0], abs=1e-3)


def test_pushing_a_car_off_the_road_is_a_crash(ring):
    tracks, world = ring(), put_cars(ring(), TWO, [(3.0, 0.1), (3.5, -0.1)])
    verdicts, world = Stages(tracks, TWO).judge(world, world)
    verdicts["pushed_off"] = [[False, True]]
    total, _ = pay(tracks, replace(NOTHING, crash=-2.0), world, verdicts)
    assert total.tolist() == [[0.0, -2.0]]


@pytest.mark.parametrize(("top_speed", "counts"), [(3.9, True), (4.0, True), (4.1, False)])
def test_what_a_faster_rival_does_costs_nothing(ring, top_speed, counts):
    tracks = ring()
    before = put_cars(tracks, TWO, [(3.0, 0.2), (3.1, -0.2)])
    after = go_to(tracks, before, [(3.3, 0.2), (3.1, -0.2)])
    verdicts, after = Stages(tracks, TWO).judge(before, after)
    after.cars["top_speed"] = [[top_speed, 4.0]]
    passed = pay(tracks, replace(NOTHING, overtake=1.0), after, verdicts)[0][0]
    gained = pay(tracks, replace(NOTHING, gain=1.0), after, verdicts)[0][0]
    assert passed[1] == (-1.0 if counts else 0.0)
    assert gained[1] == (pytest.approx(-0.3, abs=1e-4) if counts else 0.0)


def test_nobody_gains_on_a_car_that_stands_or_is_home(ring):
    tracks = ring()
    before = put_cars(tracks, TWO, [(3.0, 0.1), (3.5, -0.1)])
    after = go_to(tracks, before, [(3.25, 0.1), (3.5, -0.1)])
    verdicts, after = Stages(tracks, TWO).judge(before, after)
    cfg = replace(NOTHING, gain=1.0)

    def gain(world: World, seen: np.ndarray) -> list[float]:
        return pay(tracks, cfg, world, seen)[0][0].tolist()

    frozen, home, released = after.copy(), after.copy(), verdicts.copy()
    frozen.cars["penalty_s"][:, 1] = 1.0
    home.cars["finish_s"][:, 1] = 9.0
    released["released"][:, 1] = True
    assert gain(frozen, verdicts) == gain(home, verdicts) == gain(after, released) == [0.0, 0.0]
    assert gain(after, verdicts) == pytest.approx([0.25, -0.25], abs=1e-4)


def test_total_is_the_sum_of_what_is_logged(ring):
    cfg = RewardConfig(1.0, 0.5, 2.0, 3.0, 1.5, -4.0, -5.0, -6.0)
    start, end = [(11.9, 0.1), (12.1, 0.1)], [(12.05, 0.1), (12.3, 0.1)]
    total, terms = paid(ring(), cfg, start, end, ((0, 1),))
    assert terms.keys() == {
        "progress",
        "centerline",
        "lap",
        "overtake",
        "gain",
        "off_track",
        "crash",
        "contact",
    }
    assert np.array_equal(total, sum(terms.values(), np.zeros_like(total)))


def test_reward_of_nothing_is_zero(ring):
    total, terms = paid(ring(), NOTHING, [(1.0, 0.1), (2.0, 0.1)], [(1.1, 0.1), (2.1, 0.1)])
    assert terms == {}
    assert total.tolist() == [[0.0, 0.0]]
