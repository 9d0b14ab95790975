"""Stay near the centreline: the first example of the DeepRacer developer guide, in three bands.

Try it: league reward check examples/reward_centerline.py
"""


def reward_function(params):
    """Pay more the nearer the car is to the centreline."""
    track_width = params["track_width"]
    distance_from_center = params["distance_from_center"]

    if distance_from_center <= 0.1 * track_width:
        reward = 1.0
    elif distance_from_center <= 0.25 * track_width:
        reward = 0.5
    elif distance_from_center <= 0.5 * track_width:
        reward = 0.1
    else:
        reward = 1e-3  # likely off the track
    return float(reward)
