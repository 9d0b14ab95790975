"""What is looked at before anything is learnt: that the policy can be written down and computed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import torch
from pydantic import ValidationError

from league.agents.card import Card
from league.errors import ConfigError, brief


def card(make: Callable[[], Card]) -> None:
    """See that a checkpoint's card can be made, and its network be built.

    Raises:
        ConfigError: the card refuses a setting.
    """
    try:
        made = make()
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        raise ConfigError(
            f"the checkpoint's card refuses the {where} {brief(first['input'])}: "
            f"{first['msg'].removeprefix('Value error, ')}"
        ) from None
    made.weight_shapes  # noqa: B018 (a network that cannot be built is refused here)


def device(name: str) -> None:
    """See that a device computes.

    Raises:
        ConfigError: it does not, or there is none of that name.
    """
    try:
        # Reading it back tells: `meta` takes tensors, and has nothing inside them.
        computed = float(torch.ones(1, device=name).sum())
    except (RuntimeError, AssertionError, ImportError):
        computed = None
    if computed != 1.0:
        raise ConfigError(
            f"this machine's torch cannot compute on the device {brief(name)}: give cpu, or cuda "
            f"where there is such a card and a torch that knows it; found here: {_devices()}"
        )


@contextmanager
def memory() -> Iterator[None]:
    """Say in a sentence that a card's memory is full.

    Raises:
        ConfigError: it is.
    """
    try:
        yield
    except torch.OutOfMemoryError as error:
        raise ConfigError(
            f"the device's memory is full ({brief(str(error).partition('. ')[0])}): start a new "
            "run with fewer --num-worlds, a shorter --rollout or more --mini-batches"
        ) from None


def _devices() -> str:
    """Return the names of what computes on this machine, one after the other."""
    names = ["cpu"]
    if (kind := torch.accelerator.current_accelerator(check_available=True)) is not None:
        names += [f"{kind.type}:{number}" for number in range(torch.accelerator.device_count())]
    return ", ".join(names)
