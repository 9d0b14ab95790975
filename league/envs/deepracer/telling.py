"""Compiled: the numbers that a reward function is told, worked out for one paid car after another.

A DeepRacer reward function is plain Python and called a few dozen times a step, or just once, where
a batched library spends all its time on getting started. docs/rewards.md tells what each key means.
"""

# Numba gives its types a meaning that the checker does not know.
# pyright: reportArgumentType=false, reportCallIssue=false, reportReturnType=false

import math
from typing import NamedTuple

import numpy as np

from league.compiled import compiled, inner

(STEERING, SPEED, X, Y, HEADING) = range(5)
(DISTANCE, PROJECTION, WIDTH, LENGTH, PROGRESS, SIM_TIME, STEPS) = range(5, 12)
(IS_LEFT, ALL_ON_ROAD, NONE_ON_ROAD, CRASHED, TRACK, BEHIND, FOLLOWING) = range(12, 19)
NUM_OWN = 19
"""Columns of what a car is told of itself; the last seven are truths, and numbers of its track and
of waypoints."""

(OBJECT_S, OBJECT_DISTANCE, OBJECT_HEADING, OBJECT_SPEED) = range(4)
NUM_OF_OBJECT = 4
"""Rows of what a car is told of each object, beside where it is and whether it is on the left."""

_X, _Y, _YAW, _VELOCITY_X, _VELOCITY_Y, _S, _LATERAL = range(7)
"""Rows of the tables of cars and of obstacles."""
_DRIVEN, _STEERING, _SPEED = 7, 8, 9
"""Further rows of cars: how far they have driven, and what was asked for."""
_HALF_LENGTH, _HALF_WIDTH = 7, 8
"""Further rows of obstacles."""

_DEGREES = 180.0 / math.pi
_BELOW_100 = math.nextafter(100.0, 0.0)
_NEAR, _FAR = 0.2, 300.0
"""Depths between which the original's camera looks [m]."""
_HEIGHT = 0.2
"""How tall an object is taken to be [m]: a car is 0.19, a box 0.25."""


class Courses(NamedTuple):
    """Tracks as tables; all but the first have one entry for each track."""

    rows: np.ndarray
    """x, y, cos, sin, curvature, left, right of each point of the centreline, then their change to
    the next one, (num_tracks * num_points, 14); see TrackSet.rows."""
    first: np.ndarray
    """Row of each track's first point, int64."""
    last: np.ndarray
    """Points of each track but one, int64."""
    spacing: np.ndarray
    """Distance between two points [m]."""
    length: np.ndarray
    """Length of the centreline [m]."""
    lap: np.ndarray
    """What counts as a lap [m]: the length, but of an open track a little less."""
    closed: np.ndarray
    """Whether the track is a loop."""
    steps: np.ndarray
    """Stretches between two waypoints, int64."""


class Body(NamedTuple):
    """A car's measures [m]."""

    nose: float
    half_base: float
    half_track: float
    half_length: float
    half_width: float


class Eye(NamedTuple):
    """One camera in the middle at 4:3, whatever the car carries."""

    forward: float
    """Ahead of the base [m]."""
    up: float
    """Above the road [m]."""
    dip: float
    """Cosine of the angle by which it looks down."""
    rise: float
    """Sine of it."""
    tan: float
    """Tangent of half the angle it is wide."""


class Memory(NamedTuple):
    """What is known of each car's episode, (num_worlds, num_cars)."""

    steps: np.ndarray
    """Steps driven, int64."""
    fresh: np.ndarray
    """Whether its beginning has not been noted yet."""
    lead: np.ndarray
    """How far the nose was ahead of the base as it began, along the track [m]."""
    start: np.ndarray
    """How far the base had driven as it began [m]."""


