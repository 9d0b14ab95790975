"""A trained driver: what its sensors tell goes through the network of a checkpoint."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import torch
from torch import Tensor

from league.agents.card import Card
from league.agents.checkpoint import Checkpoint
from league.agents.network import Actor
from league.envs.action_space import to_actions
from league.errors import PolicyError
from league.sim.config import CarConfig

EXACT_ROWS = 4
"""Rows of the one batch shape in which an exact policy decides; docs/checkpoint.md says why 4."""
EVEN_WIDTH = 16
"""Layers of widths that are multiples of this give a row the same bits anywhere in that batch."""


class Policy:
    """A Driver with a network; it decides by the mean, or the best score, and remembers nothing.

    Matrix products give a row other bits in a batch of another size, with another number of
    threads, and, in layers of uneven width, at another place of the batch. An exact policy
    therefore decides with one thread, in batches of one size, the last one filled up with zeros; if
    its layers are uneven, each row has a batch of its own. So a car gets the same bits alone and
    among many. An inexact policy takes the whole batch at once, which is faster.
    """

    def __init__(
        self,
        checkpoint: Checkpoint,
        car: CarConfig,
        *,
        name: str | None = None,
        exact: bool = True,
        device: torch.device | str = "cpu",
    ) -> None:
        """Build the network.

        Args:
            checkpoint: card and weights.
            car: the car it will drive.
            name: what to call it; by default what its card says.
            exact: whether a row's bits must not depend on the other rows, nor on threads.
            device: where it decides.
        """
        self.name = name or checkpoint.card.name
        self.sensors = checkpoint.card.sensor_config
        self.card = checkpoint.card
        self.digest = checkpoint.digest
        self._car, self._exact = car, exact
        self._space = checkpoint.card.space
        self._shapes = checkpoint.card.group_shapes
        self._actor = Actor(checkpoint.card.network, self._shapes, self._space.size)
        self._actor.load_state_dict(dict(checkpoint.weights))
        self._actor.requires_grad_(False).eval().to(device)
        self._rows = EXACT_ROWS if _is_even(checkpoint.card) else 1

    def reset(self, rows: Tensor | None) -> None:
        """Do nothing: there is no memory to lose."""

    def act(self, observations: Mapping[str, Tensor]) -> Tensor:
        """Return actions [steering, speed] in [-1, 1], float32 (num_rows, 2).

        Raises:
            PolicyError: a group it needs is missing or has another shape.
        """
        with torch.inference_mode():
            outputs = self.outputs(observations)
            actions = to_actions(self._space, outputs, self._car)
        return actions.clone()  # a plain tensor, which may take part in anything

    def outputs(self, observations: Mapping[str, Tensor]) -> Tensor:
        """Return what the network answers, means or scores, (num_rows, space.size)."""
        told = {name: self._told(observations, name) for name in self._shapes}
        if not self._exact:
            return self._actor(told)
        rows, step = told["motion"].shape[0], self._rows
        with _one_thread():
            answers = [
                self._actor(
                    {name: _filled(group[start : start + step]) for name, group in told.items()}
                )[:step]
                for start in range(0, rows, step)
            ]
            return torch.cat(answers)[:rows]

    def _told(self, observations: Mapping[str, Tensor], name: str) -> Tensor:
        """Return a group as the learner was told it: float32, bytes over 255."""
        group = observations.get(name)
        shape = None if group is None else tuple(group.shape[1:])
        if group is None or shape != self._shapes[name]:
            given = "nothing" if shape is None else f"{name} of shape {shape}"
            raise PolicyError(
                f"{self.name!r} was told {given}, but needs {name} of shape {self._shapes[name]} "
                "in each row: give its car the sensors of its card"
            )
        group = group.to(torch.float32) / 255.0 if group.dtype == torch.uint8 else group
        return group.contiguous()


def _is_even(card: Card) -> bool:
    """Return whether all layers that are used have widths at which a row's place is no matter."""
    channels = () if card.sensors.camera is None else card.network.channels
    return all(size % EVEN_WIDTH == 0 for size in (*channels, *card.network.hidden))


@contextmanager
def _one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _filled(rows: Tensor) -> Tensor:
    """Return EXACT_ROWS rows; those that are missing are zero."""
    if rows.shape[0] == EXACT_ROWS:
        return rows
    full = rows.new_zeros((EXACT_ROWS, *rows.shape[1:]))
    full[: rows.shape[0]] = rows
    return full
