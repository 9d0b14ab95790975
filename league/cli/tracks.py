"""`league tracks`: list, draw, import and generate tracks."""

from __future__ import annotations

import json
import shlex
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from league.atomic_file import replacing
from league.cli import tables
from league.errors import TrackError


@dataclass
class ListTracks:
    """List the tracks that ship with the league."""

    json: bool = False
    """Print JSON."""

    def run(self) -> None:
        from league.track import files

        reports = [files.report(files.load(name)) for name in files.names()]
        if self.json:
            print(json.dumps(reports, indent=2))
            return
        rows = []
        for one in reports:
            length, width = f"{one['length']:.2f}", f"{one['width']:.3f}"
            radius = f"{one['min_radius']:.2f}"
            rows.append((one["name"], one["title"], length, width, radius, one["direction"]))
        heads = ("name", "title", "length", "width", "radius", "driven")
        tables.table("Tracks", heads, rows, "title", "driven", "radius")
        print("Lengths, widths and smallest radii in metres.")


@dataclass
class ShowTrack:
    """Draw a track to a PNG, with start line and direction."""

    name: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="TRACK")]
    """Name of a track, or a track file."""
    out: Path | None = None
    """Where to write the picture; by default NAME.png here."""

    def run(self) -> None:
        from league.track import files, markings

        track = files.load(self.name)
        path = self.out or Path(f"{track.name}.png")
        with replacing(path, "the picture", TrackError) as file:
            file.write_bytes(markings.png(markings.poster(track)))
        one = files.report(track)
        print(
            f"{one['title']}: {one['length']:.2f} m, {one['width']:.3f} m wide, "
            f"{one['direction']}, smallest radius {one['min_radius']:.2f} m"
        )
        print(f"Drawn to {path}")


@dataclass
class ImportTracks:
    """Turn community .npy tracks (N x 6 waypoints) into track files."""

    files: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="FILE...")]
    """The .npy files, or folders of them."""
    out: Path | None = None
    """Where to write the track, by default NAME.yaml here; for several tracks a folder."""

    def run(self) -> None:
        from league.track import files, importer

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
                track = importer.read_npy(source)
                name = Path(f"{track.name}.yaml")
                path = (self.out or name) if single else (self.out or Path()) / name
                files.save(track, path)
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

    seed: int = 0
    """Seed of the first track."""
    count: int = 1
    """How many, with seeds counting up."""
    out: Path = Path("generated")
    """Folder to write to."""
    min_radius: float = 0.5
    """Smallest radius of the centreline [m]."""
    width: tuple[float, float] = (0.6, 1.1)
    """Smallest and largest width of the road [m]; equal for exactly that one."""
    length: tuple[float, float] = (15.0, 40.0)
    """Smallest and largest length [m]."""
    direction: Literal["any", "counter-clockwise", "clockwise"] = "any"
    """Which way round."""

    def run(self) -> None:
        from league.track import files, generate

        if self.count < 1:
            raise TrackError(f"{self.count} tracks were asked for: give a count of at least 1")
        direction = None if self.direction == "any" else self.direction
        for seed in range(self.seed, self.seed + self.count):
            track = generate.generate(
                seed,
                min_radius=self.min_radius,
                width=self.width,
                length=self.length,
                direction=direction,
            )
            path = self.out / f"{track.name}.yaml"
            files.save(track, path)
            print(f"{path}: {track.length:.2f} m, {track.width:.2f} m wide, {track.direction}")


@dataclass
class Tracks:
    """List, draw, import and generate tracks."""

    command: (
        Annotated[ListTracks, tyro.conf.subcommand("list")]
        | Annotated[ShowTrack, tyro.conf.subcommand("show")]
        | Annotated[ImportTracks, tyro.conf.subcommand("import")]
        | Annotated[GenerateTracks, tyro.conf.subcommand("generate")]
    ) = field(default_factory=ListTracks)
