"""`league drivers`: who can be raced without a checkpoint."""

from __future__ import annotations

from dataclasses import dataclass

from league.cli import tables


@dataclass
class Drivers:
    """List the scripted drivers."""

    def run(self) -> int:
        """Run the command."""
        from league.agents import roster

        table = tables.table("Drivers", "name", "how it drives")
        for name, description in roster.NAMES.items():
            table.add_row(name, description)
        tables.console().print(table)
        return 0


COMMANDS = {"drivers": Drivers}
