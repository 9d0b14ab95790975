"""Compiled: the numbers that a reward function is told, worked out for one paid car after another.

A DeepRacer reward function is plain Python and called a few dozen times a step, or just once, where
a batched library spends all its time on getting started. docs/rewards.md tells what each key means.
"""

# Numba gives its types a meaning that the checker does not know.
# pyright: reportArgumentType=false, reportCallIssue=false, reportReturnType=false

import math

import numpy as np

from league.jit import compiled, inner
from league.sim.physics.vehicle import frozen

(WORLD, CAR, STEERING, SPEED, X, Y, HEADING) = range(7)
(DISTANCE, PROJECTION, WIDTH, LENGTH, PROGRESS, SIM_TIME, STEPS) = range(7, 14)
(IS_LEFT, ALL_ON_ROAD, NONE_ON_ROAD, CRASHED) = range(14, 18)
(TRACK, BEHIND, FOLLOWING, LAST_OBJECT, NEXT_OBJECT, SEES_NEXT) = range(18, 24)
NUM_OWN = 24
"""Columns of what a car is told of itself: whose row it is, numbers, truths, and numbers of its
track, of waypoints and of objects."""

(OBJECT_S, OBJECT_DISTANCE, OBJECT_HEADING, OBJECT_SPEED) = range(4)
(OBJECT_X, OBJECT_Y, OBJECT_IS_LEFT) = range(4, 7)
NUM_OF_OBJECT = 7
"""Rows of what a car is told of each object."""

_X, _Y, _YAW, _VELOCITY_X, _VELOCITY_Y, _S, _LATERAL = range(7)
"""Rows of the tables of cars and of obstacles."""
_DRIVEN, _STEERING, _SPEED, _PENALTY, _FINISH = range(7, 12)
"""Further rows of cars: how far they have driven, and what was asked for; before the step, whether
they were frozen, and when they finished."""
_HALF_LENGTH, _HALF_WIDTH = 7, 8
"""Further rows of obstacles."""

_DEGREES = 180.0 / math.pi
_BELOW_100 = math.nextafter(100.0, 0.0)
_NEAR, _FAR = 0.2, 300.0
"""Depths between which the original's camera looks [m]."""
_HEIGHT = 0.2
"""How tall an object is taken to be [m]: a car is 0.19, a box 0.25."""

# Records, because each array or number that is handed over costs a quarter of a microsecond.
MEASURES = np.dtype(
    [
        ("first", "i8"),  # row of the track's first point
        ("last", "i8"),  # points but one
        ("spacing", "f8"),  # distance between two points [m]
        ("length", "f8"),  # length of the centreline [m]
        ("lap", "f8"),  # what counts as a lap [m]: the length, but of an open track a little less
        ("closed", "?"),  # whether the track is a loop
        ("steps", "i8"),  # stretches between two waypoints
        ("first_place", "i8"),  # where its waypoints' places begin; -1: they are evenly spaced
    ]
)
"""What is known of each track."""
BODY = np.dtype(
    [
        ("nose", "f8"),  # ahead of the base [m]
        ("half_base", "f8"),  # half the wheelbase [m]
        ("half_track", "f8"),  # half the distance of left and right wheels [m]
        ("half_length", "f8"),  # [m]
        ("half_width", "f8"),  # [m]
        ("eye_forward", "f8"),  # the eye ahead of the base [m]
        ("eye_up", "f8"),  # the eye above the road [m]
        ("eye_dip", "f8"),  # cosine of the angle by which it looks down
        ("eye_rise", "f8"),  # sine of it
        ("eye_tan", "f8"),  # tangent of half the angle it is wide
    ]
)
"""A car's measures, and one camera in the middle at 4:3, whatever the car carries."""
MEMORY = np.dtype(
    [
        ("paid", "?"),  # whether the car has a reward function at all
        ("steps", "i8"),  # steps driven
        ("fresh", "?"),  # whether the beginning has not been noted yet
        ("lead", "f8"),  # how far the nose was ahead of the base as it began, along the track [m]
        ("start", "f8"),  # how far the base had driven as it began [m]
    ]
)
"""What is known of a car and of its episode."""


