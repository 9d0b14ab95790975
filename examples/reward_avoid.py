"""Keep to the lane that is free: for boxes, bots and other cars, and safe when there are none.

Try it: league reward check examples/reward_avoid.py
"""

NEAR = 0.8  # metres along the track


def reward_function(params):
    """Pay for being on the road, and less when the next object is near and in our lane."""
    if params["is_offtrack"] or params["is_crashed"]:
        return 1e-3
    reward = 0.5 + 0.5 * params["speed"] / 4.0
    if params["objects_location"]:
        ahead = params["closest_objects"][1]
        gap = params["objects_distance"][ahead] - params["projection_distance"]
        gap %= params["track_length"]
        same_lane = params["objects_left_of_center"][ahead] == params["is_left_of_center"]
        if same_lane and gap < NEAR:
            reward *= max(gap, 0.0) / NEAR
    return reward
