"""A trained driver: what its sensors tell goes through the network of a checkpoint."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from league.agents.checkpoint import Checkpoint
from league.agents.network import Actor
from league.envs.action_space import to_actions
from league.errors import PolicyError
from league.sim.config import CarConfig

EXACT_ROWS = 4
"""Rows of the one batch shape in which an exact policy decides; docs/checkpoint.md says why 4."""


class Policy:
    """A Driver with a network; it decides by the mean, or the best score, and remembers nothing.

    Matrix products give a row other bits in a batch of another size. An exact policy therefore
    always decides in batches of one size, the last one filled up with zeros, so that a car gets the
    same bits alone and among many; an inexact one takes the whole batch at once, which is faster.
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
            exact: whether a row's bits must not depend on the other rows.
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
        rows = told["motion"].shape[0]
        answers = [
            self._actor({name: _filled(group, start) for name, group in told.items()})
            for start in range(0, rows, EXACT_ROWS)
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


def _filled(group: Tensor, start: int) -> Tensor:
    """Return EXACT_ROWS rows from this one on; those that are missing are zero."""
    rows = group[start : start + EXACT_ROWS]
    if rows.shape[0] == EXACT_ROWS:
        return rows
    full = group.new_zeros((EXACT_ROWS, *group.shape[1:]))
    full[: rows.shape[0]] = rows
    return full
