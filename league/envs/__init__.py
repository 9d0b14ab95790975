"""The learning problem, and its doors: PettingZoo, Gymnasium, rsl-rl."""

from typing import TYPE_CHECKING

from league.envs.adapters.registration import register

if TYPE_CHECKING:
    from league.envs.adapters.parallel_env import parallel_env
    from league.envs.adapters.rsl_vec_env import RacingVecEnv

__all__ = ["RacingVecEnv", "parallel_env", "register"]

# Gymnasium finds the ids of a package once it is imported.
register()


def __getattr__(name: str) -> object:
    """Open a door on first use, so that nobody waits for a neighbour that is not needed."""
    if name == "parallel_env":
        from league.envs.adapters.parallel_env import parallel_env

        return parallel_env
    if name == "RacingVecEnv":
        from league.envs.adapters.rsl_vec_env import RacingVecEnv

        return RacingVecEnv
    raise AttributeError(f"module 'league.envs' has no attribute {name!r}")
