"""The built-in reward terms, each by hand."""

from dataclasses import replace

import pytest
import torch
from scenes import go_to, put_cars, touch

from league.envs import rewards
from league.envs.config import RewardConfig
from league.sim import referee
from league.sim.config import RaceRules, SimConfig

TWO = SimConfig(kind="head_to_head", num_cars=2, rules=RaceRules(laps=1))
NOTHING = RewardConfig(progress=0.0, off_track=0.0, crash=0.0)


def told(tracks, cfg, start, end, pairs=(), num_worlds=1):
    before = put_cars(tracks, TWO, start, num_worlds=num_worlds)
    after = go_to(tracks, before, end)
    verdict, standing = referee.judge(tracks, TWO, before, after, touch(after, *pairs))
    return rewards.total(tracks, cfg, replace(after, standing=standing), verdict)


@pytest.mark.parametrize("num_worlds", [1, 3])
def test_progress_is_metres_along_the_track_with_sign(ring, num_worlds):
    total, terms = told(
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
    total, _ = told(ring(), replace(NOTHING, centerline=1.0), [(3.0, lateral), (5.0, 0.0)], end)
    assert total[0].tolist() == pytest.approx([reward, 1.0])


@pytest.mark.parametrize(
    ("name", "start", "end", "pairs", "wanted"),
    [
        ("lap", [(11.9, 0.1), (5.0, 0.1)], [(12.1, 0.1), (5.1, 0.1)], (), [1, 0]),
        ("off_track", [(3.0, 0.4), (5.0, 0.1)], [(3.1, 0.5), (5.1, 0.1)], (), [1, 0]),
        ("crash", [(3.0, 0.1), (3.3, 0.1)], [(3.1, 0.1), (3.4, 0.1)], ((0, 1),), [1, 0]),
        ("contact", [(3.0, 0.1), (3.3, 0.1)], [(3.1, 0.1), (3.4, 0.1)], ((0, 1),), [0, 1]),
        ("overtake", [(3.0, 0.2), (3.1, -0.2)], [(3.3, 0.2), (3.1, -0.2)], (), [1, -1]),
        # Nobody is near a car 1.6 m ahead, and across the start line 0.4 m is near.
        ("gain", [(3.0, 0.2), (4.4, -0.2)], [(3.25, 0.2), (4.85, -0.2)], (), [0, 0]),
    ],
)
def test_event_pays_its_weight_to_whom_it_happened(ring, name, start, end, pairs, wanted):
    total, terms = told(ring(), replace(NOTHING, **{name: -3.0}), start, end, pairs)
    assert total[0].tolist() == [-3.0 * one for one in wanted]
    assert list(terms) == [name]


def test_gain_is_what_one_car_drove_more_than_those_near_it(ring):
    lap = float(ring().length[0])
    start, end = [(lap - 0.3, 0.1), (0.1, -0.1)], [(lap - 0.05, 0.1), (0.2, -0.1)]
    total, _ = told(ring(), replace(NOTHING, gain=2.0), start, end, ())
    assert total[0].tolist() == pytest.approx([2.0 * 0.15, -2.0 * 0.15], abs=1e-4)


def test_nobody_gains_on_a_car_that_stands_or_is_home(ring):
    tracks = ring()
    before = put_cars(tracks, TWO, [(3.0, 0.1), (3.5, -0.1)])
    after = go_to(tracks, before, [(3.25, 0.1), (3.5, -0.1)])
    verdict, standing = referee.judge(tracks, TWO, before, after, touch(after))
    second = torch.tensor([[False, True]])
    for changed, told in (
        (replace(standing, penalty_s=torch.where(second, 1.0, 0.0)), verdict),
        (replace(standing, finish_s=torch.where(second, 9.0, torch.inf)), verdict),
        (standing, replace(verdict, released=second)),
    ):
        world = replace(after, standing=changed)
        assert rewards.gain(tracks, world, told).tolist() == [[0.0, 0.0]]
    free = rewards.gain(tracks, replace(after, standing=standing), verdict)
    assert free[0].tolist() == pytest.approx([0.25, -0.25], abs=1e-4)


def test_total_is_the_sum_of_what_is_logged(ring):
    cfg = RewardConfig(1.0, 0.5, 2.0, 3.0, 1.5, -4.0, -5.0, -6.0)
    start, end = [(11.9, 0.1), (12.1, 0.1)], [(12.05, 0.1), (12.3, 0.1)]
    total, terms = told(ring(), cfg, start, end, ((0, 1),))
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
    assert torch.equal(total, sum(terms.values(), torch.zeros_like(total)))


def test_reward_of_nothing_is_zero(ring):
    total, terms = told(ring(), NOTHING, [(1.0, 0.1), (2.0, 0.1)], [(1.1, 0.1), (2.1, 0.1)])
    assert terms == {}
    assert total.tolist() == [[0.0, 0.0]]
