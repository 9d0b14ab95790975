"""PettingZoo, Gymnasium and rsl-rl: adapters that translate, and nothing else."""
