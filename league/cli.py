"""The command line: `league ...`; the only file that prints."""

from __future__ import annotations

import json
import os
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from league.errors import ConfigError, LeagueError, TrackError
from league.whole_file import replacing

if TYPE_CHECKING:
    from rich.console import Console

    from league.race_spec import RaceResult, RaceSpec
    from league.rerun_view import Live
    from league.sim.world import World
    from league.track.course import Track


@dataclass
class Race:
    """Race drivers against each other, or one alone, and keep a replay."""

    drivers: tyro.conf.Positional[tuple[str, ...]]
    """Names of scripted drivers (see `league drivers`), in grid order."""
    track: str = "reinvent_2018"
    """Name of a track (see `league tracks`), or a track file."""
    kind: Literal["auto", "time_trial", "obstacle_avoidance", "head_to_head"] = "auto"
    """Kind of race; auto: alone a time trial, together head-to-head."""
    laps: int = 3
    """Laps to drive."""
    seed: int = 0
    """Seed of obstacles and noise."""
    solver: Literal["bullet", "planar"] = "bullet"
    """Physics."""
    ranking: Literal["total", "best", "average"] = "total"
    """Order by total time, best lap or average lap."""
    obstacles: int = 6
    """Boxes or bots in obstacle avoidance."""
    bots: bool = False
    """Slow bot cars that change lanes instead of boxes."""
    fixed_obstacles: bool = False
    """Obstacles evenly spaced instead of at random places."""
    replay: str = "replays"
    """Folder or .race file for the replay; "none" keeps none."""
    watch: bool = False
    """Stream the race live to the Rerun viewer."""
    json: bool = False
    """Print the result as JSON."""

    def run(self) -> int:
        """Run the command."""
        return _race(self)


@dataclass
class ListTracks:
    """List the tracks that ship with the league."""

    json: bool = False
    """Print JSON."""

    def run(self) -> int:
        """Run the command."""
        from league.track import files

        reports = [files.report(files.load(name)) for name in files.names()]
        if self.json:
            print(json.dumps(reports, indent=2))
            return 0
        table = _table("Tracks", "name", "title", "length", "width", "direction", "min radius")
        for one in reports:
            table.add_row(
                str(one["name"]),
                str(one["title"]),
                f"{one['length']} m",
                f"{one['width']} m",
                str(one["direction"]),
                f"{one['min_radius']} m",
            )
        _console().print(table)
        return 0


@dataclass
class ShowTrack:
    """Draw a track to a PNG, with start line and direction."""

    name: tyro.conf.Positional[str]
    """Name of a track, or a track file."""
    out: Path | None = None
    """Where to write the picture; by default NAME.png here."""

    def run(self) -> int:
        """Run the command."""
        from league.track import files, paint

        track = files.load(self.name)
        path = self.out or Path(f"{track.name}.png")
        with replacing(path, "the picture", TrackError) as file:
            file.write_bytes(paint.png(paint.poster(track)))
        one = files.report(track)
        print(
            f"{one['title']}: {one['length']:.2f} m, {one['width']:.3f} m wide, "
            f"{one['direction']}, smallest radius {one['min_radius']:.2f} m"
        )
        print(f"Drawn to {path}")
        return 0


@dataclass
class ImportTrack:
    """Turn a community .npy track (N x 6 waypoints) into a track file."""

    file: tyro.conf.Positional[Path]
    """The .npy file."""
    out: Path | None = None
    """Where to write the track; by default NAME.yaml here."""

    def run(self) -> int:
        """Run the command."""
        from league.track import files, importer

        track = importer.read_npy(self.file)
        path = self.out or Path(f"{track.name}.yaml")
        files.save(track, path)
        print(f"{track.length:.2f} m, {track.direction}. Written to {path}")
        print(f"Race on it: league race racing_line centerline --track {path}")
        return 0


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

    def run(self) -> int:
        """Run the command."""
        from league.track import files, generate

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
        return 0


