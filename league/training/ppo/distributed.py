"""The processes that torchrun starts for one run: who this one is, and what all of them agree on.

Each rank has worlds of its own, and rsl-rl takes the mean of their gradients, so that all have the
same weights. A process that torchrun has not started is the only rank: nothing is begun here then.
"""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import numpy as np
import torch
from torch import distributed

from league.errors import ConfigError, LeagueError, brief

_Number = TypeVar("_Number", bool, float)


def count() -> int:
    """Return how many ranks learn together.

    Raises:
        ConfigError: the environment holds no number.
    """
    return _from_torchrun("WORLD_SIZE", 1)


def number() -> int:
    """Return which of them this one is, from 0 on."""
    return _from_torchrun("RANK", 0) if count() > 1 else 0


def is_first() -> bool:
    """Return whether this is the rank that writes, judges and speaks."""
    return number() == 0


def device(name: str) -> str:
    """Return this rank's own device: of cards, each rank of a machine takes another.

    Raises:
        ConfigError: more ranks than cards, or one card for all.
    """
    if count() == 1 or name == "cpu":
        return name
    if name != "cuda":
        raise ConfigError(
            f"the device is {brief(name)}, and torchrun has started {count()} processes: give "
            "cuda, of which each takes a card of its own, or cpu"
        )
    here, cards = _from_torchrun("LOCAL_WORLD_SIZE", 1), torch.cuda.device_count()
    if max(here, _local() + 1) > cards:
        raise ConfigError(
            f"torchrun has started {here} processes on this machine, where CUDA finds {cards} "
            "cards: give it a --nproc-per-node of at most as many, or --device cpu"
        )
    return f"cuda:{_local()}"


def seed(of_run: int) -> int:
    """Return a seed that no other rank has; the run's own where there is one rank."""
    if count() == 1:
        return of_run
    # Neighbours have nothing in common, not even in 32 bits, all that torch looks at on the CPU.
    drawn = np.random.SeedSequence((of_run, number())).generate_state(1, np.uint64)[0]
    return int(drawn) >> 2


def for_rsl_rl() -> dict[str, int] | None:
    """Return what rsl-rl's algorithms want to know to learn together."""
    if count() == 1:
        return None
    return {"global_rank": number(), "local_rank": _local(), "world_size": count()}


def join(device: str) -> None:
    """Find the other ranks, if there are any; again is as good as once.

    Args:
        device: this rank's own.

    Raises:
        ConfigError: they cannot be found.
    """
    if count() == 1 or distributed.is_initialized():
        return
    on_card = torch.device(device).type == "cuda"
    if on_card:
        torch.cuda.set_device(_local())
    try:
        # What lies on cards goes by nccl, and the few numbers to agree on by gloo.
        distributed.init_process_group("cpu:gloo,cuda:nccl" if on_card else "gloo")
    except (ValueError, RuntimeError) as error:
        raise ConfigError(
            f"the {count()} processes of WORLD_SIZE cannot find each other ({brief(str(error))}): "
            "start them by torchrun, or take WORLD_SIZE out of the environment"
        ) from None


def close() -> None:
    """Let go of the others; after a failure the end of the process does it, when all is saved."""
    if count() > 1 and distributed.is_initialized():
        distributed.destroy_process_group()


def gathered(*mine: float) -> list[list[float]]:
    """Return some numbers of every rank, in the ranks' order; all wait for the last.

    Raises:
        LeagueError: a rank is gone.
    """
    if count() == 1:
        return [list(mine)]
    told = torch.tensor(mine, dtype=torch.float64)
    found = [torch.empty_like(told) for _ in range(count())]
    with exchange():
        distributed.all_gather(found, told)
    return [one.tolist() for one in found]


def agreed(mine: _Number) -> _Number:
    """Return the first rank's number; all wait for the last."""
    return type(mine)(gathered(mine)[0][0])


def wait() -> None:
    """Wait for the last rank to come here."""
    gathered(0.0)


@contextlib.contextmanager
def exchange() -> Iterator[None]:
    """Say so in a sentence where a rank has gone while others wait for it.

    Raises:
        LeagueError: it has.
    """
    try:
        yield
    except RuntimeError as error:
        # Gloo's errors have no type of their own.
        if isinstance(error, distributed.DistError) or "gloo" in str(error):
            raise _gone() from None
        raise


@contextlib.contextmanager
def together() -> Iterator[None]:
    """What fails in one rank fails in all, with the same sentence: nobody waits for who has gone.

    Raises:
        LeagueError: it failed in another rank.
    """
    failed: LeagueError | None = None
    try:
        yield
    except LeagueError as error:
        if count() == 1:
            raise
        failed = error
    if not _anywhere(failed is not None):
        return
    found: list[LeagueError | None] = [None] * count()
    distributed.all_gather_object(found, failed)
    _let_first_go()
    raise next(error for error in found if error is not None)


@contextlib.contextmanager
def stopping_together() -> Iterator[Callable[[], None]]:
    """Have Ctrl-C and SIGTERM stop all ranks at the same place; one rank hears them as ever.

    Yields:
        The place: a call, which raises KeyboardInterrupt in all ranks if any has been told to stop.
    """
    if count() == 1:
        yield lambda: None
        return
    heard: list[int] = []

    def place() -> None:
        if _anywhere(bool(heard)):
            _let_first_go()
            raise KeyboardInterrupt

    before: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():  # no other hears signals
        for one in (signal.SIGINT, signal.SIGTERM):
            before[one] = signal.signal(one, lambda number, _: heard.append(number))
    try:
        yield place
    finally:
        for one, handler in before.items():
            signal.signal(one, handler)


def _anywhere(mine: bool) -> bool:
    return any(flag for (flag,) in gathered(mine))


def _let_first_go() -> None:
    """Wait until the first rank has closed or ended, if this is another one.

    It has to save what was learnt, and torchrun ends all ranks as soon as one has failed.
    """
    if not is_first():
        with contextlib.suppress(RuntimeError):
            distributed.recv(torch.zeros(1), src=0)


def _gone() -> LeagueError:
    return LeagueError(
        "another process of this run has ended: see what it said, mend that, and go on with "
        "--resume"
    )


def _local() -> int:
    """Return which of its machine's ranks this one is."""
    return _from_torchrun("LOCAL_RANK", 0)


def _from_torchrun(name: str, least: int) -> int:
    """Return a whole number of the environment; the least one where there is none."""
    text = os.environ.get(name, str(least))
    if not text.isdecimal() or int(text) < least:
        raise ConfigError(
            f"{name} is {brief(text)} in the environment: torchrun sets it, so leave it to that, "
            "or take it out"
        )
    return int(text)
