"""How small replays are, and how soon they can be watched, as a recording or a film."""

import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import av

from benchmarks.report import figure, heading, seconds
from league import replay, rerun_view
from league.race_spec import Entry, RaceSpec
from league.racing import race


def film(race: Path) -> tuple[float, float]:
    """Return the processor time of `league video`, the whole process, and the film's length [s]."""
    path = race.with_suffix(".mp4")
    command = [sys.executable, "-m", "league.cli", "video", str(race), str(path)]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    with av.open(path) as written:
        assert written.duration is not None, "the film has no length"
        length_s = written.duration / av.time_base
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, length_s


def main() -> None:
    """Print the figures for a race of two cars of about a minute."""
    heading("Replays of a two-car race")
    spec = RaceSpec(entries=(Entry(name="cautious"), Entry(name="centerline")), laps=6)
    finished = race.run(spec)
    assert finished.replay is not None
    minutes = finished.result.race_s / 60
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "minute.race"
        replay.write(finished.replay, path)
        read = replay.read(path)
        assert replay.compare(finished.replay, read).agrees, "what was read is not what was written"
        figure("file of record", path.stat().st_size / 1000 / minutes, "kB/min", 60, most=True)
        figure("reading it", 1000 * seconds(lambda: replay.read(path)), "ms")
        for cameras, goal in ((False, None), (True, 5.0)):
            recording = Path(name) / "minute.rrd"
            start = time.perf_counter()
            rerun_view.save(read, recording, cameras=cameras)
            taken = (time.perf_counter() - start) / minutes
            what = "with stereo" if cameras else "without cameras"
            figure(f"Rerun recording, {what}", taken, "s per minute", goal, most=True)
            size = recording.stat().st_size / 1e6 / minutes
            figure(f"its size, {what}", size, "MB/min")
        spent_s, length_s = film(path)
        assert length_s > 10, "the film is too short"
        name = "league video, whole process, processor time of a second of film"
        figure(name, spent_s / length_s, "s", 1, most=True)
        figure("the film", length_s, "s")


if __name__ == "__main__":
    main()
