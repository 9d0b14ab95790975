"""The learner: networks, PPO, symmetry and the teacher."""