@compiled
def note_starts(rows, measures, bodies, memory, before, worlds):
    """Note where the episodes of fresh cars begin; `tell` says what the arguments are.

    Returns:
        Whether there are cars left to note: those that stand a penalty or have finished.
    """
    body, left = bodies[0], False
    cars = _cars(before, before)
    for world in range(memory.shape[0]):
        for car in range(memory.shape[1]):
            known, its, road = (
                memory[world, car],
                cars[:, world, car],
                measures[worlds[world].track],
            )
            if not (known.paid and known.fresh):
                continue
            if _stopped(its):
                left = True
                continue
            nose = _nose(rows, road, body, its)[2]
            known.lead = _short_way(road, nose - its[_S])
            known.start = its[_DRIVEN]
            known.fresh = False
    return left


@compiled
def tell(rows, measures, bodies, memory, places, before, after, things, worlds, verdicts, step_dt):
    """Return what each paid car is told that stands no penalty and has not finished.

    Args:
        rows: x, y, cos, sin, curvature, left, right of each point of the centrelines, then their
            change to the next one, (num_points, 14); see projection.POINT.
        measures: MEASURES of each track, (num_tracks,).
        bodies: BODY of all cars, (1,).
        memory: MEMORY of each car, (num_worlds, num_cars); steps are counted in it, and a lap ends
            an episode.
        places: how far along the lap waypoints lie [m], for tracks with waypoints of their own.
        before: CAR records before the step, (num_worlds, num_cars).
        after: CAR records after it.
        things: OBSTACLE records, (num_worlds, num_obstacles).
        worlds: WORLD records, (num_worlds,).
        verdicts: VERDICT records, (num_worlds, num_cars).
        step_dt: duration of one [s].

    Returns:
        What each car is told of itself, float64 (num_rows, NUM_OWN), and of obstacles and all other
        cars, in this order, float64 (num_rows, NUM_OF_OBJECT, num_objects).
    """
    cars, obstacles = _cars(after, before), _obstacles(things)
    num_obstacles, body = obstacles.shape[2], bodies[0]
    own = np.empty((memory.size, NUM_OWN))
    others = np.empty((memory.size, NUM_OF_OBJECT, num_obstacles + memory.shape[1] - 1))
    number = 0
    for world in range(memory.shape[0]):
        for car in range(memory.shape[1]):
            known, its, road = (
                memory[world, car],
                cars[:, world, car],
                measures[worlds[world].track],
            )
            if not known.paid or _stopped(its):
                continue
            row, seen = own[number], verdicts[world, car]
            row[WORLD], row[CAR], row[TRACK] = world, car, worlds[world].track
            row[CRASHED], row[SIM_TIME] = seen.crashed, worlds[world].step * step_dt
            _tell_of_itself(rows, road, body, places, its, row)
            _tell_of_episode(road, known, its, before[world, car].laps, seen.lap, row)
            _tell_of_objects(road, body, cars, obstacles, world, car, row, others[number])
            number += 1
    return own[:number], others[:number]


@inner
def _cars(cars, before):
    """Return the table of all cars, float64 (12, num_worlds, num_cars)."""
    table = np.empty((12, cars.shape[0], cars.shape[1]))
    for world in range(cars.shape[0]):
        for k in range(cars.shape[1]):
            car, its, was = cars[world, k], table[:, world, k], before[world, k]
            its[_X], its[_Y], its[_YAW] = car.x, car.y, car.yaw
            its[_VELOCITY_X], its[_VELOCITY_Y] = car.velocity_x, car.velocity_y
            its[_S], its[_LATERAL], its[_DRIVEN] = car.s, car.lateral, car.distance
            its[_STEERING], its[_SPEED] = car.target_steering, car.target_speed
            its[_PENALTY], its[_FINISH] = frozen(was), was.finish_s
    return table


@inner
def _obstacles(things):
    """Return the table of all obstacles, float64 (9, num_worlds, num_obstacles)."""
    table = np.empty((9, things.shape[0], things.shape[1]))
    for world in range(things.shape[0]):
        for k in range(things.shape[1]):
            thing, its = things[world, k], table[:, world, k]
            its[_X], its[_Y], its[_YAW] = thing.x, thing.y, thing.yaw
            its[_VELOCITY_X], its[_VELOCITY_Y] = thing.velocity_x, thing.velocity_y
            its[_S], its[_LATERAL] = thing.s, thing.lateral
            its[_HALF_LENGTH], its[_HALF_WIDTH] = thing.half_length, thing.half_width
    return table


@inner
def _stopped(its):
    """Return whether a car stands a penalty or has finished."""
    return its[_PENALTY] > 0.0 or its[_FINISH] < math.inf


