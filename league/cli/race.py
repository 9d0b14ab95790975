"""`league race`, and what it leaves: `replays`, `view`, `video` and `verify`."""

from __future__ import annotations

import json
import math
import shlex
import sys
import tempfile
import textwrap
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, Optional

import tyro
from tyro.conf import Positional, arg

from league import __version__, times
from league.atomic_file import check_writable
from league.cli import lazy, tables
from league.cli.season import OnLeague
from league.errors import ConfigError, ReplayError
from league.flags import Unset
from league.sim import PHYSICS
from league.sim.config import USUAL_OBSTACLES, RaceFormat, RaceKind, RulesName

if TYPE_CHECKING:
    from league.cli.evaluate import Evaluate
    from league.race_spec import RaceResult, RaceSpec
    from league.racing.race import FinishedRace
    from league.sim.records import World
    from league.track.track import Track

FOLDER = Path("replays")  # Where races leave their replays.
STORY_LINES = 12  # Lines of the race's story that are printed at most.
GIVEN = (
    "laps", "seed", "solver", "ranking", "average_laps", "rules", "format", "variation",
)  # fmt: skip
"""Flags that are settings of the spec, as they are; `league evaluate` has some of them."""


class Drivers(tuple[str, ...]):
    """Names of drivers.

    Tyro checks plain classes, and `Optional`, itself; for others it would load typeguard, a
    twentieth of the time of a race.
    """


DRIVERS = tyro.constructors.PrimitiveConstructorSpec(
    nargs="*",
    metavar="DRIVER...",
    instance_from_str=Drivers,
    is_instance=lambda value: isinstance(value, Drivers),
    str_from_instance=list,
)


@dataclass
class Race:
    """Race drivers against each other, or one alone, and keep a replay."""

    drivers: Positional[Annotated[Unset[Drivers], DRIVERS, arg(metavar="DRIVER...")]]
    """Names of scripted drivers (see `league drivers`) or checkpoints (FILE.pt), in grid order."""
    track: str = "reinvent_2018"  # Name of a track (see `league tracks`), or a track file.
    kind: Literal["auto", "time_trial", "obstacle_avoidance", "head_to_head"] = "auto"
    """Kind of race; auto: alone a time trial, or obstacle avoidance where obstacles were asked for;
    together head-to-head."""
    laps: int = 3  # Laps to drive.
    seed: int = 0  # Seed of obstacles and noise.
    solver: Literal["bullet", "planar"] = "bullet"  # Physics.
    ranking: Literal["total", "best", "average"] = "total"
    """Order by total time, best lap, or best mean of consecutive laps."""
    average_laps: int = 2  # How many consecutive laps the mean of --ranking average is of.
    rules: RulesName = "league"
    """Who is to blame and what it costs: as docs/rules.md has it, or as in the original."""
    format: RaceFormat = "standing"
    """How cars line up: standing, as named; qualifying, after two laps alone, the fastest first;
    reverse, the fastest last; pursuit, as named, spread evenly round the lap."""
    obstacles: Unset[Optional[int]] = None  # noqa: UP045  # as `Drivers`
    """Boxes or bots on the track, among which any number of cars drives; by default 6 where --kind
    obstacle_avoidance or --bots asks for some, else none."""
    bots: bool = False  # Slow bot cars that change lanes instead of boxes.
    fixed_obstacles: bool = False  # Obstacles evenly spaced instead of at random places.
    variation: float = 1.0
    """How much the cars differ, drawn from the seed; 1 is two percent of grip, 0: not at all."""
    replay: str = "replays"  # Folder or .race file for the replay; "none" keeps none.
    watch: bool = False  # Stream the race live to the Rerun viewer.
    json: bool = False  # Print the result as JSON.

    def run(self) -> None:
        if not self.drivers:
            raise ConfigError(
                "no drivers were named: try `league race racing_line centerline`; "
                "`league drivers` lists them all"
            )
        track = lazy.files.load(self.track)
        kind = race_kind(self, len(self.drivers))
        if self.format != "standing" and len(self.drivers) < 2:
            raise ConfigError(
                f"--format {self.format} means nothing for a driver alone: name two to eight"
            )
        spec = race_spec(self, track.name, kind, self.drivers)
        print_remark(spec.kind, spec.obstacles, len(spec.entries))
        if spec.format in ("reverse", "qualifying"):
            spec = _after_qualifying(spec, track, quiet=self.json)
        path = replay_path(self.replay, spec, track) if self.replay != "none" else None
        if path is not None:
            check_writable(path, "the replay", ReplayError)
        live = None
        if self.watch:
            live = lazy.rerun_view.Live.start(spec, track)
            print(f"Watching live: {live.address}   (Ctrl-C stops the race)", file=sys.stderr)
            sys.stderr.flush()
        quiet = self.json or not sys.stderr.isatty()
        with tables.progress(disable=quiet) as progress:
            length = spec.laps_on(closed=track.closed) * track.length
            bar = progress.add_task("Racing", total=length)

            def watch(world: World) -> None:
                progress.update(bar, completed=max(float(world.cars["best_distance"].max()), 0.0))
                if live is not None:
                    live.add(world)

            listen = None if live is None else live.note
            # Without a file, too, the story is of the recording.
            finished = lazy.race.run(spec, track=track, watch=watch, listen=listen)
        written = None
        try:
            if finished.replay is not None and path is not None:
                written = lazy.replay.write(finished.replay, path)
        finally:
            _print_result(self, finished, written)  # a full disk undoes no race
        if live is not None:
            live.end(finished.result)
            sys.stdout.flush()
            print(f"The race is over. {live.how_to_end}", file=sys.stderr, flush=True)
            live.wait()
            live.close()


