"""The learning problem, and its doors: PettingZoo, Gymnasium, rsl-rl."""
