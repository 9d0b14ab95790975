"""A door's own source of world seeds: given one it repeats itself, given none it never does."""

from __future__ import annotations

import numpy as np

from league.errors import ConfigError

LIMIT = 2**62
"""World seeds lie below, so that they can be written into a race's spec."""


class Seeds:
    """Draws one world seed after the other; a seed given begins the row anew."""

    def __init__(self) -> None:
        """Begin with the system's entropy, as nobody has given a seed yet."""
        self._generator: np.random.Generator | None = None

    def next(self, seed: int | None) -> int:
        """Return the seed of the next world.

        Args:
            seed: begins the row anew; None goes on with it.
        """
        if seed is not None:
            self._generator = np.random.default_rng(checked(seed))
        elif self._generator is None:
            self._generator = np.random.default_rng()
        return drawn(self._generator)


def drawn(generator: np.random.Generator) -> int:
    """Draw a world's seed."""
    return int(generator.integers(LIMIT))


def checked(seed: object) -> int:
    """Return a seed that was given, as an int."""
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise ConfigError(f"seed is {seed!r}: give a whole number, 0 or more, or None")
    return int(seed)
