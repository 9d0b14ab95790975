"""The learning problem, and its adapters to PettingZoo, Gymnasium, rsl-rl and Stable-Baselines3."""

from typing import TYPE_CHECKING

from league.envs.adapters.registration import register

if TYPE_CHECKING:
    from league.envs.adapters.parallel_env import parallel_env
    from league.envs.adapters.rsl_vec_env import RacingVecEnv
    from league.envs.adapters.sb3_vec_env import SB3VecEnv

__all__ = ["RacingVecEnv", "SB3VecEnv", "parallel_env", "register"]

# Gymnasium finds the ids of a package once it is imported.
register()


def __getattr__(name: str) -> object:
    """Import an adapter on first use, without the libraries of the others."""
    if name == "parallel_env":
        from league.envs.adapters.parallel_env import parallel_env

        return parallel_env
    if name == "RacingVecEnv":
        from league.envs.adapters.rsl_vec_env import RacingVecEnv

        return RacingVecEnv
    if name == "SB3VecEnv":
        from league.envs.adapters.sb3_vec_env import SB3VecEnv

        return SB3VecEnv
    raise AttributeError(f"module 'league.envs' has no attribute {name!r}")
