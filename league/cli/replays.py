"""`league view`, `league video`, `league verify`: what is done with a recorded race."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from league.cli import tables


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

        with tables.progress() as progress:
            task = progress.add_task("Rendering", total=1.0)
            video.render(
                replays.read(self.replay),
                self.out,
                progress=lambda part: progress.update(task, completed=part),
            )
        print(f"Video: {self.out}")
        return 0


@dataclass
class Verify:
    """Run a recorded race again and say whether every step agrees."""

    replay: tyro.conf.Positional[Path]
    """The replay file."""
    policies: tuple[Path, ...] = ()
    """Checkpoints of the policies that raced, if they are no longer where they were."""

    def run(self) -> int:
        """Run the command."""
        from league import __version__, race
        from league import replay as replays

        recorded = replays.read(self.replay)
        agreement = replays.compare(recorded, race.rerun(recorded, self.policies))
        print(agreement.sentence)
        then = recorded.league_version
        if not agreement.agrees and then != __version__:
            print(
                f"It was driven by league {then or 'of an older version'}; this is {__version__}."
            )
        return 0 if agreement.agrees else 1


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


COMMANDS = {"view": View, "video": Video, "verify": Verify}
