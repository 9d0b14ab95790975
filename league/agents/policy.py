"""A trained driver: its sensors' readings go through the network of a checkpoint."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from league.agents.inference import Network
from league.envs.actions import to_actions
from league.errors import PolicyError
from league.sim.config import CarConfig

if TYPE_CHECKING:
    from league.agents.checkpoint import Checkpoint


class Policy:
    """A Driver with a network; it decides by the mean, or the best score, and remembers nothing.

    A row's decision has the same bits alone and in a batch, on every machine (inference.py).
    """

    def __init__(self, checkpoint: Checkpoint, car: CarConfig, *, name: str | None = None) -> None:
        """Build the network.

        Args:
            checkpoint: card and weights.
            car: the car it will drive.
            name: what to call it; by default what its card says.
        """
        self.name = name or checkpoint.card.name
        self.sensors = checkpoint.card.sensors
        self.card = checkpoint.card
        self.digest = checkpoint.digest
        self._car, self._space = car, checkpoint.card.action_space
        self._shapes = checkpoint.card.group_shapes
        self._network = Network.of(checkpoint.card.network, self._shapes, checkpoint.weights)

    def reset(self, rows: np.ndarray | None) -> None:
        """Do nothing: there is no memory to lose."""

    def act(self, observations: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return actions [steering, speed] in [-1, 1], float32 (num_rows, 2).

        Raises:
            PolicyError: a group it needs is missing or has another shape.
        """
        return to_actions(self._space, self.outputs(observations), self._car)

    def outputs(self, observations: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return what the network answers, means or scores, float32 (num_rows, space.size)."""
        groups = {name: self._group(observations, name) for name in self._shapes}
        pictures = groups.pop("stereo", np.empty((0, 0, 0, 0), np.uint8))
        flat = np.concatenate(list(groups.values()), axis=1, dtype=np.float32)
        return self._network.outputs(flat, pictures)

    def _group(self, observations: Mapping[str, np.ndarray], name: str) -> np.ndarray:
        group = observations.get(name)
        array = None if group is None else np.ascontiguousarray(group)
        picture, expected = name == "stereo", self._shapes[name]
        if array is None or array.shape[1:] != expected or (picture != (array.dtype == np.uint8)):
            given = (
                "nothing" if array is None else f"{array.dtype} {name} of shape {array.shape[1:]}"
            )
            raise PolicyError(
                f"{self.name!r} was given {given}, but needs {'uint8 ' * picture}{name} of shape "
                f"{expected} in each row: give its car the sensors of its card"
            )
        return array
