"""The ids under which Gymnasium finds the races; registering them loads nothing heavy."""

IDS = {
    "league/TimeTrial-v0": "time_trial",
    "league/ObstacleAvoidance-v0": "obstacle_avoidance",
    "league/HeadToHead-v0": "head_to_head",
}
"""Each id and its kind of race."""


def register() -> None:
    """Register the ids with Gymnasium, once."""
    import gymnasium

    for name, kind in IDS.items():
        if name not in gymnasium.registry:
            gymnasium.register(
                id=name,
                entry_point="league.envs.adapters.gym_env:GymEnv",
                vector_entry_point="league.envs.adapters.gym_env:GymVectorEnv",
                kwargs={"kind": kind},
            )
