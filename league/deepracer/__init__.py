"""What DeepRacer's users bring: reward functions, model_metadata.json, hyperparameters.json."""

from league.deepracer.user_reward import UserReward, user_reward

__all__ = ["UserReward", "user_reward"]
