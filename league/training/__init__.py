"""Training: a learner on many planar worlds, evaluated in Bullet from the start line."""