@compiled
def whom_to_tell(paid, penalty_s, finish_s):  # noqa: ANN001, ANN201
    """Return world and car of each paid car that stands no penalty and has not finished.

    Args:
        paid: whether a car is paid, bool (num_worlds, num_cars).
        penalty_s: how long it stands still yet [s].
        finish_s: when it finished [s], infinity before.

    Returns:
        World and car of each, int64 (num_rows, 2).
    """
    asked, number = np.empty((paid.size, 2), np.int64), 0
    for world in range(paid.shape[0]):
        for car in range(paid.shape[1]):
            stopped = penalty_s[world, car] > 0.0 or finish_s[world, car] < math.inf
            if paid[world, car] and not stopped:
                asked[number, 0], asked[number, 1] = world, car
                number += 1
    return asked[:number].copy()


@compiled
def note_starts(course, body, memory, cars, track, asked):  # noqa: ANN001, ANN201
    """Note where the episodes of fresh cars begin.

    Args:
        course: Courses.
        body: Body.
        memory: Memory, which is changed.
        cars: the cars before their first step, float64 (10, num_worlds, num_cars).
        track: track of each world, int64 (num_worlds,).
        asked: world and car of each row, int64 (num_rows, 2).
    """
    for number in range(len(asked)):
        world, car = asked[number, 0], asked[number, 1]
        if memory.fresh[world, car]:
            on, s = track[world], cars[_S, world, car]
            nose = _nose(course, body, on, cars[:, world, car])[2]
            memory.lead[world, car] = _short_way(course, on, nose - s)
            memory.start[world, car] = cars[_DRIVEN, world, car]
            memory.fresh[world, car] = False


@compiled
def tell_of_itself(course, body, memory, cars, track, laps, lap, crashed, clock, asked):  # noqa: ANN001, ANN201
    """Return what each car is told of itself, float64 (num_rows, NUM_OWN), and count its steps.

    Args:
        course: Courses.
        body: Body.
        memory: Memory, which is changed: an episode ends with a lap.
        cars: all cars after the step, float64 (10, num_worlds, num_cars).
        track: track of each world, int64 (num_worlds,).
        laps: laps of each car before the step, int64 (num_worlds, num_cars).
        lap: whether each completes one, bool.
        crashed: whether each has crashed, bool.
        clock: time of each world [s], float64 (num_worlds,).
        asked: world and car of each row, int64 (num_rows, 2).
    """
    told = np.empty((len(asked), NUM_OWN))
    for number in range(len(asked)):
        world, car = asked[number, 0], asked[number, 1]
        row, its, on = told[number], cars[:, world, car], track[world]
        x, y, s, lateral, left, right = _nose(course, body, on, its)
        row[X], row[Y], row[HEADING] = x, y, _heading(its[_YAW])
        row[STEERING], row[SPEED] = _rounded(its[_STEERING] * _DEGREES), _rounded(its[_SPEED])
        row[DISTANCE], row[PROJECTION] = abs(lateral), s
        row[WIDTH], row[LENGTH] = left + right, course.length[on]
        row[IS_LEFT] = left - lateral < right + lateral
        row[ALL_ON_ROAD], row[NONE_ON_ROAD] = _on_road(course, body, on, its)
        row[CRASHED], row[TRACK] = crashed[world, car], on
        row[BEHIND], row[FOLLOWING] = closest_waypoints(course, on, s)
        memory.steps[world, car] += 1
        row[STEPS], row[SIM_TIME] = memory.steps[world, car], clock[world]
        # Held just below 100 until the referee has counted the lap, so that 100 is told once.
        if lap[world, car]:
            row[PROGRESS] = 100.0
            memory.steps[world, car] = 0
            memory.start[world, car] = (laps[world, car] + 1) * course.lap[on]
        else:
            lead = _short_way(course, on, s - its[_S]) - memory.lead[world, car]
            driven = its[_DRIVEN] - memory.start[world, car] + lead
            row[PROGRESS] = min(100.0 * driven / course.lap[on], _BELOW_100)
    return told


