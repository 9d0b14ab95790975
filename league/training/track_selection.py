"""The tracks of a run: names, files, or generated:N for N random ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from league.errors import ConfigError, brief
from league.track import files
from league.track.generate import generate
from league.track.track import Track, TrackSet

GENERATED = "generated:"
MAX_GENERATED = 2000
MAX_EVALUATED = 4
"""Largest number of named tracks to evaluate on."""
RANDOM_EVALUATED = 12
"""Random tracks to evaluate on."""
FIRST_EVALUATED = 1_000_000
"""Seed of the first random track to evaluate on, beyond all that are trained on."""


def load(names: Sequence[str]) -> list[Track]:
    """Return the tracks of some names.

    Raises:
        TrackError: there is no such track.
        ConfigError: no names, or no number of random ones.
    """
    if not names:
        raise ConfigError("no track was named: give --track NAME, `league tracks` lists them")
    tracks: list[Track] = []
    for name in names:
        if name.startswith(GENERATED):
            tracks += [random_track(seed) for seed in range(_number(name))]
        else:
            tracks.append(files.load(name))
    return tracks


def count(names: Sequence[str]) -> int:
    """Return the number of tracks of some names, without generating any.

    Raises:
        ConfigError: no number of random ones.
    """
    return sum(_number(name) if name.startswith(GENERATED) else 1 for name in names)


def random_track(seed: int) -> Track:
    """Return a random track to train on.

    Every third one has bends near the smallest turn a car can make; every third one is narrow with
    its white lines outside the road, as the older half of the community's tracks are.
    """
    length = (15.0, 45.0)
    if seed % 3 == 0:
        return generate(seed, min_radius=0.34, length=length)
    if seed % 3 == 1:
        narrow = generate(seed, width=(0.58, 0.95), length=length)
        return replace(narrow, line_inside=False)
    return generate(seed, length=length)


def for_evaluation(names: Sequence[str]) -> list[Track]:
    """Return the tracks to evaluate on, by those of training: some of them, or random others."""
    named = [name for name in names if not name.startswith(GENERATED)]
    if named:
        return load(named[:MAX_EVALUATED])
    return [random_track(FIRST_EVALUATED + number) for number in range(RANDOM_EVALUATED)]


def together(tracks: Sequence[Track], both_directions: bool) -> TrackSet:
    """Return the set of tracks, with each one reversed too if asked."""
    if both_directions:
        tracks = [either for track in tracks for either in (track, track.reversed())]
    return TrackSet(*tracks)


def _number(name: str) -> int:
    text = name.removeprefix(GENERATED)
    if not text.isdecimal() or not 1 <= int(text) <= MAX_GENERATED:
        raise ConfigError(
            f"{brief(name)} is no number of random tracks: give generated:1 to "
            f"generated:{MAX_GENERATED}"
        )
    return int(text)