@inner
def _tell_of_itself(rows, road, body, places, its, row):
    x, y, s, lateral, left, right = _nose(rows, road, body, its)
    row[X], row[Y], row[HEADING] = x, y, _heading(its[_YAW])
    row[STEERING], row[SPEED] = _rounded(its[_STEERING] * _DEGREES), _rounded(its[_SPEED])
    row[DISTANCE], row[PROJECTION] = abs(lateral), s
    row[WIDTH], row[LENGTH] = left + right, road.length
    row[IS_LEFT] = left - lateral < right + lateral
    row[ALL_ON_ROAD], row[NONE_ON_ROAD] = _on_road(rows, road, body, its)
    row[BEHIND], row[FOLLOWING] = closest_waypoints(places, road, s)


@inner
def _tell_of_episode(road, known, its, laps, lap, row):
    known.steps += 1
    row[STEPS] = known.steps
    # Held just below 100 until the referee has counted the lap, so that 100 is told once.
    if lap:
        row[PROGRESS] = 100.0
        known.steps = 0
        known.start = (laps + 1) * road.lap
    else:
        lead = _short_way(road, row[PROJECTION] - its[_S]) - known.lead
        driven = its[_DRIVEN] - known.start + lead
        row[PROGRESS] = min(100.0 * driven / road.lap, _BELOW_100)


@inner
def _tell_of_objects(road, body, cars, obstacles, world, car, row, told):
    """Tell of each object, of the last and the next one, and whether that is in the picture."""
    num_obstacles, count, nose = obstacles.shape[2], told.shape[1], row[PROJECTION]
    length, closed = road.length, road.closed
    row[LAST_OBJECT] = row[NEXT_OBJECT] = row[SEES_NEXT] = 0
    smallest_behind = smallest_ahead = math.inf
    for which in range(count):
        it = _object(cars, obstacles, world, car, which)
        s = it[_S] % length if closed else it[_S]
        told[OBJECT_S, which], told[OBJECT_DISTANCE, which] = s, abs(it[_LATERAL])
        told[OBJECT_HEADING, which] = _heading(it[_YAW])
        told[OBJECT_SPEED, which] = math.sqrt(it[_VELOCITY_X] ** 2 + it[_VELOCITY_Y] ** 2)
        told[OBJECT_X, which], told[OBJECT_Y, which] = it[_X], it[_Y]
        told[OBJECT_IS_LEFT, which] = it[_LATERAL] > 0.0
        # On a loop everything is somewhere ahead; on a straight what is behind comes last.
        ahead = _ahead(road, s - nose)
        behind = 0.0 if ahead == length else _ahead(road, nose - s)
        if 0.0 <= behind < smallest_behind:
            smallest_behind, row[LAST_OBJECT] = behind, which
        if 0.0 < ahead < smallest_ahead:
            smallest_ahead, row[NEXT_OBJECT] = ahead, which
    if count:
        which = int(row[NEXT_OBJECT])
        boxed, it = which < num_obstacles, _object(cars, obstacles, world, car, which)
        half_length = obstacles[_HALF_LENGTH, world, which] if boxed else body.half_length
        half_width = obstacles[_HALF_WIDTH, world, which] if boxed else body.half_width
        row[SEES_NEXT] = _seen(body, cars[:, world, car], it, half_length, half_width)


@compiled
def closest_waypoints(places, road, s):
    """Return the waypoint at or behind a place, and the next one; after the last comes 0.

    Args:
        places: see `tell`.
        road: MEASURES of one track.
        s: distance along the centreline, in [0, length] [m].
    """
    # The tiny share keeps a place right at a waypoint from falling behind it by rounding.
    if road.first_place < 0:
        behind = math.floor(s / road.length * road.steps + 1e-6)
    else:
        behind = _last_reached(places, road, s + 1e-6 * road.length / road.steps)
    behind = min(max(behind, 0), road.steps)
    return behind, 0 if behind >= road.steps else behind + 1


@inner
def _last_reached(places, road, s):
    """Return the last waypoint at or before a place, -1 before the first: by bisection."""
    low, high = road.first_place, road.first_place + road.steps + 1
    if road.closed:
        # Right at the seam the first waypoint counts, so that no pair is twice the same point.
        lap = places[high - 1] - places[low]
        if s < places[low]:
            s += lap
        elif s >= places[high - 1]:
            s -= lap
    while low < high:
        middle = (low + high) // 2
        if places[middle] <= s:
            low = middle + 1
        else:
            high = middle
    return low - 1 - road.first_place


