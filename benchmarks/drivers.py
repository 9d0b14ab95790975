"""How good the scripted drivers are: lap times against the bound, and in the two solvers."""

from benchmarks.report import figure, heading, table
from league.race_spec import CarResult, Entry, RaceSpec
from league.racing import race
from league.racing_line.racing_line import lap_bound
from league.sim.config import CarConfig
from league.track import files
from league.track.track import Track

LAPS = 3


def drive(driver: str, track: Track, solver: str = "bullet") -> CarResult:
    """Drive a time trial of three laps and return how it ended."""
    spec = RaceSpec(
        track=track.name,
        kind="time_trial",
        laps=LAPS,
        solver=solver,
        entries=(Entry(name=driver),),
    )
    return race.run(spec, track=track, record=False).result.order[0]


def main() -> None:
    """Print the table of laps, and how far the solvers disagree."""
    heading("Scripted drivers, three laps in Bullet")
    columns = "track", "bound", "racing_line best lap", "ratio", "off-tracks", "planar differs"
    row = table(*columns)
    differences, home_ratio = [], 0.0
    for name in files.names():
        track = files.load(name)
        bound = lap_bound(track, CarConfig())
        bullet, planar = drive("racing_line", track), drive("racing_line", track, "planar")
        best, other = bullet.best_lap_s, planar.best_lap_s
        assert best is not None and other is not None, f"no complete lap on {name}"
        assert best > bound, f"a lap of {best} s on {name} is faster than its bound {bound} s"
        difference = abs(best - other) / best
        differences.append(difference)
        if name == "reinvent_2018":
            home_ratio = best / bound
        laps = f"{bound:.3f} s", f"{best:.3f} s", f"{best / bound:.3f}"
        row(name, *laps, bullet.off_tracks, f"{100 * difference:.3f} %")
    figure("racing_line on reinvent_2018, flying lap over bound", home_ratio, "", 1.10, most=True)
    figure("largest lap time difference of the solvers", 100 * max(differences), "%", 1, most=True)


if __name__ == "__main__":
    main()
