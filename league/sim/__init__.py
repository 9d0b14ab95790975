"""The world: cars, physics, sensors and rules; it knows no reward, no learner, no league."""
