"""World: all that changes in a batch of races, as frozen tensors; and what drivers ask, Control.

Every field leads with num_worlds; fields of cars have shape (num_worlds, num_cars). World frame:
x, y [m], yaw [rad] counter-clockwise from +x. Body frame: x ahead, y left.
"""

from dataclasses import dataclass, fields, replace
from typing import TypeVar

import torch
from torch import Tensor


@dataclass(frozen=True)
class Motion:
    """What a solver may change: where the cars are and how they move, (num_worlds, num_cars)."""

    x: Tensor
    """Position of the base, midway between the axles, world frame [m]."""
    y: Tensor
    """Position of the base, world frame [m]."""
    yaw: Tensor
    """Heading, wrapped to [-pi, pi) [rad]."""
    velocity_x: Tensor
    """Velocity, world frame [m/s]."""
    velocity_y: Tensor
    """Velocity, world frame [m/s]."""
    yaw_rate: Tensor
    """[rad/s]."""
    steering: Tensor
    """Angle of the front wheels, positive to the left [rad]."""


@dataclass(frozen=True)
class Control:
    """What the drivers ask for in one control step, (num_worlds, num_cars)."""

    steering: Tensor
    """Target angle of the front wheels [rad]."""
    speed: Tensor
    """Target speed [m/s]."""


@dataclass(frozen=True)
class CarParameters:
    """What differs from car to car, drawn at the start of a race or an episode."""

    grip: Tensor
    """Friction coefficient of the tyres."""
    mass: Tensor
    """[kg]; the yaw inertia grows with it."""
    latency_s: Tensor
    """Time from an action to the servos [s]."""
    steering_offset: Tensor
    """Added to each steering target [rad]."""
    camera_up: Tensor
    """Added to the camera's height [m]."""
    camera_pitch: Tensor
    """Added to the camera's downward tilt [rad]."""


@dataclass(frozen=True)
class Obstacles:
    """Boxes and bot cars, (num_worlds, num_obstacles); nothing can push them."""

    x: Tensor
    """Centre, world frame [m]."""
    y: Tensor
    """Centre, world frame [m]."""
    yaw: Tensor
    """[rad]."""
    velocity_x: Tensor
    """[m/s]."""
    velocity_y: Tensor
    """[m/s]."""
    s: Tensor
    """Place along the track [m]; of a bot car its odometer, which grows beyond the lap."""
    lateral: Tensor
    """Place to the left of the centreline [m]."""
    half_length: Tensor
    """[m]."""
    half_width: Tensor
    """[m]."""
    stopped_s: Tensor
    """How long a bot car still stands after a contact [s]."""


@dataclass(frozen=True)
class Standing:
    """The referee's book, (num_worlds, num_cars) unless said otherwise."""

    s: Tensor
    """Place of the base along the track [m]."""
    lateral: Tensor
    """Place of the base to the left of the centreline [m]."""
    zero_s: Tensor
    """Where this car's laps begin and end [m]: the start line, or where its episode began."""
    distance: Tensor
    """Driven along the track since `zero_s`, signed; negative on the grid [m]."""
    best_distance: Tensor
    """Farthest `distance` so far [m]; laps are counted by it, so never twice."""
    laps: Tensor
    """Complete laps, int64."""
    lap_start_s: Tensor
    """When the running lap began [s]."""
    last_lap_s: Tensor
    """Time of the last complete lap [s]; 0 before the first."""
    best_lap_s: Tensor
    """Time of the best complete lap [s]; infinite before the first."""
    finish_s: Tensor
    """When the last lap was complete [s]; infinite before."""
    penalty_s: Tensor
    """Seconds of penalty still to stand [s]; a car with a penalty is frozen."""
    ghost: Tensor
    """Whether the car cannot collide now, bool."""
    put_back: Tensor
    """Whether the car is to be put back on the road when its penalty ends, bool."""
    still_steps: Tensor
    """Steps in a row without movement, int64."""
    backward_steps: Tensor
    """Steps in a row with falling distance, int64."""
    touching_cars: Tensor
    """Which cars touched in the last step, bool, (num_worlds, num_cars, num_cars), symmetric."""
    touching_obstacles: Tensor
    """Which obstacles were touched in the last step, bool, (num_worlds, cars, num_obstacles)."""
    off_tracks: Tensor
    """How often all four wheels left the road, int64."""
    crashes: Tensor
    """How often the car was to blame for a contact, int64."""
    contacts_taken: Tensor
    """How often another car was to blame for a contact with this one, int64."""
    immobilised: Tensor
    """How often the car stood still too long, int64."""
    reversed: Tensor
    """How often the car drove backwards too long, int64."""
    overtakes: Tensor
    """Cars passed on the road, int64."""
    lead_changes: Tensor
    """How often another car took the lead, int64, (num_worlds,)."""
    ahead: Tensor
    """Who is ahead of whom, bool, (num_worlds, num_cars, num_cars): [w, i, j], i leads j. A pair
    changes only when the pass is clear, so that two cars side by side do not flicker."""
    leader: Tensor
    """Index of the leading car, int64, (num_worlds,)."""