@dataclass
class Tracks:
    """List, draw, import and generate tracks."""

    command: (
        Annotated[ListTracks, tyro.conf.subcommand("list")]
        | Annotated[ShowTrack, tyro.conf.subcommand("show")]
        | Annotated[ImportTrack, tyro.conf.subcommand("import")]
        | Annotated[GenerateTracks, tyro.conf.subcommand("generate")]
    ) = field(default_factory=ListTracks)

    def run(self) -> int:
        """Run the command."""
        return self.command.run()


@dataclass
class Drivers:
    """List the scripted drivers."""

    def run(self) -> int:
        """Run the command."""
        from league.agents import roster

        table = _table("Drivers", "name", "how it drives")
        for name, description in roster.NAMES.items():
            table.add_row(name, description)
        _console().print(table)
        return 0


@dataclass
class Verify:
    """Run a recorded race again and say whether every step agrees."""

    replay: tyro.conf.Positional[Path]
    """The replay file."""

    def run(self) -> int:
        """Run the command."""
        from league import race
        from league import replay as replays

        recorded = replays.read(self.replay)
        agreement = replays.compare(recorded, race.rerun(recorded))
        print(agreement.sentence)
        return 0 if agreement.agrees else 1


@dataclass
class View:
    """Open a replay in the Rerun viewer."""

    replay: tyro.conf.Positional[Path]
    """The replay file."""
    web: bool = False
    """Serve the web viewer on this machine only and print its address."""
    rrd: Path | None = None
    """Only write the Rerun recording to this file."""
    cameras: bool = True
    """Render what each car saw."""

    def run(self) -> int:
        """Run the command."""
        return _view(self)


@dataclass
class Video:
    """Render a replay to an MP4: chase camera, top view, lap counter, running order."""

    replay: tyro.conf.Positional[Path]
    """The replay file."""
    out: tyro.conf.Positional[Path]
    """The .mp4 file to write."""

    def run(self) -> int:
        """Run the command."""
        from league import replay as replays
        from league import video

        with _progress() as progress:
            task = progress.add_task("Rendering", total=1.0)
            video.render(
                replays.read(self.replay),
                self.out,
                progress=lambda part: progress.update(task, completed=part),
            )
        print(f"Video: {self.out}")
        return 0


