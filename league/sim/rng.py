"""Random numbers that depend on a seed and a name, never on their order or their batch.

A counter-based generator (splitmix64, Steele, Lea and Flood, OOPSLA 2014): the same world draws the
same numbers alone, in a batch, on any machine, and whatever else was drawn before. Functions of
arrays are for Python; those that end in `_of` are for compiled code and give the same numbers.
"""

import numpy as np

from league.jit import inner

SEED_MASK = 2**62 - 1  # world seeds lie below 2^62, so that they can be written into a race's spec

_GAMMA = np.uint64(0x9E3779B97F4A7C15)
_MIX_1, _MIX_2 = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_27, _30, _31, _40 = np.uint64(27), np.uint64(30), np.uint64(31), np.uint64(40)
_16, _32, _48, _LOW_16 = np.uint64(16), np.uint64(32), np.uint64(48), np.uint64(0xFFFF)
_SHARE = np.float32(2.0**-24)
_MEAN = np.int64(131070)  # of four 16-bit numbers, each with variance (2**32 - 1) / 12
_DEVIATION = np.float32(3.0**0.5 / 65536.0)


def purposes(first: int, end: int) -> tuple[np.int64, ...]:
    """Return the first counters of several kinds of draws, from `first` to below `end`.

    NumPy's numbers, because Numba compiles a function again for each value of a Python integer.
    """
    return tuple(np.arange(first, end, dtype=np.int64))


def _word(*numbers):
    """Return 64 random bits as uint64; numbers are int64, or arrays of it that broadcast."""
    word = np.uint64(0)
    for number in numbers:
        word = (word ^ np.uint64(number)) + _GAMMA
        word = (word ^ (word >> _30)) * _MIX_1
        word = (word ^ (word >> _27)) * _MIX_2
        word = word ^ (word >> _31)
    return word


def _sum_of_four(word):
    """Return the sum of the four 16-bit numbers in a word."""
    return (word & _LOW_16) + ((word >> _16) & _LOW_16) + ((word >> _32) & _LOW_16) + (word >> _48)


_word_of, _sum_of_four_of = inner(_word), inner(_sum_of_four)


def bits(seed: np.ndarray | int, *counters: np.ndarray | int) -> np.ndarray:
    """Return 64 random bits as int64 for each element of the broadcast of seed and counters.

    Seeds are int64, one for each world, with trailing axes to broadcast against the counters;
    counters distinguish this draw from all others: a purpose, a step, a car, a beam.
    """
    with np.errstate(over="ignore"):
        word = _word(*(np.asarray(number, np.int64) for number in (seed, *counters)))
    return np.atleast_1d(word).astype(np.int64)


def uniform(seed: np.ndarray | int, *counters: np.ndarray | int) -> np.ndarray:
    """Return float32 numbers in [0, 1)."""
    return (bits(seed, *counters).astype(np.uint64) >> _40).astype(np.float32) * _SHARE


def normal(seed: np.ndarray | int, *counters: np.ndarray | int) -> np.ndarray:
    """Return nearly Gaussian float32 numbers (mean 0, variance 1, within 3.47).

    The sum of four 16-bit uniforms: exact in integers, so bit-equal everywhere (a Box-Muller
    transform would not be); kurtosis is 2.7 instead of 3.
    """
    total = _sum_of_four(bits(seed, *counters).astype(np.uint64))
    return (total.astype(np.int64) - _MEAN).astype(np.float32) * _DEVIATION


@inner
def bits_of(*numbers):
    """Return 64 random bits as int64; the seed and the counters are int64."""
    return np.int64(_word_of(*numbers))


@inner
def uniform_of(*numbers):
    """Return a float32 in [0, 1); see `bits_of`."""
    return np.float32(_word_of(*numbers) >> _40) * _SHARE


@inner
def normal_of(*numbers):
    """Return a nearly Gaussian float32; see `bits_of`."""
    return np.float32(np.int64(_sum_of_four_of(_word_of(*numbers))) - _MEAN) * _DEVIATION
