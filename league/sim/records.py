"""The state of a batch of races as records: one per car, obstacle and world.

The environment owns these arrays, and the compiled stages write into them in a fixed order. Arrays
of cars have shape (num_worlds, num_cars), of obstacles (num_worlds, num_obstacles), of worlds
(num_worlds,). World frame: x, y [m], yaw [rad] counter-clockwise from +x. Body frame: x ahead, y
left. A set of cars or obstacles is a bit mask: bit k stands for car k or obstacle k.

Compiled functions of one world take its `cars`, CAR (num_cars,), its `obstacles`, OBSTACLE
(num_obstacles,), and its `world`, a WORLD; `points` are those of the TrackSet, `course` is the
COURSE record of the world's track, `settings` a SETTINGS record.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_F4, _I4, _I8, _U1, _U4, _BOOL = np.float32, np.int32, np.int64, np.uint8, np.uint32, np.bool_

CAR = np.dtype(
    [
        # Motion. Position is that of the base, midway between the axles on the ground.
        ("x", _F4),  # [m]
        ("y", _F4),  # [m]
        ("yaw", _F4),  # heading, in [-pi, pi) [rad]
        ("velocity_x", _F4),  # world frame [m/s]
        ("velocity_y", _F4),  # world frame [m/s]
        ("yaw_rate", _F4),  # about the car's own z [rad/s]
        ("steering", _F4),  # angle of the front wheels, positive to the left [rad]
        # Motion out of the plane; in the planar solver only roll and pitch, for the cameras.
        ("z", _F4),  # height of the base above where it stands at rest [m]
        ("roll", _F4),  # about the car's own x, positive when it leans to the right [rad]
        ("pitch", _F4),  # about the car's own y, positive when the nose is down [rad]
        ("velocity_z", _F4),  # [m/s]
        ("roll_rate", _F4),  # body frame [rad/s]
        ("pitch_rate", _F4),  # body frame [rad/s]
        # Control of the last step, for latency; and the action it came from.
        ("target_steering", _F4),  # [rad]
        ("target_speed", _F4),  # [m/s]
        ("action_steering", _F4),  # in [-1, 1]
        ("action_speed", _F4),  # in [-1, 1]
        # Parameters, drawn at the start of a race or an episode.
        ("grip", _F4),  # friction coefficient of the tyres
        ("mass", _F4),  # [kg]; the moments of inertia grow with it
        ("latency_s", _F4),  # time from an action to the servos [s]
        ("steering_offset", _F4),  # added to each steering target [rad]
        ("top_speed", _F4),  # largest speed command that it obeys [m/s]
        ("camera_up", _F4),  # added to the camera's height [m]
        ("camera_pitch", _F4),  # added to the camera's downward tilt [rad]
        # The referee's book.
        ("s", _F4),  # place of the base along the track [m]
        ("lateral", _F4),  # place of the base to the left of the centreline [m]
        ("zero_s", _F4),  # where this car's laps begin and end [m]
        ("distance", _F4),  # driven along the track since zero_s, signed; negative on the grid [m]
        ("best_distance", _F4),  # farthest distance so far [m]; laps are counted by it
        ("lap_start_s", _F4),  # when the running lap began [s]
        ("last_lap_s", _F4),  # time of the last complete lap [s]; 0 before the first
        ("best_lap_s", _F4),  # time of the best complete lap [s]; infinite before the first
        ("finish_s", _F4),  # when the last lap was complete [s]; infinite before
        ("penalty_s", _F4),  # penalty still to stand [s]; above 0 the car is frozen
        ("laps", _I4),  # complete laps
        ("still_steps", _I4),  # steps in a row without movement
        ("backward_steps", _I4),  # steps in a row with falling distance
        ("off_tracks", _I4),  # how often all four wheels left the road
        ("crashes", _I4),  # how often the car was penalised for a contact
        ("touches", _I4),  # how often it was to blame for a contact too light for a penalty
        ("contacts_taken", _I4),  # how often another car was to blame for a contact with this one
        ("immobilised", _I4),  # how often the car stood still too long
        ("reversed", _I4),  # how often the car drove backwards too long
        ("overtakes", _I4),  # cars passed on the road
        ("episode_steps", _I4),  # steps since the car's episode began
        ("pushed_by", _I4),  # the car to blame for the last contact this one was not to blame for
        ("pushed_steps", _I4),  # steps for which leaving the road is still that car's fault
        ("pushed_speed", _F4),  # closing speed of that contact [m/s]
        ("pace", _F4),  # largest share so far of the speed that the road allowed, 0 to 1
        ("touching_obstacles", _U4),  # obstacles touched in the last step
        ("touching_cars", _U1),  # cars touched in the last step
        # Cars that this one leads, in a pursuit those just behind it on the road; a pair changes
        # only when a pass is clear.
        ("ahead", _U1),
        ("ghost", _BOOL),  # whether the car cannot collide now
        ("put_back", _BOOL),  # whether it is put back on the road when its penalty ends
        ("retired", _BOOL),  # out of the race for good: frozen, a ghost, never released
    ],
    align=True,
)
"""One car: motion, control, parameters and the referee's book."""

