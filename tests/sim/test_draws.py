"""Counter-based random numbers: what they are, how they spread, and on what they depend."""

import pytest
import torch

from league.sim import draws


def test_first_bits_are_those_of_the_published_generator():
    # splitmix64 seeded with 0 and 1 begins so (Steele, Lea and Flood's reference).
    told = draws.bits(torch.tensor([0, 1]))
    assert [word % 2**64 for word in told.tolist()] == [0xE220A8397B1DCDAF, 0x910A2DEC89025CC1]


def test_uniform_numbers_fill_the_unit_interval_evenly():
    told = draws.uniform(torch.arange(100_000), 7)
    assert 0 <= float(told.min()) < 1e-4
    assert 1 - 1e-4 < float(told.max()) < 1
    counts = torch.histc(told, bins=10, min=0, max=1)
    # 10,000 each, standard deviation 95.
    assert float((counts - 10_000).abs().max()) < 500
    assert float(told.double().mean()) == pytest.approx(0.5, abs=0.005)


def test_normal_numbers_have_mean_0_and_variance_1():
    told = draws.normal(torch.arange(100_000), 3).double()
    assert float(told.mean()) == pytest.approx(0, abs=0.02)
    assert float(told.var()) == pytest.approx(1, abs=0.02)
    assert float(told.abs().max()) <= 3.4642


def test_draws_of_neighbouring_seeds_and_counters_are_not_correlated():
    one = draws.normal(torch.arange(50_000), 1, 5).double()
    for other in (
        draws.normal(torch.arange(50_000), 1, 6),
        draws.normal(torch.arange(50_000) + 1, 1, 5),
    ):
        assert abs(float((one * other.double()).mean())) < 0.02


def test_counters_are_told_apart_by_their_order():
    assert int(draws.bits(torch.tensor([4]), 1, 2)) != int(draws.bits(torch.tensor([4]), 2, 1))
    assert int(draws.bits(torch.tensor([4]), 1)) != int(draws.bits(torch.tensor([4]), 1, 0))


def test_no_two_of_a_hundred_thousand_draws_are_equal():
    seed, counter = torch.arange(100).unsqueeze(1), torch.arange(1000)
    assert len(draws.bits(seed, 9, counter).unique()) == 100_000


def test_a_world_draws_the_same_numbers_alone_and_in_a_batch():
    seeds = torch.tensor([11, 22, 33])
    beam = torch.arange(64)
    together = draws.normal(seeds.unsqueeze(1), 5, beam)
    assert torch.equal(together[1], draws.normal(torch.tensor([[22]]), 5, beam)[0])


@pytest.mark.parametrize("seed", [0, 1, -1, 2**63 - 1, -(2**63)])
def test_every_int64_is_a_seed(seed):
    told = draws.uniform(torch.tensor([seed]), 2**62, -5)
    assert 0 <= float(told) < 1