@compiled
def tell_of_objects(course, body, eye, cars, obstacles, track, nose, asked):  # noqa: ANN001, ANN201
    """Return what each car is told of obstacles and of all other cars, in this order.

    Args:
        course: Courses.
        body: Body.
        eye: Eye.
        cars: float64 (10, num_worlds, num_cars).
        obstacles: float64 (9, num_worlds, num_obstacles).
        track: track of each world, int64 (num_worlds,).
        nose: where each row's nose is along its track [m], float64 (num_rows,).
        asked: world and car of each row, int64 (num_rows, 2).

    Returns:
        Of each object OBJECT_S and so on, float64 (num_rows, NUM_OF_OBJECT, num_objects); where it
        is [m], float64 (num_rows, num_objects, 2); whether it is on the left of the centreline,
        bool (num_rows, num_objects); the last and the next object, int64 (num_rows, 2); whether the
        next one is in the camera's picture, bool (num_rows,).
    """
    num_rows, num_obstacles = len(asked), obstacles.shape[2]
    count = num_obstacles + cars.shape[2] - 1
    told = np.empty((num_rows, NUM_OF_OBJECT, count))
    place, left = np.empty((num_rows, count, 2)), np.empty((num_rows, count), np.bool_)
    closest, in_picture = np.zeros((num_rows, 2), np.int64), np.zeros(num_rows, np.bool_)
    for number in range(num_rows):
        world, car = asked[number, 0], asked[number, 1]
        on = track[world]
        length, closed = course.length[on], course.closed[on]
        smallest_behind = smallest_ahead = math.inf
        for which in range(count):
            it = _object(cars, obstacles, world, car, which)
            s = it[_S] % length if closed else it[_S]
            told[number, OBJECT_S, which] = s
            told[number, OBJECT_DISTANCE, which] = abs(it[_LATERAL])
            told[number, OBJECT_HEADING, which] = _heading(it[_YAW])
            told[number, OBJECT_SPEED, which] = math.sqrt(
                it[_VELOCITY_X] ** 2 + it[_VELOCITY_Y] ** 2
            )
            place[number, which, 0], place[number, which, 1] = it[_X], it[_Y]
            left[number, which] = it[_LATERAL] > 0.0
            # On a loop everything is somewhere ahead; on a straight what is behind comes last.
            ahead = _ahead(course, on, s - nose[number])
            behind = 0.0 if ahead == length else _ahead(course, on, nose[number] - s)
            if 0.0 <= behind < smallest_behind:
                smallest_behind, closest[number, 0] = behind, which
            if 0.0 < ahead < smallest_ahead:
                smallest_ahead, closest[number, 1] = ahead, which
        which = closest[number, 1]
        boxed, it = which < num_obstacles, _object(cars, obstacles, world, car, which)
        half_length = obstacles[_HALF_LENGTH, world, which] if boxed else body.half_length
        half_width = obstacles[_HALF_WIDTH, world, which] if boxed else body.half_width
        in_picture[number] = _seen(eye, cars[:, world, car], it, half_length, half_width)
    return told, place, left, closest, in_picture


@compiled
def closest_waypoints(course, track, s):  # noqa: ANN001, ANN201
    """Return the waypoint at or behind a place, and the next one; after the last comes 0."""
    steps = course.steps[track]
    # The tiny share keeps a place right at a waypoint from falling behind it by rounding.
    behind = math.floor(s / course.length[track] * steps + 1e-6)
    behind = min(max(behind, 0), steps)
    return behind, 0 if behind >= steps else behind + 1


@compiled
def project(course, track, x, y, near):  # noqa: ANN001, ANN201
    """Find a point on the centreline by Newton's method; TrackSet.project for one point.

    Args:
        course: Courses.
        track: number of the track.
        x: [m].
        y: [m].
        near: last known distance along the centreline [m].

    Returns:
        Distance along the centreline and to the left of it, and from it to the left and to the
        right border there [m].
    """
    s = near
    for _ in range(3):
        s, row, share = _row(course, track, s)
        cos, sin = row[2] + row[9] * share, row[3] + row[10] * share
        dx, dy = x - (row[0] + row[7] * share), y - (row[1] + row[8] * share)
        across = dy * cos - dx * sin
        bend = row[4] + row[11] * share
        step = (dx * cos + dy * sin) / max(1.0 - bend * across, 0.3)
        s += min(max(step, -0.5), 0.5)
    s, row, share = _row(course, track, s)
    cos, sin = row[2] + row[9] * share, row[3] + row[10] * share
    dx, dy = x - (row[0] + row[7] * share), y - (row[1] + row[8] * share)
    lateral = (dy * cos - dx * sin) / math.sqrt(cos * cos + sin * sin)
    return s, lateral, row[5] + row[12] * share, row[6] + row[13] * share