OBSTACLE = np.dtype(
    [
        ("x", _F4),  # centre [m]
        ("y", _F4),  # centre [m]
        ("yaw", _F4),  # [rad]
        ("velocity_x", _F4),  # [m/s]
        ("velocity_y", _F4),  # [m/s]
        ("s", _F4),  # place along the track [m]; of a bot car its odometer, beyond the lap too
        ("lateral", _F4),  # place to the left of the centreline [m]
        ("half_length", _F4),  # [m]
        ("half_width", _F4),  # [m]
        ("stopped_s", _F4),  # how long a bot car still stands after a contact [s]
    ],
    align=True,
)
"""One box or bot car; nothing can push it."""

WORLD = np.dtype(
    [
        ("seed", _I8),  # of the race, below 2^62
        ("step", _I8),  # control steps since the start of the race
        ("track", _I8),  # row of the TrackSet
        ("last_step", _I8),  # step at which the race is stopped
        ("leader", _I8),  # index of the leading car
        ("lead_changes", _I8),  # how often another car took the lead
    ],
    align=True,
)
"""One race."""

CONTACT = np.dtype([("obstacles", _U4), ("cars", _U1), ("wall", _BOOL)], align=True)
"""What one car touched during a control step: obstacles, other cars, the wall."""

VERDICT = np.dtype(
    [
        ("advance", _F4),  # signed movement along the track in this step [m]
        ("closing_speed", _F4),  # hardest contact with a car that this one is to blame for [m/s]
        ("penalty_s", _F4),  # what a race takes for this step's mistakes; in training for contacts
        ("crashed_car", _I4),  # the car it ran into, or NOBODY
        ("crashed_obstacle", _I4),  # the obstacle it ran into, or NOBODY
        ("overtook", _U1),  # cars passed on the road in this step
        ("off_track", _BOOL),  # all four wheels have left the road
        ("crashed", _BOOL),  # a contact this car is penalised for
        ("to_blame", _BOOL),  # touches another car, and is to blame for it
        ("touched", _BOOL),  # a contact this car is to blame for began, too light for a penalty
        ("was_hit", _BOOL),  # a contact another car is to blame for
        ("forced_off", _BOOL),  # pushed off the road or into an obstacle by CAR.pushed_by
        ("pushed_off", _BOOL),  # to blame for that of another car
        ("wall", _BOOL),  # the car touches the wall
        ("immobilised", _BOOL),  # stood still too long
        ("reversed", _BOOL),  # drove backwards too long
        ("lap", _BOOL),  # completed a lap in this step
        ("finished", _BOOL),  # completed its last lap in this step
        ("released", _BOOL),  # a penalty ended in this step
        ("mistake", _BOOL),  # off_track, crashed, pushed_off, immobilised or reversed
        ("lead_changed", _BOOL),  # another car leads; the same for all cars of a world
    ],
    align=True,
)
"""What the referee found about one car in one control step."""

NOBODY = -1  # no car and no obstacle


@dataclass(frozen=True, eq=False)
class World:
    """A batch of races at one moment.

    An environment's own World is live: its arrays change with each step; take a copy to keep it.
    """

    worlds: np.ndarray  # WORLD records, (num_worlds,)
    cars: np.ndarray  # CAR records, (num_worlds, num_cars)
    obstacles: np.ndarray  # OBSTACLE records, (num_worlds, num_obstacles)

    @property
    def num_worlds(self) -> int:
        """Races in the batch."""
        return self.cars.shape[0]

    @property
    def num_cars(self) -> int:
        """Cars in each race."""
        return self.cars.shape[1]

    @property
    def num_obstacles(self) -> int:
        """Obstacles in each race."""
        return self.obstacles.shape[1]

    @property
    def track(self) -> np.ndarray:
        """Row of the TrackSet that each race is on, int64 (num_worlds,)."""
        return self.worlds["track"]

    def rows(self, chosen: slice | np.ndarray) -> World:
        """Return some of the races: of a slice they are live, of an index array a copy."""
        return World(self.worlds[chosen], self.cars[chosen], self.obstacles[chosen])

    def row(self, index: int) -> World:
        """Return one race, live, as a batch of one."""
        return self.rows(slice(index, index + 1))

    def copy(self) -> World:
        """Return a copy, which later steps do not change."""
        return World(self.worlds.copy(), self.cars.copy(), self.obstacles.copy())


def members(mask: np.ndarray, count: int) -> np.ndarray:
    """Return which cars or obstacles bit masks name, bool (*mask.shape, count)."""
    return (mask[..., None] >> np.arange(count, dtype=mask.dtype)) & 1 == 1


def is_frozen(cars: np.ndarray) -> np.ndarray:
    """Return whether cars are held in place: by a penalty, or because they are out of the race."""
    return (cars["penalty_s"] > 0) | cars["retired"]
