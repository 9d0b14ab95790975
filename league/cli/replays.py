"""`league view`, `league video` and `league verify`: watch and check recorded races."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from league import times
from league.cli import lazy, tables
from league.cli.season import OnLeague
from league.errors import ReplayError

FOLDER = Path("replays")  # Where races leave their replays.


@dataclass
class View(OnLeague):
    """Open a replay, or a race of a league, in the Rerun viewer."""

    replay: Annotated[Positional[Path | None], arg(metavar="[REPLAY]")] = None
    """The replay file, or the number of a league's heat; by default the newest in replays/."""
    race: int = 1  # Which race of the heat.
    save: Path | None = None
    """Only write the heat's replay to this file, for `league video` or `league verify`."""
    web: bool = False  # Serve the web viewer on this machine only and print its address.
    rrd: Path | None = None  # Only write the Rerun recording to this file.
    cameras: bool = True  # Include what each car saw.

    def run(self) -> int:
        import tempfile

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
    policies: tuple[Path, ...] = ()
    """Checkpoints of the policies that raced, if they are no longer where they were."""

    def run(self) -> int:
        from league import __version__
        from league.sim import PHYSICS

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
        return lazy.replay.read(path)
    with command.opened() as store:
        record = store.heat(name)
        kept = {result.half + 1: result.replay for result in store.results(record.number)}
        if not kept.get(command.race):
            there = ", ".join(str(race) for race, digest in sorted(kept.items()) if digest)
            raise ReplayError(
                f"there is no replay of race {command.race} of heat {record.number} "
                f"({record.state}): replays are kept of race {there or 'none'}"
            )
        return lazy.replay.format.decode(store.blobs.get(kept[command.race] or ""))
