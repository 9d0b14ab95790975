"""A scripted driver of your own, in a race against the league's.

Run it: python examples/own_driver.py
"""

import numpy as np

from league.agents import roster
from league.envs.actions import encode
from league.envs.state import INDEX
from league.race_spec import Entry, RaceSpec
from league.racing import race
from league.sim.config import CarConfig, SensorConfig
from league.track import files
from league.track.track import TrackSet


class Weaver:
    """Follows the centreline by two gains: where am I, and where do I point."""

    name = "weaver"
    sensors = SensorConfig()  # no camera, no lidar: it reads the true state

    def reset(self, rows: np.ndarray | None) -> None:
        """Nothing: this driver has no memory."""

    def act(self, observations) -> np.ndarray:
        """Return steering and speed in [-1, 1], one row for each world."""
        state = observations["state"]
        curvature = state[:, INDEX["curvature_0.25m"]]
        lateral, heading_error = state[:, INDEX["lateral"]], state[:, INDEX["heading_error"]]
        curvature_wanted = curvature - 1.5 * lateral - 2.5 * heading_error
        steering = np.arctan(CarConfig().wheelbase * curvature_wanted)
        speed = 2.2 - 0.8 * np.minimum(np.abs(curvature), 1.5)
        return encode(steering, speed, CarConfig())


def main() -> None:
    """Race it."""
    tracks = TrackSet(files.load("reinvent_2018"))
    spec = RaceSpec(entries=(Entry(name="weaver"), Entry(name="centerline")), laps=2)
    rival = roster.load("centerline", tracks, CarConfig())
    result = race.run(spec, drivers=[Weaver(), rival]).result
    for car in result.order:
        print(f"{car.place}. {car.name:12s} {car.total_s:7.3f} s  best lap {car.best_lap_s:.3f} s")


if __name__ == "__main__":
    main()
