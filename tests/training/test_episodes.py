from __future__ import annotations

import pytest
import torch

from league.training.ppo.statistics import WINDOW, Episode, EpisodeStatistics, mean_completion


def step(
    episodes: EpisodeStatistics,
    driven: list[float],
    *,
    rewards: list[float] | None = None,
    over: list[int] | None = None,
) -> None:
    rows = len(driven)
    episodes.add(
        torch.tensor(rewards or [1.0] * rows),
        torch.tensor(over or [0] * rows),
        torch.tensor(driven),
    )


def test_nothing_is_reported_before_an_episode_has_ended():
    episodes = EpisodeStatistics(2)
    step(episodes, [0.1, 0.2])
    assert episodes.completion is None
    assert episodes.earned is None
    assert episodes.count == 0


def test_an_episode_ends_with_a_mistake():
    episodes = EpisodeStatistics(2)
    step(episodes, [0.1, 0.2], rewards=[1.0, 2.0])
    step(episodes, [0.25, 0.4], rewards=[3.0, 2.0], over=[1, 0])
    assert episodes.completion == pytest.approx(0.25)
    assert episodes.earned == pytest.approx(4.0)  # 1 + 3
    step(episodes, [0.1, 0.75], rewards=[7.0, 2.0], over=[0, 1])
    assert episodes.completion == pytest.approx(0.5)  # of 0.25 and 0.75
    assert episodes.earned == pytest.approx(5.0)  # of 4 and 6
    assert episodes.count == 2


def test_an_episode_ends_with_a_lap_and_the_next_one_begins_there():
    episodes = EpisodeStatistics(1)
    step(episodes, [0.9], rewards=[4.0])
    step(episodes, [1.25], rewards=[6.0])
    assert (episodes.count, episodes.completion) == (1, 1.0)
    assert episodes.earned == pytest.approx(10.0)
    # The second lap ends at 2: half of it is driven when the car leaves the road at 1.5.
    step(episodes, [1.5], rewards=[2.0], over=[1])
    assert episodes.count == 2
    assert episodes.completion == pytest.approx(0.75)  # of 1 and 0.5
    step(episodes, [0.25], rewards=[2.0], over=[1])
    assert episodes.completion == pytest.approx((1 + 0.5 + 0.25) / 3)


def test_a_car_that_went_backwards_came_nowhere():
    episodes = EpisodeStatistics(1)
    step(episodes, [-0.3], rewards=[-2.0], over=[1])
    assert episodes.completion == 0.0
    assert episodes.earned == -2.0


def test_without_cuts_the_mean_is_the_plain_one():
    found = [Episode(share, 0.0, 1) for share in (0.2, 0.9, 0.4, 1.0, 0.4)]
    assert mean_completion(found) == pytest.approx(2.9 / 5)


def test_an_episode_that_was_cut_off_would_have_come_at_least_so_far():
    # One ends at 0.5, one was cut at 0.6, one comes round: the share that comes so far is 1 up to
    # 0.5 and 2/3 beyond, where none fails any more: 0.5 + 2/3 x 0.5 = 5/6.
    found = [Episode(0.5, 0.0, 1), Episode(0.6, 0.0, 1, cut=True), Episode(1.0, 0.0, 1)]
    assert mean_completion(found) == pytest.approx(5 / 6)
    # Cut before anyone fails, it says nothing: 0.5 and 1 alone, 0.75.
    found = [Episode(0.5, 0.0, 1), Episode(0.1, 0.0, 1, cut=True), Episode(1.0, 0.0, 1)]
    assert mean_completion(found) == pytest.approx(0.75)


def test_cars_that_are_cut_off_in_good_driving_are_not_forgotten():
    """Of four rows one fails at once, and three are cut off at half a lap, again and again."""
    episodes = EpisodeStatistics(4)
    for _ in range(6):
        step(episodes, [0.1] * 4, over=[1, 0, 0, 0])
        step(episodes, [0.1, 0.5, 0.5, 0.5])
        episodes.restart()
    # Half of what is known ends at 0.1 of a lap ... but three of four come further.
    assert episodes.completion is not None
    assert episodes.completion > 0.7
    plain = [one for one in episodes._last if not one.cut]
    assert mean_completion(plain) == pytest.approx(0.1)


def test_rewards_of_cut_off_episodes_count_as_of_so_much_of_a_lap():
    episodes = EpisodeStatistics(2)
    # Ten a lap, whoever drives: one fails at half a lap, the other is cut off at 0.8.
    step(episodes, [0.5, 0.5], rewards=[5.0, 5.0], over=[1, 0])
    step(episodes, [0.0, 0.8], rewards=[0.0, 3.0])
    episodes.restart()
    # Up to 0.5 all come, beyond it two of three: the first row's next episode stood at 0.
    assert episodes.completion == pytest.approx(0.5 + 0.5 * 0.5)
    assert episodes.earned == pytest.approx(7.5)


def test_steps_of_an_episode_are_those_of_a_car_that_ends():
    episodes = EpisodeStatistics(2)
    assert episodes.steps is None
    step(episodes, [0.1, 0.1])
    step(episodes, [0.2, 0.2], over=[1, 0])
    step(episodes, [0.1, 0.3])
    step(episodes, [0.2, 0.4], over=[0, 1])
    assert episodes.steps == 3.0  # of 2 and 4


def test_steps_before_a_cut_count_for_the_next_end():
    episodes = EpisodeStatistics(1)
    step(episodes, [0.1])
    step(episodes, [0.2])
    episodes.restart()
    assert episodes.steps is None
    step(episodes, [0.1], over=[1])
    assert episodes.steps == 3.0  # two that were cut off, and one


def test_only_the_last_episodes_count():
    episodes = EpisodeStatistics(1)
    for _ in range(WINDOW):
        step(episodes, [0.0], over=[1])
    assert episodes.completion == 0.0
    for _ in range(WINDOW):
        step(episodes, [0.5], over=[1])
    assert episodes.completion == pytest.approx(0.5)
    assert episodes.count == 2 * WINDOW
