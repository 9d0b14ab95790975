"""Files of DeepRacer's users: reward functions, model_metadata.json, hyperparameters.json."""

from league.deepracer.reward_file import UserReward, user_reward

__all__ = ["UserReward", "user_reward"]
