"""`league drivers`, `league card` and `league export`: the drivers there are, and checkpoints."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from league.cli import tables
from league.cli.season import OnLeague
from league.errors import ConfigError

if TYPE_CHECKING:
    from league.agents.checkpoint import Checkpoint


@dataclass
class Drivers:
    """List the scripted drivers and the policies in the garage."""

    def run(self) -> None:
        from league.agents import checkpoint, roster

        rows = list(roster.NAMES.items())
        for name, path in roster.garage().items():
            card = checkpoint.load(path).card
            races = f"{card.kind.replace('_', ' ')} on {', '.join(card.tracks[:3])}"
            training = f"{card.steps:,} decisions, {card.train_s / 60:.1f} min"
            rows.append((name, f"a policy: {races}; {training}"))
        tables.table("Drivers", ("name", "how it drives"), rows)


@dataclass
class ShowCard:
    """Show a checkpoint's card: sensors, network, where it was trained and how well it drove."""

    checkpoint: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="CHECKPOINT")]
    """The checkpoint (FILE.pt), or a name in the garage."""
    json: bool = False
    """Print JSON."""

    def run(self) -> None:
        from league.agents import checkpoint, roster

        loaded = checkpoint.load(roster.checkpoint_path(self.checkpoint))
        if self.json:
            card = loaded.card.model_dump(mode="json")
            print(json.dumps({"digest": checkpoint.digest(loaded), "card": card}, indent=2))
            return
        tables.table(self.checkpoint, ("", "card"), _lines(loaded, checkpoint.digest(loaded)))


@dataclass
class Export(OnLeague):
    """Write a checkpoint's network as ONNX, or a league's results as CSV or JSON."""

    checkpoint: Annotated[tyro.conf.Positional[str | None], tyro.conf.arg(metavar="CHECKPOINT")] = (
        None
    )
    """The checkpoint (FILE.pt) or a name in the garage, for a physical car or any other runtime;
    none for a league."""
    onnx: Annotated[tuple[Path, ...] | None, tyro.conf.arg(metavar="[FILE]")] = None
    """Write ONNX, the default for a checkpoint; without FILE next to the checkpoint (for a name in
    the garage: here), with the ending .onnx."""
    csv: Path | None = None
    """Write the league's results, a line for each car of each race; - is the standard output."""
    json: Path | None = None
    """Write the league's rules, entries, standings and results; - is the standard output."""

    def run(self) -> int:
        if self.csv is None and self.json is None:
            return self._export_network()
        if self.checkpoint is not None or self.onnx is not None:
            raise ConfigError(
                "a checkpoint was named together with --csv or --json, which export a league: "
                "do one after the other"
            )
        from league.cli.season import heats

        with self.opened() as store:
            if self.csv is not None:
                heats.export_csv(store, self.csv)
            if self.json is not None:
                heats.export_json(store, self.json)
        return 0

    def _export_network(self) -> None:
        from league.agents import checkpoint, export, roster

        source, outputs = self.checkpoint, list(self.onnx or ())
        for path in outputs:
            if source is None and path.suffix == ".pt":  # as in `--onnx a.pt`
                source = str(path)
                outputs.remove(path)
                break
        if source is None:
            raise ConfigError(
                "nothing was named to export: give a checkpoint (FILE.pt), or --csv FILE or "
                "--json FILE for the results of a league"
            )
        output = outputs[0] if outputs else Path(source).with_suffix(".onnx")
        if len(outputs) > 1 or output.suffix == ".pt":
            raise ConfigError(
                f"--onnx would write {' and '.join(map(str, outputs))}: give one file, NAME.onnx, "
                "or none for one next to the checkpoint"
            )
        export.to_onnx(checkpoint.load(roster.checkpoint_path(source)), output)
        print(f"Network: {output}   ({output.stat().st_size / 1024:.0f} kB)")


def _lines(loaded: Checkpoint, digest: str) -> list[tuple[str, str]]:
    """Return the lines of the card: name and text."""
    card = loaded.card
    numbers = sum(weight.size for weight in loaded.weights.values())
    data = card.model_dump(mode="json")
    lines = [
        ("name", card.name),
        ("digest", digest),
        ("trained on", f"{', '.join(card.tracks) or 'unknown'} ({card.kind})"),
        ("reward", card.reward.name if card.reward else "unknown"),
        ("training", f"{card.steps:,} decisions in {card.train_s:.0f} s, seed {card.seed}"),
        ("sensors", _brief(data["sensors"])),
        ("actions", _brief(data["action_space"])),
        ("network", f"{_brief(data['network'])} ({numbers:,} numbers)"),
        ("results", _brief(data["results"])),
        ("parents", ", ".join(parent[:12] for parent in card.parents)),
        ("made", f"{card.created}, league {card.league_version or 'unknown'}"),
        ("licence", card.licence),
        ("command", card.command),
    ]
    return [(name, value) for name, value in lines if value]


def _brief(value: object) -> str:
    """Return data as short text, 'width 64, height 48'; None is omitted."""
    if isinstance(value, dict):
        parts = [f"{name} {_brief(part)}" for name, part in value.items() if part is not None]
        return ", ".join(parts)
    if isinstance(value, list):
        return f"({' '.join(_brief(part) for part in value)})"
    return f"{value:g}" if isinstance(value, float) else str(value)
