"""What a solver is: one control step of physics for a batch of worlds; there are two."""

from dataclasses import dataclass
from typing import Protocol

from league.sim.world import Contacts, Control, Motion, World


@dataclass(frozen=True)
class Outcome:
    """What one control step of physics brought."""

    motion: Motion
    """The cars' new movement."""
    contacts: Contacts
    """What touched what on the way."""


class Solver(Protocol):
    """Integrates the cars of all worlds over one control step.

    Cars with a penalty (`standing.penalty_s > 0`) are held where they are, at rest; ghosts
    (`standing.ghost`) touch neither cars nor obstacles. Obstacles move at their velocity and cannot
    be pushed. Latency: the previous control (`world.control`) acts for the first
    `cars.latency_s`, rounded to physics steps.
    """

    def step(self, world: World, control: Control) -> Outcome:
        """Return where `control`, held for one control step, leads from `world`."""
        ...

    def reset(self, worlds: list[int] | None = None) -> None:
        """Forget whatever was kept from earlier steps of these worlds (None: of all)."""
        ...

    def close(self) -> None:
        """Give back what the solver holds outside Python."""
        ...
