"""Settings of the world as one record of numbers, which is how compiled code reads them."""

from __future__ import annotations

import math

import numpy as np

from league.sim.config import SimConfig

GRAVITY = 9.81
"""[m/s^2]."""
HALF_WALL = 5.0
"""Half the thickness of a wall [m]."""
RESTITUTION_FROM = 0.05
"""Slowest approach that bounces [m/s]."""

_F4, _I8, _BOOL = np.float32, np.int64, np.bool_
SETTINGS = np.dtype(
    [
        ("decimation", _I8),  # physics steps in a control step
        ("step_hz", _F4),  # control steps per second
        ("step_dt", _F4),  # [s]
        ("physics_dt", _F4),  # [s]
        # The car.
        ("arm", _F4),  # from the base to either axle [m]
        ("half_track", _F4),  # from the middle of an axle to its wheels [m]
        ("half_length", _F4),  # of the footprint [m]
        ("half_width", _F4),  # of the footprint [m]
        ("radius", _F4),  # half the footprint's diagonal [m]
        ("wheel_reach", _F4),  # from the base to a wheel [m]
        ("max_steering", _F4),  # [rad]
        ("max_turn", _F4),  # largest change of the steering angle in a physics step [rad]
        ("min_speed", _F4),  # smallest and largest speed command [m/s]
        ("max_speed", _F4),
        ("max_acceleration", _F4),  # [m/s^2]
        ("max_braking", _F4),  # [m/s^2]
        ("gain", _F4),  # acceleration asked per unit of speed error [1/s]
        ("inertia_of_mass", _F4),  # yaw inertia over mass [m^2]
        ("transfer_of_mass", _F4),  # load moved to the rear axle per acceleration, over mass
        ("slope_of_grip", _F4),  # a third of the cornering stiffness [1/rad]
        ("cap_of_mass", _F4),  # largest force per speed it opposes, over mass [1/s]
        ("grip", _F4),  # of a car without variation
        ("mass", _F4),  # of a car without variation [kg]
        ("latency_s", _F4),  # of a car without variation [s]
        # Variation of the cars; see config.Spread.
        ("grip_spread", _F4),
        ("mass_spread", _F4),
        ("latency_spread_s", _F4),
        ("steering_spread", _F4),
        ("camera_up_spread", _F4),
        ("camera_pitch_spread", _F4),
        # Contacts.
        ("friction", _F4),
        ("restitution", _F4),
        # The rules.
        ("laps", _I8),
        ("patience_steps", _I8),
        ("still_squared", _F4),  # square of the movement that counts as standing still [m^2]
        ("off_track_penalty_s", _F4),
        ("crash_penalty_s", _F4),
        ("immobilised_penalty_s", _F4),
        ("reversed_penalty_s", _F4),
        ("overtake_margin", _F4),  # [m]
        ("grid_gap", _F4),  # [m]
        ("put_back_behind", _F4),  # [m]
        ("bot_stop_s", _F4),
        # Obstacles.
        ("bots", _BOOL),  # bot cars instead of boxes
        ("random_places", _BOOL),
        ("fixed_places", _BOOL),  # places are given
        ("lane_change", _BOOL),
        ("bot_speed", _F4),  # [m/s]
        ("min_distance", _F4),  # [m]
        ("thing_half_length", _F4),  # of a box or bot [m]
        ("thing_half_width", _F4),
    ],
    align=True,
)
"""One record; its fields are those of SimConfig, prepared for the loops."""


def settings(sim: SimConfig) -> np.ndarray:
    """Return the record of these settings, shape (1,)."""
    car, rules, spread, things = sim.car, sim.rules, sim.spread, sim.obstacles
    arm, bots = car.wheelbase / 2, things.kind == "bot"
    # Inertia grows with mass, so min(mass, inertia / arm^2) is a fixed share of the mass.
    share = 0.5 * min(1.0, car.yaw_inertia / car.mass / arm**2)

    def seconds(penalty_s: float) -> float:
        # At least one step: the car is put back by the end of its penalty.
        return max(penalty_s, sim.step_dt)

    values = {
        "decimation": sim.decimation,
        "step_hz": sim.step_hz,
        "step_dt": sim.step_dt,
        "physics_dt": sim.physics_dt,
        "arm": arm,
        "half_track": car.wheel_track / 2,
        "half_length": car.length / 2,
        "half_width": car.width / 2,
        "radius": math.sqrt(car.length**2 + car.width**2) / 2,
        "wheel_reach": math.sqrt(car.wheelbase**2 + car.wheel_track**2) / 2,
        "max_steering": car.max_steering,
        "max_turn": car.steering_rate * sim.physics_dt,
        "min_speed": car.min_speed,
        "max_speed": car.max_speed,
        "max_acceleration": car.max_acceleration,
        "max_braking": car.max_braking,
        # A servo that asks for more than the whole error in one step would swing about it.
        "gain": min(car.speed_gain, 1 / sim.physics_dt),
        "inertia_of_mass": car.yaw_inertia / car.mass,
        "transfer_of_mass": car.mass_height / car.wheelbase,
        "slope_of_grip": car.cornering_stiffness / 3,
        "cap_of_mass": share / sim.physics_dt,
        "grip": car.grip,
        "mass": car.mass,
        "latency_s": car.latency_s,
        "grip_spread": spread.grip,
        "mass_spread": spread.mass,
        "latency_spread_s": spread.latency_s,
        "steering_spread": spread.steering_offset,
        "camera_up_spread": spread.camera_position,
        "camera_pitch_spread": spread.camera_angle,
        "friction": sim.contact.friction,
        "restitution": sim.contact.restitution,
        "laps": rules.laps,
        "patience_steps": rules.patience_steps,
        "still_squared": rules.still_distance**2,
        "off_track_penalty_s": seconds(rules.off_track_penalty_s),
        "crash_penalty_s": seconds(rules.crash_penalty_s),
        "immobilised_penalty_s": seconds(rules.immobilised_penalty_s),
        "reversed_penalty_s": seconds(rules.reversed_penalty_s),
        "overtake_margin": rules.overtake_margin,
        "grid_gap": rules.grid_gap,
        "put_back_behind": rules.put_back_behind,
        "bot_stop_s": rules.bot_stop_s,
        "bots": bots,
        "random_places": things.random_places,
        "fixed_places": bool(things.places),
        "lane_change": things.lane_change,
        "bot_speed": things.speed,
        "min_distance": things.min_distance,
        "thing_half_length": (car.length if bots else things.length) / 2,
        "thing_half_width": (car.width if bots else things.width) / 2,
    }
    record = np.zeros(1, SETTINGS)
    for name, value in values.items():
        record[name] = value
    return record
