"""The tracks of a run: names, files, or generated:N for N random ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from league.errors import ConfigError, brief
from league.track import files
from league.track.generate import generate
from league.track.track import Track, TrackSet

GENERATED = "generated:"
MOST_GENERATED = 2000
MOST_TOGETHER = 4
"""Named tracks to be judged on, at most."""
JUDGED_TOGETHER = 12
"""Random tracks to be judged on."""
FIRST_EXAM_SEED = 1_000_000
"""Random tracks to be judged on count from here, so that none of them is ever trained on."""


def load(names: Sequence[str]) -> list[Track]:
    """Return the courses of some names.

    Raises:
        TrackError: there is no such track.
        ConfigError: no names, or no number of random ones.
    """
    if not names:
        raise ConfigError("no track was named: give --track NAME, `league tracks` lists them")
    found: list[Track] = []
    for name in names:
        if name.startswith(GENERATED):
            found += [drawn(seed) for seed in range(_number(name))]
        else:
            found.append(files.load(name))
    return found


def count(names: Sequence[str]) -> int:
    """Return how many courses these names are, without drawing any.

    Raises:
        ConfigError: no number of random ones.
    """
    return sum(_number(name) if name.startswith(GENERATED) else 1 for name in names)


def drawn(seed: int) -> Track:
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


def to_judge_on(names: Sequence[str]) -> list[Track]:
    """Return where to judge a policy that trains on these: there, or on random ones never seen."""
    named = [name for name in names if not name.startswith(GENERATED)]
    if named:
        return load(named[:MOST_TOGETHER])
    return [drawn(FIRST_EXAM_SEED + number) for number in range(JUDGED_TOGETHER)]


def together(tracks: Sequence[Track], both_directions: bool) -> TrackSet:
    """Return the set of courses, each of them the other way round too if asked."""
    if both_directions:
        tracks = [way for track in tracks for way in (track, track.reversed())]
    return TrackSet(*tracks)


def _number(name: str) -> int:
    text = name.removeprefix(GENERATED)
    if not text.isdecimal() or not 1 <= int(text) <= MOST_GENERATED:
        raise ConfigError(
            f"{brief(name)} is no number of random tracks: give generated:1 to "
            f"generated:{MOST_GENERATED}"
        )
    return int(text)
