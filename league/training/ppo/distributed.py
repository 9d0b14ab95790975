"""Ranks that torchrun starts for one run: this one's number, and what all of them agree on.

Each rank has worlds of its own; rsl-rl averages their gradients, so that all have equal weights.
Without torchrun this process is the only rank, and torch.distributed is not initialised.
"""

import contextlib
import os
import signal
from collections.abc import Callable, Generator
from typing import Any, TypeVar

import numpy as np
import torch
from torch import distributed

from league.errors import ConfigError, LeagueError, brief
from league.subprocesses import handling

_Value = TypeVar("_Value")


def count() -> int:
    """Return how many ranks learn together; ConfigError if the environment holds no number."""
    return _environment("WORLD_SIZE", 1)


def number() -> int:
    """Return this rank's number, from 0."""
    return _environment("RANK", 0) if count() > 1 else 0


def is_first() -> bool:
    """Return whether this is the rank that writes, evaluates and prints."""
    return number() == 0


def device(name: str) -> str:
    """Return this rank's own device, each GPU for one rank; ConfigError if there are too few."""
    if count() == 1 or name == "cpu":
        return name
    if name != "cuda":
        raise ConfigError(
            f"the device is {brief(name)}, and torchrun has started {count()} processes: give "
            "cuda, of which each takes a card of its own, or cpu"
        )
    local, here = _environment("LOCAL_RANK", 0), _environment("LOCAL_WORLD_SIZE", 1)
    if max(here, local + 1) > (cards := torch.cuda.device_count()):
        raise ConfigError(
            f"torchrun has started {here} processes on this machine, where CUDA finds {cards} "
            "cards: give it a --nproc-per-node of at most as many, or --device cpu"
        )
    return f"cuda:{local}"


def seed(of_run: int) -> int:
    """Return a seed of this rank alone; the run's own where there is one rank."""
    if count() == 1:
        return of_run
    # Ranks differ in the low 32 bits, too, which are all that torch uses on the CPU.
    drawn = np.random.SeedSequence((of_run, number())).generate_state(1, np.uint64)[0]
    return int(drawn) >> 2


def rsl_rl_settings() -> dict[str, int] | None:
    """Return rsl-rl's multi-process settings; None for a single rank."""
    if count() == 1:
        return None
    local = _environment("LOCAL_RANK", 0)
    return {"global_rank": number(), "local_rank": local, "world_size": count()}


def join(device: str) -> None:
    """Join the other ranks, if torchrun started any, once; ConfigError if they do not answer."""
    if count() == 1 or distributed.is_initialized():
        return
    on_gpu = torch.device(device).type == "cuda"
    if on_gpu:
        torch.cuda.set_device(_environment("LOCAL_RANK", 0))
    try:
        # Gradients on GPUs go by nccl, the few numbers to agree on by gloo.
        distributed.init_process_group("cpu:gloo,cuda:nccl" if on_gpu else "gloo")
    except (ValueError, RuntimeError) as error:
        raise ConfigError(
            f"the {count()} processes of WORLD_SIZE cannot find each other ({brief(str(error))}): "
            "start them by torchrun, or take WORLD_SIZE out of the environment"
        ) from None


def close() -> None:
    """Leave the group; after a failure the end of the process does so, when all is saved."""
    if count() > 1 and distributed.is_initialized():
        distributed.destroy_process_group()


def gather(value: _Value) -> list[_Value]:
    """Return every rank's value, in the ranks' order; LeagueError if a rank has ended."""
    if count() == 1:
        return [value]
    values: list[Any] = [None] * count()
    with exchange():
        distributed.all_gather_object(values, value)
    return values


def agreed(value: _Value) -> _Value:
    """Return the first rank's value."""
    return gather(value)[0]


@contextlib.contextmanager
def exchange() -> Generator[None]:
    """Raise a LeagueError if a rank has ended while this one waits for it."""
    try:
        yield
    except RuntimeError as error:
        # Gloo's errors have no type of their own.
        if isinstance(error, distributed.DistError) or "gloo" in str(error):
            raise LeagueError(
                "another process of this run has ended: see its message, fix that, and go on with "
                "--resume"
            ) from None
        raise


@contextlib.contextmanager
def failing_together() -> Generator[None]:
    """Raise a LeagueError of one rank in all, so that none blocks on one that has ended."""
    failure: LeagueError | None = None
    try:
        yield
    except LeagueError as error:
        if count() == 1:
            raise
        failure = error
    failures = [error for error in gather(failure) if error is not None]
    if failures:
        _wait_for_first()
        raise failures[0]


@contextlib.contextmanager
def interrupted_together() -> Generator[Callable[[], None]]:
    """Let Ctrl-C and SIGTERM stop all ranks at the same place; a single rank stops at once.

    The place is what is yielded: it raises KeyboardInterrupt in all ranks if any was interrupted.
    """
    if count() == 1:
        yield lambda: None
        return
    received: list[int] = []

    def place() -> None:
        if any(gather(bool(received))):
            _wait_for_first()
            raise KeyboardInterrupt

    with handling(lambda number, _: received.append(number), signal.SIGINT, signal.SIGTERM):
        yield place


def _wait_for_first() -> None:
    """Wait until the first rank has ended: torchrun ends all as soon as one fails, and it saves."""
    if not is_first():
        with contextlib.suppress(RuntimeError):
            distributed.recv(torch.zeros(1), src=0)


def _environment(name: str, least: int) -> int:
    """Return a whole number that torchrun has set; the least one where there is none."""
    text = os.environ.get(name, str(least))
    if not text.isdecimal() or int(text) < least:
        raise ConfigError(
            f"{name} is {brief(text)} in the environment: torchrun sets it, so unset it elsewhere"
        )
    return int(text)
