"""Random numbers that depend on a seed and a name, never on their order or their batch.

A counter-based generator (splitmix64, Steele, Lea and Flood, OOPSLA 2014): the same world draws the
same numbers alone, in a batch, on any device, and whatever else was drawn before.
"""

import torch
from torch import Tensor

_GAMMA = -7046029254386353131  # 0x9E3779B97F4A7C15 as int64
_MIX_1 = -4658895280553007687  # 0xBF58476D1CE4E5B9
_MIX_2 = -7723592293110705685  # 0x94D049BB133111EB


def bits(seed: Tensor, *counters: Tensor | int) -> Tensor:
    """Return 64 random bits as int64 for each element of the broadcast of seed and counters.

    Args:
        seed: int64, one for each world, with trailing axes to broadcast against the counters.
        counters: what tells this draw from all others: a purpose, a step, a car, a beam.
    """
    state = _mix(seed.to(torch.int64) + _GAMMA)
    for counter in counters:
        state = _mix((state ^ counter) + _GAMMA)
    return state


def uniform(seed: Tensor, *counters: Tensor | int) -> Tensor:
    """Return float32 numbers in [0, 1)."""
    return _logical_shift(bits(seed, *counters), 40).to(torch.float32) * 2.0**-24


def normal(seed: Tensor, *counters: Tensor | int) -> Tensor:
    """Return nearly Gaussian float32 numbers (mean 0, variance 1, within 3.47).

    The sum of four 16-bit uniforms: exact in integers, so bit-equal everywhere (a Box-Muller
    transform would not be); kurtosis is 2.7 instead of 3.
    """
    word = bits(seed, *counters)
    total = (
        (word & 0xFFFF)
        + (_logical_shift(word, 16) & 0xFFFF)
        + (_logical_shift(word, 32) & 0xFFFF)
        + _logical_shift(word, 48)
    )
    # Each part has variance (2**32 - 1) / 12; four of them, mean 2 * 65535.
    return (total - 131070).to(torch.float32) * (3.0**0.5 / 65536.0)


def _logical_shift(word: Tensor, places: int) -> Tensor:
    return (word >> places) & ((1 << (64 - places)) - 1)


def _mix(word: Tensor) -> Tensor:
    word = (word ^ _logical_shift(word, 30)) * _MIX_1
    word = (word ^ _logical_shift(word, 27)) * _MIX_2
    return word ^ _logical_shift(word, 31)
