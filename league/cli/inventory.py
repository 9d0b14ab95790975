"""`league tracks`, `drivers`, `card`, `export`: what there is to race on and with."""

from __future__ import annotations

import json
import shlex
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg, subcommand

from league.atomic_file import replacing
from league.cli import lazy, tables
from league.cli.season import OnLeague
from league.errors import ConfigError, TrackError
from league.flags import Unset


@dataclass
class ListTracks:
    """List the tracks that ship with the league."""

    json: bool = False  # Print JSON.

    def run(self) -> None:
        reports = [lazy.files.report(lazy.files.load(name)) for name in lazy.files.names()]
        if self.json:
            print(json.dumps(reports, indent=2))
            return
        rows = []
        for one in reports:
            sizes = f"{one['length']:.2f}", f"{one['width']:.3f}", f"{one['min_radius']:.2f}"
            rows.append((one["name"], one["title"], *sizes, one["direction"]))
        heads = ("name", "title", "length", "width", "radius", "driven")
        tables.table("Tracks", heads, rows, "title", "driven", "radius")
        print("Lengths, widths and smallest radii in metres.")


@dataclass
class ShowTrack:
    """Draw a track to a PNG, with start line and direction."""

    name: Annotated[Positional[str], arg(metavar="TRACK")]  # Name of a track, or a track file.
    out: Unset[Path | None] = None  # Where to write the picture; by default NAME.png here.

    def run(self) -> None:
        track = lazy.files.load(self.name)
        path = self.out or Path(f"{track.name}.png")
        with replacing(path, "the picture", TrackError) as file:
            file.write_bytes(lazy.markings.png(lazy.markings.poster(track)))
        one = lazy.files.report(track)
        print(
            f"{one['title']}: {one['length']:.2f} m, {one['width']:.3f} m wide, "
            f"{one['direction']}, {track.bends}"
        )
        print(f"Drawn to {path}")


@dataclass
class ImportTracks:
    """Turn community .npy tracks (N x 6 waypoints) into track files."""

    files: Annotated[Positional[Unset[tuple[Path, ...]]], arg(metavar="FILE...")]
    """The .npy files, or folders of them."""
    out: Unset[Path | None] = None
    """Where to write the track, by default NAME.yaml here; for several tracks a folder."""

    def run(self) -> None:
        sources: list[Path] = []
        for file in self.files:
            found = sorted(file.glob("*.npy")) if file.is_dir() else [file]
            if not found:
                raise TrackError(f"there is no .npy file in the folder {file}: give another")
            sources += found
        if not sources:
            raise TrackError("no files were named: give .npy files, or a folder of them")
        single = len(sources) == 1 and not self.files[0].is_dir()
        single = single and not (self.out is not None and self.out.is_dir())
        if not single and self.out is not None and self.out.suffix == ".yaml":
            raise TrackError(
                f"{len(sources)} tracks would be written to {self.out}: give a folder as --out"
            )
        refused = 0
        for source in sources:
            try:
                track = lazy.importer.read_npy(source)
                name = Path(f"{track.name}.yaml")
                path = (self.out or name) if single else (self.out or Path()) / name
                lazy.files.save(track, path)
            except TrackError as error:
                if single:
                    raise
                print(f"league: {error}", file=sys.stderr)
                refused += 1
                continue
            print(f"{track.length:.2f} m, {track.direction}. Written to {path}")
            if single:
                quoted = shlex.quote(str(path))
                print(f"Race on it: league race racing_line centerline --track {quoted}")
        if refused:
            raise TrackError(f"{refused} of {len(sources)} files were not imported: see above")


