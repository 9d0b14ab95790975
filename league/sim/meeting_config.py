"""How cars meet in training, as frozen data."""

from dataclasses import dataclass

from league.errors import ConfigError


@dataclass(frozen=True)
class Meeting:
    """How the other cars are placed about car 0, which learns.

    When an episode of car 0 begins, so do those of all others: near it, on the starting grid, or
    out of the world, where no camera sees them. A car that ends its own episode, or that is left
    behind, begins its next one near car 0, which drives on.
    """

    alone: float = 0.2
    """Share of car 0's episodes that it drives alone."""
    standing: float = 0.35
    """Share that begins at rest on the starting grid, in any slot."""
    rolling: float = 0.9
    """Share of the rest that begins at speed; the others at rest."""
    reach: float = 1.5
    """Farthest the others are put ahead of or behind car 0, along the track [m]."""
    room: float = 0.6
    """Nearest a car is put that joins while car 0 is driving [m]."""
    lost: float = 4.0
    """A car farther away than this along the track begins anew near car 0 [m]."""
    top_speed: float = 3.5
    """Fastest rolling start [m/s]; before bends it is what the grip allows."""
    pace: float = 0.15
    """Share by which each car's speed differs at a rolling start."""

    def __post_init__(self) -> None:
        for name in ("alone", "standing", "rolling"):
            if not 0 <= getattr(self, name) <= 1:
                raise ConfigError(f"meeting {name} is {getattr(self, name)}: give 0 to 1")
        if self.alone + self.standing > 1:
            raise ConfigError(
                f"meeting alone and standing are {self.alone} and {self.standing}: "
                "give shares whose sum is at most 1"
            )
        if not 0.5 <= self.room < self.reach < self.lost <= 1000:
            raise ConfigError(
                f"meeting room, reach and lost are {self.room}, {self.reach} and {self.lost}: "
                "give metres that grow, from 0.5 on"
            )
        if not (0 <= self.top_speed <= 12 and 0 <= self.pace <= 0.5):
            raise ConfigError(
                f"meeting top_speed and pace are {self.top_speed} and {self.pace}: "
                "give 0 to 12 m/s and 0 to 0.5"
            )
