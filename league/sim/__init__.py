"""The world: cars, physics, sensors and rules; it knows no reward, no learner, no league."""

PHYSICS = "5"
"""Raise it with every change that can alter the outcome of a race: solvers, tyres, referee,
sensors, pictures, scripted drivers, or how a network is evaluated. A league's ratings start again
with it, for races under two versions are not comparable. Rules that a race names (RaceSpec.rules,
Ruleset.rules) are settings: a race driven under others is run again under the same."""