def _after_qualifying(spec: RaceSpec, track: Track, *, quiet: bool) -> RaceSpec:
    """Return the spec with its entries in the order that qualifying laps gave, and print these."""
    laps = lazy.race.qualifying_laps(spec, track)
    if not quiet:
        for lap_s, entry in sorted(zip(laps, spec.entries, strict=True), key=lambda one: one[0]):
            lap = "no complete lap" if math.isinf(lap_s) else times.clock(lap_s)
            print(f"Qualifying: {entry.name}  {lap}")
    return lazy.race.line_up(spec, laps)


def _print_result(command: Race, finished: FinishedRace, replay: Path | None) -> None:
    result = finished.result
    story = []
    if finished.replay is not None and (command.json or len(result.order) > 1):
        story = lazy.broadcast.of_replay(finished.replay)
    if command.json:
        document = {**result.model_dump(mode="json"), "story": [asdict(line) for line in story]}
        document["replay"] = str(replay) if replay else None
        print(json.dumps(document, indent=2))
        return
    _print_classification(result)
    for line in lazy.broadcast.shortened(story, STORY_LINES):
        print(textwrap.fill(line.stamped, tables.console().width, subsequent_indent="    "))
    if replay is not None:
        print(replay_line(replay))


def race_spec(command: Race | Evaluate, track: str, kind: str, drivers: Sequence[str]) -> RaceSpec:
    """Return the checked spec of a race by the flags that two commands share."""
    if isinstance(command, Race) and command.average_laps != 2:
        if command.ranking != "average":
            raise ConfigError(
                "--average-laps means nothing without --ranking average: give both, or neither"
            )
        if command.average_laps > command.laps:
            raise ConfigError(
                f"--average-laps is {command.average_laps}, but the race has {command.laps} laps: "
                "give at most as many"
            )
    given = {name: getattr(command, name) for name in GIVEN if hasattr(command, name)}
    obstacles = {
        "obstacles": num_obstacles(command),
        "obstacle_kind": "bot" if command.bots else "box",
        "random_obstacles": not command.fixed_obstacles,
    }
    field = entries(drivers)
    return lazy.race_spec.checked(
        {**given, **obstacles, "track": track, "kind": kind, "entries": field}
    )


def race_kind(command: Race | Evaluate, num_cars: int) -> RaceKind:
    """Return the kind of race that was asked for, or that fits what else was."""
    if command.kind != "auto":
        return command.kind
    if num_cars > 1:
        return "head_to_head"
    return "obstacle_avoidance" if num_obstacles(command) else "time_trial"


def num_obstacles(command: Race | Evaluate) -> int:
    """Return how many obstacles a command line asks for."""
    asked = command.bots or command.fixed_obstacles
    if asked and command.obstacles == 0:
        raise ConfigError(
            "--bots and --fixed-obstacles mean nothing with --obstacles 0: give more, or neither"
        )
    if command.obstacles is not None:
        return command.obstacles
    return USUAL_OBSTACLES if asked or command.kind == "obstacle_avoidance" else 0


def print_remark(kind: RaceKind, num_obstacles: int, num_cars: int) -> None:
    """Print what there is to say of a kind of race, next to the results."""
    if remark := lazy.race_spec.remark_on(kind, num_obstacles, num_cars):
        print(f"league: {remark}", file=sys.stderr)


