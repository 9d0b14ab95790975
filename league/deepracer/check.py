"""Trying a reward file on recorded drives: what it pays, what it reads, how long it takes."""

from __future__ import annotations

import os
import statistics
import threading
import time
from collections.abc import ItemsView, Iterator, Sequence, ValuesView
from dataclasses import dataclass, field

from league.deepracer.params import KEYS, Params
from league.deepracer.reward_file import Function, Source
from league.deepracer.sample_drives import Drive, drives
from league.deepracer.watchdog import NOT_ITS_OWN, end, stuck
from league.errors import RewardError

TIME_LIMIT_S = 5.0
"""Longest call, as in the original's validator [s]."""


@dataclass(frozen=True)
class Tried:
    """What a reward file did on one drive."""

    title: str
    """What the drive shows."""
    kind: str
    """Kind of race."""
    calls: int
    """Steps rewarded."""
    rewards: tuple[float, ...]
    """Reward of each step, up to the first failure."""
    failure: str | None
    """Where and how it failed, or None."""
    median_us: float
    """Median time of a call [us], the user's own code alone."""

    @property
    def mean(self) -> float:
        """Mean reward of a step; 0 if there was none."""
        return statistics.fmean(self.rewards) if self.rewards else 0.0


@dataclass(frozen=True)
class Report:
    """What became of a trial."""

    source: Source
    """The file."""
    drives: tuple[Tried, ...]
    """Each drive."""
    keys: tuple[str, ...]
    """Keys of `params` it has read, by name."""
    unknown_keys: tuple[str, ...]
    """Keys it has asked for that there are not."""
    warnings: tuple[str, ...]
    """What it might better not do."""

    @property
    def failures(self) -> tuple[Tried, ...]:
        """Drives on which it failed."""
        return tuple(one for one in self.drives if one.failure)


class _Watched(dict):
    """Params that note what is read of them, but for what the user's own code has put there."""

    def __init__(self, params: Params, read: set[str]) -> None:
        super().__init__(params)
        self._read, self._own = read, set()

    def _note(self, *keys: str) -> None:
        self._read.update(key for key in keys if key not in self._own)

    def __getitem__(self, key: str) -> object:
        self._note(key)
        return super().__getitem__(key)

    def __setitem__(self, key: str, value: object) -> None:
        self._own.add(key)
        super().__setitem__(key, value)

    def get(self, key: str, default: object = None) -> object:
        self._note(key)
        return super().get(key, default)

    def pop(self, key: str, *default: object) -> object:
        self._note(key)
        return super().pop(key, *default)

    def __iter__(self) -> Iterator[str]:
        # Not dict's own, or `dict(params)` would copy all without asking for anything.
        return iter(super().keys())

    def items(self) -> ItemsView:
        self._note(*self)
        return super().items()

    def values(self) -> ValuesView:
        self._note(*self)
        return super().values()

    def copy(self) -> dict:
        return dict(self)


@dataclass
class _Progress:
    """What the thread that runs the user's code has done, for the one that waits."""

    call_began: float = field(default_factory=time.monotonic)
    done: bool = False
    result: Report | None = None
    error: BaseException | None = None


def check(path: str | os.PathLike[str], *, time_limit_s: float = TIME_LIMIT_S) -> Report:
    """Try a reward file on recorded drives of every kind of race.

    Args:
        path: the file.
        time_limit_s: longest time of one call [s].

    Raises:
        RewardError: the file cannot be read or loaded, or does not come back from a call.
    """
    source = Source.read(path)
    shown = drives()
    told = _Progress()

    def work() -> None:
        try:
            told.result = _tried(source, shown, told)
        except BaseException as error:
            told.error = error  # raised again by who waits
        told.done = True

    thread = threading.Thread(target=work, daemon=True, name="reward")
    told.call_began = time.monotonic()
    thread.start()
    while not told.done:
        thread.join(0.02)
        if not told.done and time.monotonic() - told.call_began > time_limit_s:
            assert thread.ident is not None
            found = stuck(str(source.path), thread.ident, time_limit_s)
            end(thread.ident)
            raise found
    if told.error is not None:
        raise told.error
    assert told.result is not None
    return told.result


def _tried(source: Source, shown: Sequence[Drive], told: _Progress) -> Report:
    read: set[str] = set()
    function = source.instance()
    tried = tuple(_try(source, function, drive, read, told) for drive in shown)
    known = tuple(sorted(key for key in read if key in KEYS))
    unknown = tuple(sorted(str(key) for key in read if key not in KEYS))
    return Report(
        source=source,
        drives=tried,
        keys=known,
        unknown_keys=unknown,
        warnings=tuple(_warnings(tried, known, unknown)),
    )


def _try(
    source: Source, function: Function, drive: Drive, read: set[str], told: _Progress
) -> Tried:
    rewards, taken, failure = [], [], None
    for params in drive.params:
        watched = _Watched(params, read)
        when = f"{drive.title}, steps {params['steps']}"
        told.call_began = time.monotonic()
        start = time.perf_counter()
        try:
            value = function(watched)
            taken.append(time.perf_counter() - start)
            rewards.append(source.number(function, value, when))
        except RewardError as error:
            failure = str(error)
            break
        except NOT_ITS_OWN:
            raise
        except BaseException as error:
            failure = str(source.failed(error, when, params))
            break
    return Tried(
        title=drive.title,
        kind=drive.kind,
        calls=len(drive.params),
        rewards=tuple(rewards),
        failure=failure,
        median_us=1e6 * statistics.median(taken) if taken else 0.0,
    )


def _warnings(tried: Sequence[Tried], keys: Sequence[str], unknown: Sequence[str]) -> list[str]:
    said = [f"it reads params[{key!r}], which there is not" for key in unknown]
    paid = {reward for one in tried for reward in one.rewards}
    if len(paid) == 1 and not any(one.failure for one in tried):
        said.append(f"it pays {paid.pop():g} for every step, whatever the car does")
    if not keys:
        said.append("it reads nothing of params")
    if paid and max(abs(reward) for reward in paid) > 1000:
        said.append("it pays more than 1000 for a step: learning is steadier with about 1")
    if "objects_heading" in keys:
        said.append(
            "it reads objects_heading, which is in degrees here as documented; the original told "
            "radians"
        )
    slow = max((one.median_us for one in tried), default=0.0)
    if slow > 1000:
        said.append(f"it takes {slow / 1000:.1f} ms a call: training will wait for it")
    return said