@dataclass
class GenerateTracks:
    """Draw new tracks from seeds, for training."""

    seed: int = 0  # Seed of the first track.
    count: int = 1  # How many, with seeds counting up.
    out: Path = Path("generated")  # Folder to write to.
    min_radius: float = 0.5  # Smallest radius of the centreline [m].
    width: tuple[float, float] = (0.6, 1.1)
    """Smallest and largest width of the road [m]; equal for exactly that one."""
    length: tuple[float, float] = (15.0, 40.0)  # Smallest and largest length [m].
    direction: Literal["any", "counter-clockwise", "clockwise"] = "any"  # Which way round.

    def run(self) -> None:
        if self.count < 1:
            raise TrackError(f"{self.count} tracks were asked for: give a count of at least 1")
        direction = None if self.direction == "any" else self.direction
        for seed in range(self.seed, self.seed + self.count):
            track = lazy.generate.generate(
                seed,
                min_radius=self.min_radius,
                width=self.width,
                length=self.length,
                direction=direction,
            )
            path = self.out / f"{track.name}.yaml"
            lazy.files.save(track, path)
            print(f"{path}: {track.length:.2f} m, {track.width:.2f} m wide, {track.direction}")


@dataclass
class Tracks:
    """List, draw, import and generate tracks."""

    command: (
        Annotated[ListTracks, subcommand("list")]
        | Annotated[ShowTrack, subcommand("show")]
        | Annotated[ImportTracks, subcommand("import")]
        | Annotated[GenerateTracks, subcommand("generate")]
    ) = field(default_factory=ListTracks)


@dataclass
class Drivers:
    """List the scripted drivers and the policies in the garage."""

    def run(self) -> None:
        rows = list(lazy.roster.NAMES.items())
        for name, path in lazy.roster.garage().items():
            card = lazy.checkpoint.load(path).card
            races = f"{card.kind.replace('_', ' ')} on {', '.join(card.tracks[:3])}"
            training = f"{card.steps:,} decisions, {card.train_s / 60:.1f} min"
            rows.append((name, f"a policy: {races}; {training}"))
        tables.table("Drivers", ("name", "how it drives"), rows)


@dataclass
class ShowCard:
    """Show a checkpoint's card: sensors, network, where it was trained and how well it drove."""

    checkpoint: Annotated[Positional[str], arg(metavar="CHECKPOINT")]
    """The checkpoint (FILE.pt), or a name in the garage."""
    json: bool = False  # Print JSON.

    def run(self) -> None:
        loaded = lazy.checkpoint.load(lazy.roster.checkpoint_path(self.checkpoint))
        if self.json:
            card = loaded.card.model_dump(mode="json")
            print(json.dumps({"digest": loaded.digest, "card": card}, indent=2))
            return
        tables.table(self.checkpoint, ("", "card"), _lines(loaded))


@dataclass
class Export(OnLeague):
    """Write a checkpoint's network as ONNX, or a league's results as CSV or JSON."""

    checkpoint: Annotated[Positional[Unset[str | None]], arg(metavar="CHECKPOINT")] = None
    """The checkpoint (FILE.pt) or a name in the garage, for a physical car or any other runtime;
    none for a league."""
    onnx: Annotated[Unset[tuple[Path, ...] | None], arg(metavar="[FILE]")] = None
    """Write ONNX, the default for a checkpoint; without FILE next to the checkpoint (for a name in
    the garage: here), with the ending .onnx."""
    csv: Unset[Path | None] = None
    """Write the league's results, a line for each car of each race; - is the standard output."""
    json: Unset[Path | None] = None
    """Write the league's rules, entries, standings and results; - is the standard output."""

    def run(self) -> None:
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

    def _export_network(self) -> None:
        source, outputs = self.checkpoint, list(self.onnx or ())
        named = [path for path in outputs if path.suffix == ".pt"]
        if source is None and named:  # as in `--onnx a.pt`
            source = str(named[0])
            outputs.remove(named[0])
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
        lazy.export.to_onnx(lazy.checkpoint.load(lazy.roster.checkpoint_path(source)), output)
        print(f"Network: {output}   ({output.stat().st_size / 1024:.0f} kB)")


def _lines(loaded: lazy.checkpoint.Checkpoint) -> list[tuple[str, str]]:
    """Return the lines of the card: name and text."""
    card = loaded.card
    numbers = sum(weight.size for weight in loaded.weights.values())
    data = card.model_dump(mode="json")
    lines = [
        ("name", card.name),
        ("digest", loaded.digest),
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
        return ", ".join(f"{name} {_brief(one)}" for name, one in value.items() if one is not None)
    if isinstance(value, list):
        return f"({' '.join(_brief(part) for part in value)})"
    return f"{value:g}" if isinstance(value, float) else str(value)
