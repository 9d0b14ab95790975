"""Point along the track, steer little, and do not dawdle: three classic ideas multiplied.

Try it: league reward check examples/reward_heading.py
"""

import math

DIRECTION_THRESHOLD = 10.0  # degrees
STEERING_THRESHOLD = 15.0  # degrees
SPEED_THRESHOLD = 1.0  # metres per second


def reward_function(params):
    """Pay for facing the way the next waypoint lies; less for hard steering and for crawling."""
    if not params["all_wheels_on_track"]:
        return 1e-3
    waypoints = params["waypoints"]
    behind, ahead = params["closest_waypoints"]
    here, there = waypoints[behind], waypoints[ahead]

    track_direction = math.degrees(math.atan2(there[1] - here[1], there[0] - here[0]))
    difference = abs(track_direction - params["heading"])
    if difference > 180:
        difference = 360 - difference

    reward = 1.0
    if difference > DIRECTION_THRESHOLD:
        reward *= 0.5
    if abs(params["steering_angle"]) > STEERING_THRESHOLD:
        reward *= 0.8
    if params["speed"] < SPEED_THRESHOLD:
        reward *= 0.5
    return reward
