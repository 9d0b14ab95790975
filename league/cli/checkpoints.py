"""`league card` and `league export`: what a checkpoint says of itself, and how it leaves us."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from league.cli import tables
from league.cli.season.base import OnLeague
from league.errors import ConfigError

if TYPE_CHECKING:
    from league.agents.checkpoint import Checkpoint


@dataclass
class ShowCard:
    """Show a checkpoint's card: sensors, network, where it was trained and how well it drove."""

    checkpoint: tyro.conf.Positional[Path]
    """The checkpoint (FILE.pt)."""
    json: bool = False
    """Print JSON."""

    def run(self) -> int:
        """Run the command."""
        from league.agents import checkpoint

        loaded = checkpoint.load(self.checkpoint)
        if self.json:
            card = loaded.card.model_dump(mode="json")
            print(json.dumps({"digest": checkpoint.digest(loaded), "card": card}, indent=2))
            return 0
        table = tables.table(str(self.checkpoint), "", "card")
        table.columns[1].no_wrap = False
        for name, value in _lines(loaded, checkpoint.digest(loaded)):
            table.add_row(name, value)
        tables.console().print(table)
        return 0


@dataclass
class Export(OnLeague):
    """Write a checkpoint's network as ONNX, or a league's results as CSV or JSON."""

    checkpoint: tyro.conf.Positional[Path | None] = None
    """The checkpoint (FILE.pt), for a physical car or any other runtime; none for a league."""
    onnx: Annotated[tuple[Path, ...] | None, tyro.conf.arg(metavar="[FILE]")] = None
    """Write ONNX, which is what it does by itself; without FILE beside the checkpoint, with the
    ending .onnx."""
    csv: Path | None = None
    """Write the league's results, a line for each car of each race; - is the standard output."""
    json: Path | None = None
    """Write the league's rules, entries, standings and results; - is the standard output."""

    def run(self) -> int:
        """Run the command."""
        from league.agents import checkpoint, export

        if self.csv is not None or self.json is not None:
            return self._export_league()
        given, path = self._named()
        export.to_onnx(checkpoint.load(given), path)
        print(f"Network: {path}   ({path.stat().st_size / 1024:.0f} kB)")
        return 0

    def _named(self) -> tuple[Path, Path]:
        """Return the checkpoint, and where its network goes."""
        given, to = self.checkpoint, list(self.onnx or ())
        if given is None and to:
            given = to.pop()  # `--onnx a.pt` and `--onnx a.onnx a.pt`
        if given is None:
            raise ConfigError(
                "nothing was named to export: give a checkpoint (FILE.pt), or --csv FILE or "
                "--json FILE for the results of a league"
            )
        path = to[0] if to else given.with_suffix(".onnx")
        if len(to) > 1 or path.suffix == ".pt":
            raise ConfigError(
                f"--onnx would write {' and '.join(map(str, to))}: give one file, NAME.onnx, or "
                "none for one beside the checkpoint"
            )
        return given, path

    def _export_league(self) -> int:
        from league.cli.season import export as exporting

        if self.checkpoint is not None or self.onnx is not None:
            raise ConfigError(
                "a checkpoint was named together with --csv or --json, which export a league: "
                "do one after the other"
            )
        with self.opened() as store:
            exporting.write(store, exporting.Wish(self.csv, self.json))
        return 0


def _lines(loaded: Checkpoint, digest: str) -> list[tuple[str, str]]:
    """Return the card for people: the name of a line, and what it says."""
    card = loaded.card
    numbers = sum(weight.size for weight in loaded.weights.values())
    told = card.model_dump(mode="json")
    lines = [
        ("name", card.name),
        ("digest", digest),
        ("trained on", f"{', '.join(card.tracks) or 'not told'} ({card.kind})"),
        ("reward", card.reward.name if card.reward else "not told"),
        ("training", f"{card.steps:,} decisions in {card.train_s:.0f} s, seed {card.seed}"),
        ("sensors", _brief(told["sensors"])),
        ("actions", _brief(told["action_space"])),
        ("network", f"{_brief(told['network'])} ({numbers:,} numbers)"),
        ("results", _brief({key: value for key, value in told["results"].items()})),
        ("parents", ", ".join(parent[:12] for parent in card.parents)),
        ("made", f"{card.created}, league {card.league_version or 'not told'}"),
        ("licence", card.licence),
        ("command", card.command),
    ]
    return [(name, value) for name, value in lines if value]


def _brief(value: object) -> str:
    """Return data in few signs: 'width 64, height 48'; what is None is left out."""
    if isinstance(value, dict):
        parts = [f"{name} {_brief(part)}" for name, part in value.items() if part is not None]
        return ", ".join(parts)
    if isinstance(value, list):
        return f"({' '.join(_brief(part) for part in value)})"
    return f"{value:g}" if isinstance(value, float) else str(value)


COMMANDS = {"card": ShowCard, "export": Export}
