"""Wheel to wheel: how fast rivals are that a driver passes and holds, and how cleanly it races.

    python -m benchmarks.racing [--races 200] [--solver bullet] [--track NAME] [POLICY.pt ...]

Without policies the garage's duelist; of several, such as the seeds of one training, the medians
are printed, too. A pass threshold is the fastest pace of a defender, as a share of the attacker's
own flying lap, against which at least half of the three-lap attacks from one place behind succeed
without a contact to blame for and without leaving the road.
"""

import argparse
import statistics
from pathlib import Path

import numpy as np

from benchmarks.lap_bound import lap_bound
from benchmarks.report import figure, heading, note, table, without_traceback
from league.agents import roster
from league.envs.driver import Driver
from league.racing import duels
from league.racing.duels import RESOLUTION, DuelConfig, Threshold
from league.racing.evaluate import evaluate
from league.sim.config import CarConfig
from league.track import files
from league.track.track import TrackSet

CAR = CarConfig()
HALF_PACE = 0.5
BEFORE = Path(__file__).parent / "rivals" / "duelist_2026.pt"
"""The duelist that the garage had until it learned wheel to wheel, which goals name."""


Figure = tuple[float, str, float | None, bool]  # value, unit, goal, and whether it is a bound
MIXED = ("cautious", "racing_line", "blocker")


def measure(path: str, cfg: DuelConfig) -> dict[str, Figure]:
    """Measure one policy; return its figures by name."""
    tracks, figures = TrackSet(cfg.track), dict[str, Figure]()

    def load(name: str) -> Driver:
        return roster.load(name, tracks, CAR)

    def show(
        name: str, value: float, unit: str, goal: float | None = None, *, most: bool = False
    ) -> None:
        figures[name] = value, unit, goal, most
        figure(name, value, unit, goal, most=most)

    policy = load(path)
    goal = 0.93 if policy.sensors.truth else 0.90
    heading(f"{policy.name} on {cfg.track.name}, {cfg.solver}, {cfg.races} races at each pace")
    if cfg.track.closed:
        solo = evaluate(load(path), cfg.track, laps=10, variation=0.0, solver=cfg.solver)
        bound = lap_bound(cfg.track, CAR)
        best = solo.best_flying_s or np.inf
        show("solo flying lap over the bound", best / bound, "x", 1.06, most=True)
        show("off-tracks in ten laps", solo.off_tracks, "", 0, most=True)
    found = duels.threshold(cfg, load(path), load(path))
    _show(found)
    show("pass threshold against itself, slowed", found.pace, "of its pace", goal)
    show("hold threshold", found.hold, "of its pace", 1.03)
    show("contacts to blame for per km near others", found.contacts_per_km, "", 1.0, most=True)
    show("such contacts above 0.3 m/s per km", found.hard_contacts_per_km, "", 0.2, most=True)
    show("  of these in the first three seconds", 100 * found.hard_at_start, "%")
    show("off-tracks per pass", found.off_tracks_per_pass, "")
    for name, rival in (("racing_line", "racing_line"), ("the duelist of before", str(BEFORE))):
        against = duels.threshold(cfg, load(path), load(rival))
        show(f"pass threshold against {name}, slowed", against.pace, "of its pace", goal)
    last = duels.from_behind(cfg, [*map(load, ["centerline"] * 3), load(path)], [1.0] * 4)
    show("from last of four against three centerline: won", 100 * last.passed, "%", 90)
    names, finished = ", ".join(MIXED), []
    columns = ("won", "places gained", "cars that finish", "hard/race", "off/race")
    row = table(f"place of four with {names}", *columns)
    for place in range(4):
        field = [*map(load, MIXED)]
        field.insert(place, load(path))
        seen = duels.from_place(cfg, field, [1.0] * 4, place)
        finished.append(seen.finished)
        mistakes = (seen.hard_contacts / cfg.races, seen.off_tracks / cfg.races)
        rates = (f"{seen.passed:.2f}", f"{seen.places:.2f}", f"{seen.finished:.3f}")
        row(place + 1, *rates, *(f"{rate:.2f}" for rate in mistakes))
    show(f"from last of four against {names}: won", 100 * seen.passed, "%")
    show("cars of these races that finish", 100 * statistics.fmean(finished), "%", 100)
    twice_s = duels.solo_lap(cfg, load(path)) / HALF_PACE
    half = _top_speed(cfg, load("racing_line"), twice_s)
    for name, rival, top_speed in (
        ("the duelist of before", str(BEFORE), 1.0),
        ("a roadblock at half pace", "racing_line", half),
    ):
        seen = duels.from_behind(cfg, (load(rival), load(path)), (top_speed, 1.0))
        show(f"from behind against {name}: won", 100 * seen.passed, "%", 90)
        show(f"  won against {name}, and it left the road", 100 * seen.given, "%")
    return figures


def _top_speed(cfg: DuelConfig, driver: Driver, lap_s: float) -> float:
    """Return the share of the top speed under which a driver laps in this time, to a hundredth."""
    low, high = 0.1, 1.0
    while high - low > RESOLUTION:
        share = 0.5 * (low + high)
        low, high = (share, high) if duels.solo_lap(cfg, driver, share) > lap_s else (low, share)
    return low


def _show(found: Threshold) -> None:
    row = table(
        "pace of the defender", "passed", "cleanly", "held", "contacts/km", "hard/km", "off"
    )
    for pace, one in found.duels.items():
        rates = (f"{share:.2f}" for share in (one.passed, one.clean, one.held))
        near_km = max(one.near_km, 1e-9)
        per_km = (f"{rate:.1f}" for rate in (one.contacts / near_km, one.hard_contacts / near_km))
        row(f"{pace:.3f}", *rates, *per_km, one.off_tracks)


@without_traceback()
def main(arguments: list[str] | None = None) -> None:
    """Measure the given policies."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("policies", nargs="*", default=[str(roster.garage()["duelist"])])
    parser.add_argument("--races", type=int, default=200)
    parser.add_argument("--solver", choices=("bullet", "planar"), default="bullet")
    parser.add_argument("--track", default="reinvent_2018")
    given = parser.parse_args(arguments or [])
    cfg = DuelConfig(files.load(given.track), races=given.races, solver=given.solver)
    measured = [measure(path, cfg) for path in given.policies]
    if len(measured) > 1:
        heading(f"Medians of these {len(measured)} policies")
        for name, (_, unit, goal, most) in measured[0].items():
            middle = statistics.median(figures[name][0] for figures in measured)
            figure(name, middle, unit, goal, most=most)
    note(f"Cars differ by {duels.VARIATION:g} times what they do in a league's heats.")


if __name__ == "__main__":
    import sys

    main(sys.argv[1:])
