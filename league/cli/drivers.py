"""`league drivers`: who can be raced by name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from league.cli import tables

if TYPE_CHECKING:
    from league.agents.card import Card


@dataclass
class Drivers:
    """List the scripted drivers and the policies in the garage."""

    def run(self) -> int:
        """Run the command."""
        from league.agents import checkpoint, garage, roster

        table = tables.table("Drivers", "name", "how it drives")
        for name, description in roster.NAMES.items():
            table.add_row(name, description)
        for name in garage.names():
            card = checkpoint.load(garage.path(name)).card
            table.add_row(name, _told(card))
        tables.console().print(table)
        return 0


def _told(card: Card) -> str:
    where = ", ".join(card.tracks[:3])
    return (
        f"a policy: {card.kind.replace('_', ' ')} on {where}; {card.steps:,} decisions, "
        f"{card.train_s / 60:.1f} min"
    )


COMMANDS = {"drivers": Drivers}
