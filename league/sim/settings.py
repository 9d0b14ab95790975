"""Settings of the world as one record of numbers, which is how compiled code reads them."""

import math

import numpy as np

from league.sim.config import GRAVITY, CarConfig, SimConfig

HALF_WALL = 5.0  # half the thickness of a wall [m]
RESTITUTION_FROM = 0.05  # slowest approach that bounces [m/s]

_F4, _I8, _BOOL = np.float32, np.int64, np.bool_
_KINDS: dict[type, type] = {float: _F4, int: _I8, bool: _BOOL}


def settings(sim: SimConfig) -> np.ndarray:
    """Return these settings as a SETTINGS record, shape (1,)."""
    return np.array([tuple(value for _, _, value in _fields(sim))], SETTINGS)


def lean_per_acceleration(car: CarConfig, half_span: float) -> float:
    """Return how far a car leans at rest on its springs, per acceleration [rad per m/s^2].

    Tyres push at the road, h = mass_height below the centre of mass: an acceleration a turns the
    chassis by m a h. Four springs of m (2 pi ride_hz)^2 / 4 each, `half_span` d [m] to either side
    of the middle (half a wheel track for roll, half a wheelbase for pitch), resist a lean by
    m (2 pi ride_hz)^2 d^2 of torque per radian, of which the weight, now off the middle, takes
    m g h back. The mass cancels:

        lean / a = h / ((2 pi ride_hz)^2 d^2 - g h).
    """
    stiffness = (2 * math.pi * car.ride_hz * half_span) ** 2 - GRAVITY * car.mass_height
    return car.mass_height / stiffness


def _leans(sim: SimConfig) -> tuple[float, float, float]:
    """Return roll and pitch per acceleration [rad per m/s^2], and the share of a physics step.

    A step brings the chassis by this share nearer to where it would rest: a lag of
    2 damping_ratio / (2 pi ride_hz), dampers over springs.
    """
    car = sim.car
    lag = car.damping_ratio / (math.pi * car.ride_hz)
    roll, pitch = (lean_per_acceleration(car, d / 2) for d in (car.wheel_track, car.wheelbase))
    return roll, pitch, sim.physics_dt / (lag + sim.physics_dt)


def _fields(sim: SimConfig) -> tuple[tuple[str, type, float], ...]:
    """Return name, type and value of each field of the record."""
    car, rules, spread, things = sim.car, sim.rules, sim.spread, sim.obstacles
    arm, bots = car.wheelbase / 2, things.kind == "bot"
    pursuit = rules.start == "pursuit"
    roll, pitch, lean_share = _leans(sim)
    # Inertia grows with mass, so min(mass, inertia / arm^2) is a fixed share of the mass.
    share = 0.5 * min(1.0, car.yaw_inertia / car.mass / arm**2)

    penalties = ("off_track", "crash", "immobilised", "reversed")
    return (
        *_as_they_are(sim, "decimation", "step_dt", "physics_dt"),
        ("step_hz", _F4, sim.step_hz),  # control steps per second
        # The car.
        *_as_they_are(car, "max_steering", "min_speed", "max_speed"),
        *_as_they_are(car, "max_acceleration", "max_braking"),
        ("arm", _F4, arm),  # from the base to either axle [m]
        ("half_track", _F4, car.wheel_track / 2),  # from the middle of an axle to its wheels [m]
        ("half_length", _F4, car.length / 2),  # of the footprint [m]
        ("half_width", _F4, car.width / 2),  # of the footprint [m]
        ("radius", _F4, math.sqrt(car.length**2 + car.width**2) / 2),  # of the footprint [m]
        # From the base to a wheel [m].
        ("wheel_reach", _F4, math.sqrt(car.wheelbase**2 + car.wheel_track**2) / 2),
        ("max_turn", _F4, car.steering_rate * sim.physics_dt),  # of the steering in a step [rad]
        # Acceleration asked per unit of speed error [1/s]. A servo that asks for more than the
        # whole error in one step would swing about it.
        ("gain", _F4, min(car.speed_gain, 1 / sim.physics_dt)),
        ("inertia_of_mass", _F4, car.yaw_inertia / car.mass),  # yaw inertia over mass [m^2]
        # Load moved to the rear axle per acceleration, over mass.
        ("transfer_of_mass", _F4, car.mass_height / car.wheelbase),
        ("slope_of_grip", _F4, car.cornering_stiffness / 3),  # [1/rad]
        ("cap_of_mass", _F4, share / sim.physics_dt),  # largest force per speed, over mass [1/s]
        # How far it leans for its cameras, and how soon; 0 where they stay level.
        ("roll_of_left", _F4, roll),  # [rad per m/s^2]
        ("pitch_of_brakes", _F4, pitch),  # [rad per m/s^2]
        ("lean_share", _F4, lean_share),
        # The car without variation, and how far cars vary.
        *_as_they_are(car, "grip", "mass", "latency_s"),
        ("grip_spread", _F4, spread.grip),
        ("mass_spread", _F4, spread.mass),
        ("latency_spread_s", _F4, spread.latency_s),
        ("steering_spread", _F4, spread.steering_offset),
        ("start_speed", _F4, spread.start_speed),
        ("camera_up_spread", _F4, spread.camera_position),
        ("camera_pitch_spread", _F4, spread.camera_angle),
        *_as_they_are(sim.contact, "friction", "restitution"),
        # The rules.
        *_as_they_are(rules, "laps", "patience_steps", "room", "light_contact", "full_contact"),
        *_as_they_are(rules, "overtake_margin", "grid_gap", "put_back_behind", "bot_stop_s"),
        ("alongside", _F4, car.length / 4),  # overlap along the track from which cars are alongside
        # Steps for which a contact may have pushed a car off the road.
        ("push_steps", _I8, round(rules.forced_off_s * sim.step_hz) if rules.room else 0),
        ("still_squared", _F4, rules.still_distance**2),  # [m^2]
        # At least one step: the car is put back by the end of its penalty.
        *(
            (f"{name}_penalty_s", _F4, max(getattr(rules, f"{name}_penalty_s"), sim.step_dt))
            for name in penalties
        ),
        ("grid_length", _F4, 0.0 if pursuit else rules.grid_gap * (sim.num_cars - 1)),  # [m]
        ("pursuers", _I8, sim.num_cars if pursuit else 0),  # cars spread evenly round the lap
        # Obstacles.
        *_as_they_are(things, "random_places", "lane_change", "min_distance"),
        ("bots", _BOOL, bots),  # bot cars instead of boxes
        ("fixed_places", _BOOL, bool(things.places)),
        ("bot_speed", _F4, things.speed),  # [m/s]
        ("thing_half_length", _F4, (car.length if bots else things.length) / 2),  # [m]
        ("thing_half_width", _F4, (car.width if bots else things.width) / 2),  # [m]
    )


def _as_they_are(part: object, *names: str) -> list[tuple[str, type, float]]:
    """Return some settings under their own names; sim/config.py has their units."""
    values = [(name, getattr(part, name)) for name in names]
    return [(name, _KINDS.get(type(value), _F4), value) for name, value in values]


SETTINGS = np.dtype([(name, kind) for name, kind, _ in _fields(SimConfig())], align=True)
"""One record; its fields are those of SimConfig, prepared for the loops."""
