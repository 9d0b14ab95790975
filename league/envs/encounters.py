"""How cars meet in training, as frozen data."""

from dataclasses import dataclass

from league.errors import ConfigError
from league.sim.validation import check, ranged


@dataclass(frozen=True)
class Meeting:
    """How the other cars are placed about car 0, which learns.

    When an episode of car 0 begins, so do those of all others: near it, on the starting grid, or
    out of the world, where no camera sees them. A car that ends its own episode, or that is left
    behind, begins its next one near car 0, which drives on.
    """

    alone: float = ranged(0.2, 0.0, 1.0)
    """Share of car 0's episodes that it drives alone."""
    standing: float = ranged(0.35, 0.0, 1.0)
    """Share that begins at rest on the starting grid, in any slot."""
    rolling: float = ranged(0.9, 0.0, 1.0)
    """Share of the rest that begins at speed; the others at rest."""
    reach: float = ranged(1.5, 0.5, 1000.0)
    """Farthest the others are put ahead of or behind car 0, along the track [m]."""
    ahead: float = ranged(0.8, 0.0, 1.0)
    """Share of those places that lie ahead: there is more to learn from a car in one's way."""
    room: float = ranged(0.6, 0.5, 1000.0)
    """Nearest a car is put that joins while car 0 is driving [m]."""
    lost: float = ranged(2.5, 0.5, 1000.0)
    """A car farther away than this along the track begins anew near car 0 [m]."""
    top_speed: float = ranged(3.5, 0.0, 12.0)
    """Fastest rolling start [m/s]; before bends it is what the grip allows."""
    pace: float = ranged(0.15, 0.0, 0.5)
    """Share by which each car's speed differs at a rolling start."""

    def __post_init__(self) -> None:
        check(self, "meeting")
        if self.alone + self.standing > 1:
            raise ConfigError(
                f"meeting alone and standing are {self.alone} and {self.standing}: "
                "give shares whose sum is at most 1"
            )
        if not self.room < self.reach < self.lost:
            raise ConfigError(
                f"meeting room, reach and lost are {self.room}, {self.reach} and {self.lost}: "
                "give metres that grow"
            )
