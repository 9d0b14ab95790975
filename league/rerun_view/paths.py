"""Entity paths of a Rerun recording; the tests and the blueprint read the same names."""

from __future__ import annotations

APPLICATION = "racing-league"
TIMELINE = "race_time"  # the only timeline, a duration from the start of the race

WORLD = "world"  # world frame, z up [m]
FLOOR = "world/track/floor"
WALLS = "world/track/walls"
OBSTACLES = "world/obstacles"
CHASE = "world/chase"  # a frame that follows the front of the race; the main view looks from it

TITLE = "race/classification"
EVENTS = "race/events"
PLOT_SPEED = "plots/speed"
PLOT_STEERING = "plots/steering"
PLOT_GAP = "plots/gap"
PLOT_REWARD = "plots/reward"
PLOT_TRAINING = "plots/completion/training"
PLOT_EVALUATION = "plots/completion/evaluation"

WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
EYES = ("left", "right")


def car(slot: int) -> str:
    """Return a car's frame: its base, x ahead. What follows lies in it."""
    return f"world/cars/car_{slot}"


def body(slot: int) -> str:
    """Return a car's shell and chassis."""
    return f"{car(slot)}/body"


def wheel(slot: int, which: str) -> str:
    """Return one wheel's frame, about its axle."""
    return f"{car(slot)}/wheels/{which}"


def lidar(slot: int) -> str:
    """Return the points a car's lidar sees."""
    return f"{car(slot)}/lidar"


def eyes(slot: int) -> str:
    """Return the folder of a car's eyes."""
    return f"{car(slot)}/eyes"


def eye(slot: int, side: str) -> str:
    """Return one eye of a car: a pinhole and its video."""
    return f"{eyes(slot)}/{side}"


def trail(slot: int) -> str:
    """Return the path a car leaves, world frame."""
    return f"world/trails/car_{slot}"


def obstacle(index: int) -> str:
    """Return one box or bot car."""
    return f"{OBSTACLES}/{index}"