def entries(drivers: Sequence[str]) -> list[dict[str, str]]:
    """Return the entries of a spec; a checkpoint is shown by its name and found by its path."""
    shipped, result = lazy.roster.garage(), []
    for driver, name in zip(drivers, labels(drivers), strict=True):
        entry = {"name": name}
        if driver.endswith(".pt"):
            entry["path"] = driver  # not of the garage's: every machine has them under their names
        if driver.endswith(".pt") or driver in shipped:
            entry["digest"] = lazy.checkpoint.load(shipped.get(driver, driver)).digest
        result.append(entry)
    return result


def labels(drivers: Sequence[str]) -> list[str]:
    """Return what drivers are called: checkpoints by their file's name, without its ending.

    Two files of one name (a/best.pt, b/best.pt) are labelled with their folders.
    """
    names = [Path(driver).stem if driver.endswith(".pt") else driver for driver in drivers]
    result = []
    for driver, name in zip(drivers, names, strict=True):
        shared = any(name == other and driver != drivers[k] for k, other in enumerate(names))
        folder = Path(driver).resolve().parent.name
        result.append(f"{folder}/{name}" if shared and driver.endswith(".pt") else name)
    return result


def replay_path(replay: str, spec: RaceSpec, track: Track) -> Path:
    """Return where a replay goes: the file that was named, or one in the folder.

    Its name ends in a hash of the race, so that no other race overwrites it.
    """
    import hashlib

    if replay.endswith(".race"):
        return Path(replay)
    names = "-".join(entry.name.replace("/", "_") for entry in spec.entries)[:80]
    # Where a checkpoint lies decides nothing; its digest is in the spec.
    content = spec.model_dump_json(exclude={"entries": {"__all__": {"path"}}}) + lazy.files.dump(
        track
    )
    mark = hashlib.sha256(content.encode()).hexdigest()[:6]
    return Path(replay) / f"{spec.track}-{names}-{spec.kind}-{spec.seed}-{mark}.race"


def replay_line(replay: Path) -> str:
    """Return the line that says where a replay is, and how to watch it."""
    newest = replay.parent == FOLDER  # where `league view` looks by itself
    name = "" if newest else f" {shlex.quote(str(replay))}"
    return f"Replay: {replay}   (watch it: league view{name})"


def _print_classification(result: RaceResult) -> None:
    spec, winner, rows = result.spec, result.order[0], []
    for car in result.order:
        total = times.clock(car.total_s) if car.finished else "not finished"
        behind = car.finished and car is not winner
        gap = f"+{car.total_s - winner.total_s:.3f}" if behind else ""
        best = times.clock(car.best_lap_s) if car.best_lap_s else ""
        penalty = f"{car.penalty_s:.1f}" if car.penalty_s else ""
        mistakes = car.off_tracks, car.crashes, penalty
        rows.append((car.place, car.name, car.laps, total, gap, best, *mistakes))
    title = spec.title if spec.format == "standing" else f"{spec.title}, {spec.format}"
    heads = ("", "driver", "laps", "total", "gap", "best lap", "off", "crash", "penalty")
    tables.table(title, heads, rows, "crash", "off", "laps", "best lap", "gap")
    if len(result.order) > 1:
        print(f"Lead changes: {result.lead_changes}")


@dataclass
class View(OnLeague):
    """Open a replay, or a race of a league, in the Rerun viewer."""

    replay: Annotated[Positional[Unset[Path | None]], arg(metavar="[REPLAY]")] = None
    """The replay file, or the number of a league's heat; by default the newest in replays/."""
    race: Unset[int | None] = None  # Which race of the heat, by default the first.
    save: Unset[Path | None] = None
    """Only write the heat's replay to this file, for `league video` or `league verify`."""
    web: bool = False  # Serve the web viewer on this machine only and print its address.
    rrd: Unset[Path | None] = None  # Only write the Rerun recording to this file.
    cameras: bool = True  # Include what each car saw.

    def run(self) -> int:
        replay = self.replay or _recordings(FOLDER)[-1]
        recorded = _recorded(self, replay)
        if self.save is not None:
            print(f"Replay: {lazy.replay.write(recorded, self.save)}")
            return 0
        if self.rrd is not None:
            lazy.rerun_view.save(recorded, self.rrd, cameras=self.cameras)
            print(f"Recording: {self.rrd}")
            return 0
        with tempfile.TemporaryDirectory(prefix="league-") as folder:
            path = Path(folder) / f"{replay.stem}.rrd"
            lazy.rerun_view.save(recorded, path, cameras=self.cameras)
            if not self.web:
                return lazy.rerun_view.open_viewer(path)
            with lazy.rerun_view.serve(path) as server:
                print(f"Open {server.url}   (Ctrl-C stops)", flush=True)
                server.wait()
        return 0


