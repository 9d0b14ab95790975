"""The `state` group: the truth about one car, for critics and scripted drivers.

Its layout is a contract: scripted drivers and docs/observations.md read it by these slices.
"""

LOOKAHEADS = (0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0)
"""Distances ahead of the car at which the track's curvature is reported [m]."""
NEIGHBOURS = 3  # nearest other cars that are reported, ahead or behind, by distance along the track
NEAR_OBSTACLES = 2  # next obstacles ahead that are reported

FIELDS = (
    "s",  # place along the track [m]
    "lateral",  # left of the centreline [m]
    "heading_error",  # car's yaw minus the track's heading [rad]
    "speed_ahead",  # body frame [m/s]
    "speed_left",  # body frame [m/s]
    "yaw_rate",  # [rad/s]
    "steering",  # angle of the front wheels [rad]
    "left",  # distance from the centreline to the left border here [m]
    "right",  # distance from the centreline to the right border here [m]
    "frozen",  # 1 while standing a penalty
    "progress",  # distance since the start line over the lap's length
    *(f"curvature_{ahead:g}m" for ahead in LOOKAHEADS),  # [1/m], positive to the left
    *(
        f"car_{rank}_{what}"
        for rank in range(NEIGHBOURS)
        for what in ("present", "gap", "lateral", "speed", "frozen")
    ),  # gap ahead along the track [m], left of the centreline [m], along the track [m/s]
    *(
        f"obstacle_{rank}_{what}"
        for rank in range(NEAR_OBSTACLES)
        for what in ("present", "gap", "lateral")
    ),
)
SIZE = len(FIELDS)
INDEX = {name: place for place, name in enumerate(FIELDS)}
ABSENT_GAP = 20.0  # gap of a car or an obstacle that is not there [m]
