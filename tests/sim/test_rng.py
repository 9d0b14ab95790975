"""Counter-based random numbers: what they are, how they spread, and on what they depend."""

import numba
import numpy as np
import pytest

from league.sim import rng


def test_first_bits_are_those_of_the_published_generator():
    # splitmix64 seeded with 0 and 1 begins so (Steele, Lea and Flood's reference).
    drawn = rng.bits(np.array([0, 1]))
    assert [word % 2**64 for word in drawn.tolist()] == [0xE220A8397B1DCDAF, 0x910A2DEC89025CC1]


def test_uniform_numbers_fill_the_unit_interval_evenly():
    drawn = rng.uniform(np.arange(100_000), 7)
    assert drawn.dtype == np.float32
    assert 0 <= drawn.min() < 1e-4
    assert 1 - 1e-4 < drawn.max() < 1
    counts, _ = np.histogram(drawn, bins=10, range=(0, 1))
    # 10,000 each, standard deviation 95.
    assert abs(counts - 10_000).max() < 500
    assert drawn.astype(float).mean() == pytest.approx(0.5, abs=0.005)


def test_normal_numbers_have_mean_0_and_variance_1():
    drawn = rng.normal(np.arange(100_000), 3)
    assert drawn.dtype == np.float32
    assert drawn.astype(float).mean() == pytest.approx(0, abs=0.02)
    assert drawn.astype(float).var() == pytest.approx(1, abs=0.02)
    assert abs(drawn).max() <= 3.4642


def test_draws_of_neighbouring_seeds_and_counters_are_not_correlated():
    one = rng.normal(np.arange(50_000), 1, 5).astype(float)
    for other in (
        rng.normal(np.arange(50_000), 1, 6),
        rng.normal(np.arange(50_000) + 1, 1, 5),
    ):
        assert abs((one * other).mean()) < 0.02


def test_order_and_number_of_the_counters_matter():
    assert rng.bits(4, 1, 2) != rng.bits(4, 2, 1)
    assert rng.bits(4, 1) != rng.bits(4, 1, 0)


def test_no_two_of_a_hundred_thousand_draws_are_equal():
    seed, counter = np.arange(100)[:, None], np.arange(1000)
    assert len(np.unique(rng.bits(seed, 9, counter))) == 100_000


def test_a_world_draws_the_same_numbers_alone_and_in_a_batch():
    seeds, beam = np.array([11, 22, 33]), np.arange(64)
    together = rng.normal(seeds[:, None], 5, beam)
    assert np.array_equal(together[1], rng.normal(np.array([[22]]), 5, beam)[0])


@pytest.mark.parametrize("seed", [0, 1, -1, 2**63 - 1, -(2**63)])
def test_every_int64_is_a_seed(seed):
    drawn = rng.uniform(np.array([seed]), 2**62, -5)
    assert 0 <= drawn.item() < 1


@numba.njit
def drawn_one_by_one(seeds, counter, words, shares, normals):
    for k in range(len(seeds)):
        words[k] = rng.bits_of(seeds[k], 5, counter)
        shares[k] = rng.uniform_of(seeds[k], 5, counter)
        normals[k] = rng.normal_of(seeds[k], 5, counter)


@pytest.mark.parametrize("counter", [0, 7, -3, 2**40])
def test_compiled_code_draws_the_same_numbers_as_python(counter):
    seeds = np.array([0, 1, -1, 2**63 - 1, -(2**63), *range(10**6, 10**6 + 500)])
    words = np.zeros(len(seeds), np.int64)
    shares, normals = np.zeros((2, len(seeds)), np.float32)
    drawn_one_by_one(seeds, counter, words, shares, normals)
    assert np.array_equal(words, rng.bits(seeds, 5, counter))
    assert np.array_equal(shares, rng.uniform(seeds, 5, counter))
    assert np.array_equal(normals, rng.normal(seeds, 5, counter))