@dataclass
class ListReplays:
    """List the recorded races of a folder, the newest first."""

    folder: Annotated[Positional[Path], arg(metavar="[FOLDER]")] = FOLDER  # Where to look.
    json: bool = False  # Print JSON.

    def run(self) -> None:
        rows, unreadable = [], []
        for path in reversed(_recordings(self.folder)):
            try:
                result = lazy.replay.read(path).result
            except ReplayError as error:
                unreadable.append(str(error))
                continue
            rows.append((path, result))
        if self.json:
            results = [{"file": str(path), "spec": one.spec.model_dump()} for path, one in rows]
            print(json.dumps(results, indent=2))
        else:
            cells = []
            for path, result in rows:
                made, winner = datetime.fromtimestamp(path.stat().st_mtime), result.order[0]
                time = times.clock(winner.total_s) if winner.finished else "not finished"
                cells.append((f"{made:%m-%d %H:%M}", path.name, f"{winner.name} {time}"))
            tables.table(f"Replays in {self.folder}", ("made", "file", "winner"), cells)
        for sentence in unreadable:
            print(f"league: {sentence}", file=sys.stderr)


@dataclass
class Video:
    """Render a replay to an MP4: chase camera, top view, lap counter, running order."""

    replay: Annotated[Positional[Path], arg(metavar="REPLAY")]  # The replay file.
    out: Annotated[Positional[Path], arg(metavar="FILE.mp4")]  # The .mp4 file to write.

    def run(self) -> None:
        if self.out.suffix.lower() != ".mp4":
            raise ReplayError(f"the film {self.out} would be an MP4: give a name that ends in .mp4")
        with tables.progress() as progress:
            task = progress.add_task("Rendering", total=1.0)
            lazy.video.render(
                lazy.replay.read(self.replay),
                self.out,
                progress=lambda share: progress.update(task, completed=share),
            )
        print(f"Video: {self.out}")


@dataclass
class Verify:
    """Run a recorded race again and report whether every step agrees."""

    replay: Annotated[Positional[Path], arg(metavar="REPLAY")]  # The replay file.
    policies: Unset[tuple[Path, ...]] = ()
    """Checkpoints of the policies that raced, if they are no longer where they were."""

    def run(self) -> int:
        recorded = lazy.replay.read(self.replay)
        if recorded.physics != PHYSICS:
            then = f"physics {recorded.physics}" if recorded.physics else "an earlier physics"
            raise ReplayError(
                f"{self.replay} was raced with {then}, and this program has physics {PHYSICS}, so "
                "the race cannot be run again here: watch it with `league view`, or verify it with "
                "a version of the program that has the same physics"
            )
        agreement = lazy.replay.compare(recorded, lazy.race.rerun(recorded, self.policies))
        print(agreement.sentence)
        if recorded.spec.rules != lazy.race_spec.RaceSpec.model_fields["rules"].default:
            print(f"Both were driven under the rules {recorded.spec.rules!r}, which it names.")
        then = recorded.league_version
        if not agreement.agrees and then != __version__:
            print(
                f"It was driven by league {then or 'of an older version'}; this is {__version__}."
            )
        return 0 if agreement.agrees else 1


def _recordings(folder: Path) -> list[Path]:
    """Return the replays of a folder, of which there must be some, the newest last."""
    if folder.is_file():
        raise ReplayError(f"{folder} is a file: give a folder, or say `league view {folder}`")
    paths = sorted(folder.glob("*.race"), key=lambda path: path.stat().st_mtime)
    if not paths:
        raise ReplayError(
            f"there is no replay in {folder}/ yet: race first, say `league race racing_line "
            "centerline`, or name a replay file"
        )
    return paths


def _recorded(command: View, path: Path) -> lazy.replay.Replay:
    """Return the replay of a file or, if there is none and the name is a heat's, of a league."""
    name = str(path)
    if path.exists() or not set(name) <= set("0123456789abcdef"):
        recorded = lazy.replay.read(path)
        if command.race is not None:
            raise ReplayError(f"{path} is one race: give --race with the number of a league's heat")
        return recorded
    race = 1 if command.race is None else command.race
    with command.opened() as store:
        record = store.heat(name)
        kept = {result.half + 1: result.replay for result in store.results(record.number)}
        if not kept:
            raise ReplayError(
                f"heat {record.number} has not been raced yet ({record.state}): there is a replay "
                "once it is done"
            )
        if not kept.get(race):
            there = ", ".join(str(race) for race, digest in sorted(kept.items()) if digest)
            raise ReplayError(
                f"there is no replay of race {race} of heat {record.number} "
                f"({record.state}): replays are kept of race {there or 'none'}"
            )
        return lazy.format.decode(store.blobs.get(kept[race] or ""))
