"""The trace of an evaluation on a track that has waypoints of its own."""

from dataclasses import dataclass, field, replace

import numpy as np

from league.racing.evaluate import evaluate
from league.racing.trace import Trace
from league.sim.config import SensorConfig
from tests.scenes import follow_center, make_straight


@dataclass
class Follower:
    """Follows the centreline."""

    name: str = "follower"
    sensors: SensorConfig = field(default_factory=SensorConfig)

    def reset(self, rows):
        """Remember nothing."""

    def act(self, observations):
        """Drive at 1.5 m/s."""
        return follow_center(observations, 1.5, 0.0)


def test_closest_waypoint_is_given_by_its_number_in_the_tracks_own_list():
    waypoints = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 0.0], [3.0, 0.0], [9.0, 0.0], [10.0, 0.0]])
    trace = Trace()
    evaluate(
        Follower(),
        replace(make_straight(), waypoints=waypoints),
        solver="planar",
        laps=1,
        watch=trace.add,
    )
    rows = trace.rows()
    # The nearer of two: they change at 1, 2.5, 6 and 9.5 m; the first of two equal ones is 2.
    wanted = [(0, 2, 3, 4, 5)[sum(row["X"] > edge for edge in (1, 2.5, 6, 9.5))] for row in rows]
    near = [row["closest_waypoint"] for row in rows]
    # Ahead of the first stretch lies number 1, and behind the second one number 2.
    assert [2 if one == 1 else one for one in near] == wanted
    assert {0, 1, 2, 3, 4, 5} == set(near)
