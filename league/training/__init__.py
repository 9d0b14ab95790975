"""Training: a learner on many planar worlds, judged in Bullet from the start line."""
