"""The learning problem, and its adapters to PettingZoo, Gymnasium and rsl-rl."""

from typing import TYPE_CHECKING

from league.envs.adapters.registration import register

if TYPE_CHECKING:
    from league.envs.adapters.parallel_env import parallel_env
    from league.envs.adapters.rsl_vec_env import RacingVecEnv

__all__ = ["RacingVecEnv", "parallel_env", "register"]

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
    raise AttributeError(f"module 'league.envs' has no attribute {name!r}")
