"""What the policies of the garage can do, each asked what it was trained for.

The duelist is measured in racing.py.

    python -m benchmarks.garage [NAME=FILE ...]

Without arguments all of garage/*.pt; with them, these files instead of the garage's own.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path

from benchmarks.report import figure, heading, note, table
from league.errors import PolicyError
from league.racing.evaluate import evaluate
from league.racing.table import Evaluation
from league.racing_line.racing_line import lap_bound
from league.sim.config import CarConfig, ObstacleConfig
from league.track import files, importer
from league.track.track import Track

ROOT = Path(__file__).parents[1]
GARAGE = ROOT / "garage"
COMMUNITY = ROOT.parent / "shared" / "tracks"
HOME = "reinvent_2018"

Found = Mapping[str, Path]
"""The checkpoint of each policy that exists."""


def rookie(found: Found) -> None:
    """Three laps at walking pace, the first mistake ends each attempt."""
    seen = evaluate(str(found["rookie"]), HOME, laps=3, mode="episode")
    figure("rookie: complete laps of 3", seen.complete_laps, "laps", 3)
    _lap("rookie: mean lap", seen.mean_lap_s)


def racer(found: Found) -> None:
    """Flying laps against what no lap of this car can beat."""
    track = files.load(HOME)
    bound = lap_bound(track, CarConfig())
    seen = evaluate(str(found["racer"]), track, laps=6, variation=0.0)
    best = seen.best_flying_s
    _lap("racer: best flying lap", best)
    if best is not None:
        figure("racer: best flying lap over the bound", best / bound, "x", 1.03, most=True)
        flying = seen.flying_laps_s
        mean = sum(flying) / len(flying)
        figure("racer: mean flying lap over the bound", mean / bound, "x")
    figure("racer: off-tracks in 6 laps without variation", seen.off_tracks, "", 0, most=True)
    varied = evaluate(str(found["racer"]), track, laps=3, trials=20)
    figure("racer: clean runs of 20, three laps each, varied", varied.clean_runs, "runs", 19)


def globetrotter(found: Found) -> None:
    """Three laps under race rules on tracks it has never seen, ours and the community's."""
    strange = _community()
    row = table("track", "laps of 3", "off-tracks", "mean lap [s]", "bound [s]", "ratio")
    ours = [_abroad(row, found["globetrotter"], files.load(name)) for name in files.names()]
    theirs = [_abroad(row, found["globetrotter"], track) for track in strange]
    closed = [(seen, ratio) for seen, ratio in ours if ratio is not None]
    _abroad_totals("our own tracks", [seen for seen, _ in ours], [r for _, r in closed])
    if theirs:
        seen = [one for one, _ in theirs]
        _abroad_totals("community tracks", seen, [r for _, r in theirs if r is not None])
        clean = sum(one.off_tracks == 0 and one.all_complete for one in seen)
        figure("globetrotter: community tracks without an off-track", clean, f"of {len(seen)}", 6)
    else:
        note(f"No community tracks: {COMMUNITY.name} is not there.")


def _community() -> list[Track]:
    """Return the closed tracks of the community, where they are at hand."""
    found = [importer.read_npy(path) for path in sorted(COMMUNITY.glob("*.npy"))]
    return [track for track in found if track.closed]


def _abroad(row: Callable[..., None], path: Path, track: Track) -> tuple[Evaluation, float | None]:
    """Print one row of the table; return what was driven, and mean lap over bound."""
    seen = evaluate(str(path), track, laps=3)
    bound = lap_bound(track, CarConfig()) if track.closed else None
    mean = seen.mean_lap_s
    ratio = mean / bound if mean is not None and bound is not None else None
    times = [f"{value:.2f}" if value else "-" for value in (mean, bound, ratio)]
    row(track.name, f"{seen.complete_laps} of {seen.asked}", seen.off_tracks, *times)
    return seen, ratio


def _abroad_totals(where: str, seen: list[Evaluation], ratios: list[float]) -> None:
    complete = sum(one.all_complete for one in seen)
    figure(f"globetrotter: {where} with every lap", complete, f"of {len(seen)}", len(seen))
    if ratios:
        mean = sum(ratios) / len(ratios)
        figure(f"globetrotter: mean lap over bound, {where}", mean, "x", 1.5, most=True)


def dodger(found: Found, races: int = 50) -> None:
    """Three laps among six boxes at random places, many times."""
    seen = evaluate(
        str(found["dodger"]),
        HOME,
        laps=3,
        trials=races,
        kind="obstacle_avoidance",
        obstacles=ObstacleConfig(count=6, random_places=True),
    )
    contacts = seen.crashes / races
    figure(f"dodger: contacts in 3 laps, mean of {races} races", contacts, "", 1.0, most=True)
    figure("dodger: off-tracks in 3 laps", seen.off_tracks / races, "")
    figure("dodger: complete laps", seen.complete_laps / seen.asked, "of all")
    _lap("dodger: mean lap, penalties included", seen.mean_lap_s)


def novice(found: Found) -> None:
    """Three laps after a minute of training."""
    seen = evaluate(str(found["novice"]), HOME, laps=3)
    figure("novice: complete laps of 3", seen.complete_laps, "laps", 3)
    _lap("novice: best flying lap", seen.best_flying_s)


def _lap(name: str, time_s: float | None) -> None:
    if time_s is None:
        note(f"{name}: none")
    else:
        figure(name, time_s, "s")


ASKED: dict[str, Callable[[Found], None]] = {
    "rookie": rookie,
    "racer": racer,
    "dodger": dodger,
    "novice": novice,
    "globetrotter": globetrotter,
}


def main(arguments: list[str] | None = None) -> None:
    """Ask every policy that exists what it was trained for."""
    given = dict(one.split("=", 1) for one in arguments or [])
    found = {name: GARAGE / f"{name}.pt" for name in ASKED} if not given else {}
    found |= {name: Path(path) for name, path in given.items()}
    heading("The garage")
    there = {name: path for name, path in found.items() if path.exists()}
    for name, ask in ASKED.items():
        if name not in there:
            if name in found:
                note(f"{name}: there is no {found[name].name}")
            continue
        began = time.perf_counter()
        try:
            ask(there)
        except PolicyError as error:
            note(f"{name}: {error}")
        print(f"({name}: {time.perf_counter() - began:.0f} s)\n", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