@inner
def _row(course, track, s):  # noqa: ANN001, ANN202
    """Return s wrapped, the row of the table before it, and the share of the way to the next."""
    length = course.length[track]
    s = s % length if course.closed[track] else min(max(s, 0.0), length)
    place = s / course.spacing[track]
    low = min(int(place), course.last[track])
    return s, course.rows[course.first[track] + low], min(max(place - low, 0.0), 1.0)


@inner
def _nose(course, body, track, its):  # noqa: ANN001, ANN202
    """Return where a car's nose is, x and y [m], and what `project` says of it."""
    x = its[_X] + body.nose * math.cos(its[_YAW])
    y = its[_Y] + body.nose * math.sin(its[_YAW])
    s, lateral, left, right = project(course, track, x, y, its[_S])
    return x, y, s, lateral, left, right


@inner
def _on_road(course, body, track, its):  # noqa: ANN001, ANN202
    """Return whether all four wheels are on the road, and whether none is."""
    cos, sin = math.cos(its[_YAW]), math.sin(its[_YAW])
    wheels = 0
    for along in (body.half_base, -body.half_base):
        for across in (body.half_track, -body.half_track):
            x = its[_X] + along * cos - across * sin
            y = its[_Y] + along * sin + across * cos
            _, lateral, left, right = project(course, track, x, y, its[_S])
            wheels += -right <= lateral <= left
    return wheels == 4, wheels == 0


@inner
def _short_way(course, track, gap):  # noqa: ANN001, ANN202
    """Return a difference of two places the shorter way round [m]."""
    length = course.length[track]
    return gap - np.rint(gap / length) * length if course.closed[track] else gap


@inner
def _ahead(course, track, gap):  # noqa: ANN001, ANN202
    """Return a difference of two places as a way ahead [m]: on a loop in (0, length]."""
    if not course.closed[track]:
        return gap
    length = course.length[track]
    around = gap % length
    return length if around <= 0.0 else around


@inner
def _object(cars, obstacles, world, car, which):  # noqa: ANN001, ANN202
    """Return an object of a car: first come obstacles, then all cars but itself."""
    rival = which - obstacles.shape[2]
    if rival < 0:
        return obstacles[:7, world, which]
    return cars[:7, world, rival + (rival >= car)]


@inner
def _heading(yaw):  # noqa: ANN001, ANN202
    """Return an angle in degrees, in (-180, 180]."""
    heading = yaw * _DEGREES
    return 180.0 if heading <= -180.0 else heading


@inner
def _rounded(number):  # noqa: ANN001, ANN202
    """Round to where single precision ends, so that a choice of 15 degrees is told as 15.0."""
    return np.rint(number * 1e4) / 1e4


@inner
def _seen(eye, its, box, half_length, half_width):  # noqa: ANN001, ANN202
    """Return whether the centre or a corner of an object is inside a car's view.

    What hides behind another object is seen all the same, as in the original.
    """
    cos, sin = math.cos(its[_YAW]), math.sin(its[_YAW])
    box_cos, box_sin = math.cos(box[_YAW]), math.sin(box[_YAW])
    for along, across in ((0.0, 0.0), (1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)):
        along, across = along * half_length, across * half_width
        dx = box[_X] + along * box_cos - across * box_sin - its[_X]
        dy = box[_Y] + along * box_sin + across * box_cos - its[_Y]
        forward = dx * cos + dy * sin - eye.forward
        left = dy * cos - dx * sin
        for height in (0.0, _HEIGHT / 2, _HEIGHT):
            up = height - eye.up
            depth = forward * eye.dip - up * eye.rise
            above = forward * eye.rise + up * eye.dip
            half = depth * eye.tan
            if _NEAR < depth < _FAR and abs(left) <= half and abs(above) <= 0.75 * half:
                return True
    return False