Command = (
    Annotated[Race, tyro.conf.subcommand("race")]
    | Annotated[Tracks, tyro.conf.subcommand("tracks")]
    | Annotated[Drivers, tyro.conf.subcommand("drivers")]
    | Annotated[View, tyro.conf.subcommand("view")]
    | Annotated[Video, tyro.conf.subcommand("video")]
    | Annotated[Verify, tyro.conf.subcommand("verify")]
)


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; return its exit code."""
    command = tyro.cli(
        Command,
        prog="league",
        description="The open racing league for learning drivers.",
        args=arguments,
        config=(tyro.conf.OmitArgPrefixes, tyro.conf.FlagCreatePairsOff),
    )
    try:
        return command.run()
    except LeagueError as error:
        print(f"league: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("league: stopped.", file=sys.stderr)
        return 130
    except BrokenPipeError:
        # Whoever read our output has had enough (`league ... | head`); nothing more can be told.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


def _race(command: Race) -> int:
    from league import race
    from league.track import files

    if not command.drivers:
        raise ConfigError(
            "no drivers were named: try `league race racing_line centerline`; "
            "`league drivers` lists them all"
        )
    track = files.load(command.track)
    spec = _spec(command, track.name)
    keep = command.replay != "none"
    path = _replay_path(command.replay, spec) if keep else None
    live = _live(spec, track) if command.watch else None
    quiet = command.json or not sys.stderr.isatty()
    with _progress(disable=quiet) as progress:
        bar = progress.add_task("Racing", total=spec.laps * track.length)

        def watch(world: World) -> None:
            progress.update(bar, completed=max(float(world.standing.best_distance.max()), 0.0))
            if live is not None:
                live.add(world)

        finished = race.run(spec, track=track, record=keep, watch=watch)
    if finished.replay is not None and path is not None:
        from league import replay as replays

        replays.write(finished.replay, path)
    if command.json:
        told = finished.result.model_dump(mode="json")
        print(json.dumps({**told, "replay": str(path) if path else None}, indent=2))
    else:
        _print_classification(finished.result)
        if path is not None:
            print(f"Replay: {path}   (watch it: league view {path})")
    if live is not None:
        sys.stdout.flush()
        live.wait()
        live.close()
    return 0


def _spec(command: Race, track: str) -> RaceSpec:
    from league.race_spec import checked

    alone = "time_trial" if len(command.drivers) == 1 else "head_to_head"
    return checked(
        {
            "track": track,
            "kind": alone if command.kind == "auto" else command.kind,
            "laps": command.laps,
            "seed": command.seed,
            "solver": command.solver,
            "ranking": command.ranking,
            "entries": [{"name": name} for name in command.drivers],
            "obstacles": command.obstacles,
            "obstacle_kind": "bot" if command.bots else "box",
            "random_obstacles": not command.fixed_obstacles,
        }
    )


def _replay_path(wish: str, spec: RaceSpec) -> Path:
    if wish.endswith(".race"):
        return Path(wish)
    names = "-".join(Path(entry.name).stem for entry in spec.entries)[:80]
    return Path(wish) / f"{spec.track}-{names}-{spec.kind}-{spec.seed}.race"


def _live(spec: RaceSpec, track: Track) -> Live:
    from league.rerun_view import Live

    live = Live.start(spec, track)
    print(f"Watching live: {live.address}   (Ctrl-C stops)", file=sys.stderr, flush=True)
    return live


def _view(command: View) -> int:
    import tempfile

    from league import replay as replays
    from league import rerun_view

    recorded = replays.read(command.replay)
    if command.rrd is not None:
        rerun_view.save(recorded, command.rrd, cameras=command.cameras)
        print(f"Recording: {command.rrd}")
        return 0
    with tempfile.TemporaryDirectory(prefix="league-") as folder:
        path = Path(folder) / f"{command.replay.stem}.rrd"
        rerun_view.save(recorded, path, cameras=command.cameras)
        if not command.web:
            return rerun_view.open_viewer(path)
        from league import web_viewer

        with web_viewer.serve(path) as server:
            print(f"Open {server.url}   (Ctrl-C stops)", flush=True)
            server.wait()
    return 0


def _print_classification(result: RaceResult) -> None:
    spec = result.spec
    laps = "1 lap" if spec.laps == 1 else f"{spec.laps} laps"
    title = f"{spec.kind.replace('_', ' ')} on {spec.track}, {laps}"
    table = _table(
        title, "", "driver", "laps", "total", "gap", "best lap", "off", "crash", "passed"
    )
    winner = result.order[0]
    for car in result.order:
        gap = car.total_s - winner.total_s
        table.add_row(
            str(car.place),
            car.name,
            str(car.laps),
            clock(car.total_s) if car.finished else "not finished",
            f"+{gap:.3f}" if car.finished and car is not winner else "",
            clock(car.best_lap_s) if car.best_lap_s else "",
            str(car.off_tracks),
            str(car.crashes),
            str(car.overtakes),
        )
    _console().print(table)
    if len(result.order) > 1:
        print(f"Lead changes: {result.lead_changes}")


def clock(seconds: float) -> str:
    """Return a time as people read it on a timing screen: m:ss.mmm."""
    minutes, rest = divmod(round(seconds * 1000), 60_000)
    return f"{minutes}:{rest / 1000:06.3f}"


def _console() -> Console:
    from rich.console import Console

    return Console()


def _table(title: str, *columns: str):  # noqa: ANN202
    from rich import box
    from rich.table import Table

    table = Table(
        title=title,
        title_justify="left",
        title_style="bold",
        header_style="dim",
        box=box.SIMPLE_HEAD,
        pad_edge=False,
    )
    for number, column in enumerate(columns):
        left = number < 2 or column in ("title", "direction", "how it drives")
        table.add_column(column, justify="left" if left else "right", no_wrap=True)
    return table


def _progress(disable: bool = False):  # noqa: ANN202
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
        console=Console(stderr=True),
        transient=True,
        disable=disable,
    )


if __name__ == "__main__":
    sys.exit(main())