@dataclass(frozen=True)
class Contacts:
    """What touched what during one control step."""

    cars: Tensor
    """Bool, (num_worlds, num_cars, num_cars), symmetric, False on the diagonal."""
    obstacles: Tensor
    """Bool, (num_worlds, num_cars, num_obstacles)."""
    walls: Tensor
    """Bool, (num_worlds, num_cars)."""


@dataclass(frozen=True)
class World:
    """A batch of races at one moment."""

    seed: Tensor
    """Seed of each race, int64, (num_worlds,)."""
    step: Tensor
    """Control steps since the start of the race, int64, (num_worlds,)."""
    track: Tensor
    """Row of the TrackSet each race is on, int64, (num_worlds,)."""
    motion: Motion
    """The cars' movement."""
    control: Control
    """The control of the last step, for latency."""
    cars: CarParameters
    """The cars' parameters."""
    obstacles: Obstacles
    """Boxes and bot cars."""
    standing: Standing
    """The referee's book."""

    @property
    def num_worlds(self) -> int:
        """Races in the batch."""
        return self.motion.x.shape[0]

    @property
    def num_cars(self) -> int:
        """Cars in each race."""
        return self.motion.x.shape[1]


Record = TypeVar("Record", World, Motion, Control, CarParameters, Obstacles, Standing, Contacts)


def select(mask: Tensor, new: Record, old: Record) -> Record:
    """Return `new` where the mask is True and `old` elsewhere, field by field.

    Args:
        mask: bool, (num_worlds,) or (num_worlds, num_cars); it is given trailing axes as needed,
            and fields with fewer axes than the mask keep their old value.
        new: a record of tensors.
        old: a record of the same shapes.
    """
    chosen = {}
    for item in fields(old):
        after, before = getattr(new, item.name), getattr(old, item.name)
        if not isinstance(before, Tensor):
            chosen[item.name] = select(mask, after, before)
        elif before.dim() >= mask.dim():
            wide = mask.reshape(mask.shape + (1,) * (before.dim() - mask.dim()))
            chosen[item.name] = torch.where(wide, after, before)
    return replace(old, **chosen)


def row(record: Record, index: int | slice | Tensor) -> Record:
    """Return some worlds of a record (an int keeps the batch axis)."""
    part = slice(index, index + 1) if isinstance(index, int) else index
    taken = {
        item.name: value[part] if isinstance(value, Tensor) else row(value, part)
        for item in fields(record)
        for value in [getattr(record, item.name)]
    }
    return replace(record, **taken)


def put(part: Record, rows: Tensor, record: Record) -> Record:
    """Return the record with some of its worlds replaced.

    Args:
        part: the new worlds, in the order of `rows`.
        rows: which worlds they are, int64, (num_rows,).
        record: the record they belong to.
    """
    changed = {
        item.name: old.index_copy(0, rows, new) if isinstance(old, Tensor) else put(new, rows, old)
        for item in fields(record)
        for old, new in [(getattr(record, item.name), getattr(part, item.name))]
    }
    return replace(record, **changed)