@compiled
def project(rows, road, x, y, near):
    """Find a point on the centreline by Newton's method; TrackSet.project for one point.

    Args:
        rows: see `tell`.
        road: MEASURES of one track.
        x: [m].
        y: [m].
        near: last known distance along the centreline [m].

    Returns:
        Distance along the centreline and to the left of it, and from it to the left and to the
        right border there [m].
    """
    s = near
    for _ in range(3):
        s, row, share = _row(rows, road, s)
        cos, sin = row[2] + row[9] * share, row[3] + row[10] * share
        dx, dy = x - (row[0] + row[7] * share), y - (row[1] + row[8] * share)
        across = dy * cos - dx * sin
        bend = row[4] + row[11] * share
        step = (dx * cos + dy * sin) / max(1.0 - bend * across, 0.3)
        s += min(max(step, -0.5), 0.5)
    s, row, share = _row(rows, road, s)
    cos, sin = row[2] + row[9] * share, row[3] + row[10] * share
    dx, dy = x - (row[0] + row[7] * share), y - (row[1] + row[8] * share)
    lateral = (dy * cos - dx * sin) / math.sqrt(cos * cos + sin * sin)
    return s, lateral, row[5] + row[12] * share, row[6] + row[13] * share


@inner
def _row(rows, road, s):
    """Return s wrapped, the row of the table before it, and the share of the way to the next."""
    s = s % road.length if road.closed else min(max(s, 0.0), road.length)
    place = s / road.spacing
    low = min(int(place), road.last)
    return s, rows[road.first + low], min(max(place - low, 0.0), 1.0)


@inner
def _nose(rows, road, body, its):
    """Return where a car's nose is, x and y [m], and what `project` says of it."""
    x = its[_X] + body.nose * math.cos(its[_YAW])
    y = its[_Y] + body.nose * math.sin(its[_YAW])
    s, lateral, left, right = project(rows, road, x, y, its[_S])
    return x, y, s, lateral, left, right


@inner
def _on_road(rows, road, body, its):
    """Return whether all four wheels are on the road, and whether none is."""
    cos, sin = math.cos(its[_YAW]), math.sin(its[_YAW])
    wheels = 0
    for along in (body.half_base, -body.half_base):
        for across in (body.half_track, -body.half_track):
            x = its[_X] + along * cos - across * sin
            y = its[_Y] + along * sin + across * cos
            _, lateral, left, right = project(rows, road, x, y, its[_S])
            wheels += -right <= lateral <= left
    return wheels == 4, wheels == 0


@inner
def _short_way(road, gap):
    """Return a difference of two places the shorter way round [m]."""
    return gap - np.rint(gap / road.length) * road.length if road.closed else gap


@inner
def _ahead(road, gap):
    """Return a difference of two places as a way ahead [m]: on a loop in (0, length]."""
    if not road.closed:
        return gap
    around = gap % road.length
    return road.length if around <= 0.0 else around


@inner
def _object(cars, obstacles, world, car, which):
    """Return an object of a car: first come obstacles, then all cars but itself."""
    rival = which - obstacles.shape[2]
    if rival < 0:
        return obstacles[:7, world, which]
    return cars[:7, world, rival + (rival >= car)]


@inner
def _heading(yaw):
    """Return an angle in degrees, in (-180, 180]."""
    heading = yaw * _DEGREES
    return 180.0 if heading <= -180.0 else heading


@inner
def _rounded(number):
    """Round to where single precision ends, so that a choice of 15 degrees is told as 15.0."""
    return np.rint(number * 1e4) / 1e4


@inner
def _seen(body, its, box, half_length, half_width):
    """Return whether the centre or a corner of an object is inside a car's view.

    What hides behind another object is seen all the same, as in the original.
    """
    cos, sin = math.cos(its[_YAW]), math.sin(its[_YAW])
    box_cos, box_sin = math.cos(box[_YAW]), math.sin(box[_YAW])
    for along, across in ((0.0, 0.0), (1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)):
        along, across = along * half_length, across * half_width
        dx = box[_X] + along * box_cos - across * box_sin - its[_X]
        dy = box[_Y] + along * box_sin + across * box_cos - its[_Y]
        forward = dx * cos + dy * sin - body.eye_forward
        left = dy * cos - dx * sin
        for height in (0.0, _HEIGHT / 2, _HEIGHT):
            up = height - body.eye_up
            depth = forward * body.eye_dip - up * body.eye_rise
            above = forward * body.eye_rise + up * body.eye_dip
            half = depth * body.eye_tan
            if _NEAR < depth < _FAR and abs(left) <= half and abs(above) <= 0.75 * half:
                return True
    return False
