"""Compiled: the numbers in the `params` of reward functions, computed car by car.

A DeepRacer reward function is plain Python and called a few dozen times a step, or just once, where
a batched library spends all its time on getting started. docs/rewards.md says what each key means.
All is computed in float64, from the simulator's float32 records.
"""

import math

import numpy as np

from league.jit import compiled, inner
from league.sim.physics.vehicle import frozen
from league.track.projection import lap_length, project

(WORLD, CAR, STEERING, SPEED, X, Y, HEADING) = range(7)
(DISTANCE, PROJECTION, WIDTH, LENGTH, PROGRESS, SIM_TIME, STEPS) = range(7, 14)
(IS_LEFT, ALL_ON_ROAD, NONE_ON_ROAD, CRASHED) = range(14, 18)
(TRACK, BEHIND, FOLLOWING, LAST_OBJECT, NEXT_OBJECT, SEES_NEXT) = range(18, 24)
NUM_OWN = 24  # Columns about a car itself.

(OBJECT_S, OBJECT_DISTANCE, OBJECT_HEADING, OBJECT_SPEED) = range(4)
(OBJECT_X, OBJECT_Y, OBJECT_IS_LEFT) = range(4, 7)
NUM_OF_OBJECT = 7  # Rows about each object.

f64 = np.float64
_DEGREES = 180.0 / math.pi
_BELOW_100 = math.nextafter(100.0, 0.0)
_NEAR, _FAR = 0.2, 300.0  # Depths between which the original's camera looks [m].
_HEIGHT = 0.2  # Assumed height of an object [m]: a car is 0.19, a box 0.25.

# Records, because each array or number that is passed costs a quarter of a microsecond.
ROAD = np.dtype(
    [
        ("steps", "i8"),  # stretches between two waypoints
        ("first_waypoint", "i8"),  # where its own waypoints begin; -1: they are evenly spaced
    ]
)
"""The waypoints of one track."""
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
"""A car's episode so far."""


@compiled(allocates=True)
def build(
    points,
    courses,
    roads,
    bodies,
    memory,
    waypoints,
    before,
    after,
    obstacles,
    worlds,
    verdicts,
    step_dt,
):
    """Return the numbers for each paid car that stands no penalty and has not finished.

    Of the TrackSet are `points` and `courses`; `waypoints`, (n, 2) [m], are those of all tracks
    that have their own, `roads` ROAD of each track, and `bodies` BODY of all cars, (1,). Steps are
    counted in `memory`, MEMORY of each car, and starts noted there; a lap ends an episode. As
    `memory`, (num_worlds, num_cars) are CAR records `before` and `after` the step, and VERDICT
    records; OBSTACLE records are (num_worlds, num_obstacles), WORLD records (num_worlds,). A step
    lasts `step_dt` [s].

    Returns:
        Of each car itself, float64 (num_rows, NUM_OWN), and of obstacles and all other cars, in
        this order, float64 (num_rows, NUM_OF_OBJECT, num_objects).
    """
    body, num_cars, num_obstacles = bodies[0], memory.shape[1], obstacles.shape[1]
    own = np.empty((memory.size, NUM_OWN))
    objects = np.empty((memory.size, NUM_OF_OBJECT, num_obstacles + num_cars - 1))
    number = 0
    for w in range(memory.shape[0]):
        course, road = courses[worlds[w].track], roads[worlds[w].track]
        for c in range(num_cars):
            episode, earlier, car = memory[w, c], before[w, c], after[w, c]
            if not episode.paid or _stopped(earlier):
                continue
            if episode.fresh:
                frame = _nose(points, course, body, earlier)[2]
                episode.lead = _short_way(course, frame.s - earlier.s)
                episode.start = earlier.distance
                episode.fresh = False
            row, verdict = own[number], verdicts[w, c]
            row[WORLD], row[CAR], row[TRACK] = w, c, worlds[w].track
            row[CRASHED], row[SIM_TIME] = verdict.crashed, worlds[w].step * step_dt
            _write_place(points, course, road, body, waypoints, car, row)
            _write_episode(course, episode, car, earlier.laps, verdict.lap, row)
            for k in range(num_obstacles):
                _write_object(course, obstacles[w, k], k, objects[number])
            for k in range(num_cars - 1):
                _write_object(course, after[w, k + (k >= c)], num_obstacles + k, objects[number])
            _write_closest_objects(course, objects[number], row)
            k = int(row[NEXT_OBJECT])
            if k < num_obstacles:
                box = obstacles[w, k]
                row[SEES_NEXT] = _seen(body, car, box, box.half_length, box.half_width)
            elif num_cars > 1:
                k -= num_obstacles
                rival = after[w, k + (k >= c)]
                row[SEES_NEXT] = _seen(body, car, rival, body.half_length, body.half_width)
            number += 1
    return own[:number], objects[:number]


@inner
def _stopped(car):
    """Return whether a car stands a penalty or has finished."""
    return frozen(car) or car.finish_s < math.inf


@inner
def _write_place(points, course, road, body, waypoints, car, row):
    x, y, frame, lateral = _nose(points, course, body, car)
    row[X], row[Y], row[HEADING] = x, y, _heading(car.yaw)
    row[STEERING] = _rounded(car.target_steering * _DEGREES)
    row[SPEED] = _rounded(f64(car.target_speed))
    row[DISTANCE], row[PROJECTION] = abs(lateral), frame.s
    row[WIDTH], row[LENGTH] = frame.left + frame.right, course.length
    row[IS_LEFT] = frame.left - lateral < frame.right + lateral
    row[ALL_ON_ROAD], row[NONE_ON_ROAD] = _on_road(points, course, body, car)
    row[BEHIND], row[FOLLOWING] = closest_waypoints(waypoints, course, road, frame.s, x, y)


@inner
def _write_episode(course, episode, car, laps, lap, row):
    episode.steps += 1
    row[STEPS] = episode.steps
    # Held just below 100 until the referee has counted the lap, so that 100 occurs once.
    if lap:
        row[PROGRESS] = 100.0
        episode.steps = 0
        episode.start = (laps + 1) * f64(lap_length(course))
    else:
        lead = _short_way(course, row[PROJECTION] - car.s) - episode.lead
        driven = car.distance - episode.start + lead
        row[PROGRESS] = min(100.0 * driven / lap_length(course), _BELOW_100)


@inner
def _write_object(course, thing, k, table):
    """Write the rows about an obstacle or another car."""
    s = f64(thing.s)
    table[OBJECT_S, k] = s % course.length if course.closed else s
    table[OBJECT_DISTANCE, k] = abs(thing.lateral)
    table[OBJECT_HEADING, k] = _heading(thing.yaw)
    velocity_x, velocity_y = f64(thing.velocity_x), f64(thing.velocity_y)
    table[OBJECT_SPEED, k] = math.sqrt(velocity_x**2 + velocity_y**2)
    table[OBJECT_X, k], table[OBJECT_Y, k] = thing.x, thing.y
    table[OBJECT_IS_LEFT, k] = f64(thing.lateral) > 0.0


@inner
def _write_closest_objects(course, table, row):
    """Write the last object and the next one along the lap; 0 and 0 without objects."""
    row[LAST_OBJECT] = row[NEXT_OBJECT] = row[SEES_NEXT] = 0
    smallest_behind = smallest_ahead = math.inf
    for k in range(table.shape[1]):
        gap = table[OBJECT_S, k] - row[PROJECTION]
        # On a loop everything is somewhere ahead; on a straight what is behind comes last.
        ahead = _ahead(course, gap)
        behind = 0.0 if ahead == course.length else _ahead(course, -gap)
        if 0.0 <= behind < smallest_behind:
            smallest_behind, row[LAST_OBJECT] = behind, k
        if 0.0 < ahead < smallest_ahead:
            smallest_ahead, row[NEXT_OBJECT] = ahead, k


@compiled
def closest_waypoints(waypoints, course, road, s, x, y):
    """Return the waypoint at or behind a place, and the next one; after the last comes 0.

    A track's own `waypoints`, (n, 2) [m], are joined by straight lines, and the point of these that
    is nearest to x and y [m] counts, as in the original. Those that are evenly spaced lie on the
    centreline, along which the place is at s, in [0, length] [m]. `course` and `road` are COURSE
    and ROAD of the track.
    """
    # The tiny share keeps a place right at a waypoint from falling behind it by rounding.
    if road.first_waypoint < 0:
        behind = math.floor(s / course.length * road.steps + 1e-6)
    else:
        own = waypoints[road.first_waypoint : road.first_waypoint + road.steps + 1]
        behind = _last_reached(own, course.closed, x, y)
    behind = min(max(behind, 0), road.steps)
    return behind, 0 if behind >= road.steps else behind + 1


@inner
def _last_reached(waypoints, closed, x, y):
    """Return the last waypoint at or before the nearest point on the lines that join them."""
    reached, nearest = 0, math.inf
    for k in range(len(waypoints) - 1):
        begin_x, begin_y = waypoints[k]
        edge_x, edge_y = waypoints[k + 1, 0] - begin_x, waypoints[k + 1, 1] - begin_y
        square = edge_x**2 + edge_y**2
        part = ((x - begin_x) * edge_x + (y - begin_y) * edge_y) / square if square > 0.0 else 0.0
        part = min(max(part, 0.0), 1.0)
        off = (x - begin_x - part * edge_x) ** 2 + (y - begin_y - part * edge_y) ** 2
        if off < nearest:
            reached, nearest = k + (part > 1.0 - 1e-6), off
    # Right at the seam the first waypoint counts, and of equal ones the last.
    last = len(waypoints) - 1
    if closed and _equal(waypoints, reached, last):
        reached = 0
    while reached < last and _equal(waypoints, reached, reached + 1):
        reached += 1
    return reached


@inner
def _equal(waypoints, one, other):
    return waypoints[one, 0] == waypoints[other, 0] and waypoints[one, 1] == waypoints[other, 1]


@inner
def _nose(points, course, body, car):
    """Return where a car's nose is, x and y [m], the track's frame there and its lateral place."""
    x = car.x + body.nose * math.cos(f64(car.yaw))
    y = car.y + body.nose * math.sin(f64(car.yaw))
    frame, lateral = project(points, course, x, y, f64(car.s))
    return x, y, frame, lateral


@inner
def _on_road(points, course, body, car):
    """Return whether all four wheels are on the road, and whether none is."""
    cos, sin = math.cos(f64(car.yaw)), math.sin(f64(car.yaw))
    wheels = 0
    for along in (body.half_base, -body.half_base):
        for across in (body.half_track, -body.half_track):
            x = car.x + along * cos - across * sin
            y = car.y + along * sin + across * cos
            frame, lateral = project(points, course, x, y, f64(car.s))
            wheels += -frame.right <= lateral <= frame.left
    return wheels == 4, wheels == 0


@inner
def _short_way(course, gap):
    """Return a difference of two places the shorter way round [m]."""
    return gap - np.rint(gap / course.length) * course.length if course.closed else gap


@inner
def _ahead(course, gap):
    """Return a difference of two places as a way ahead [m]: on a loop in (0, length]."""
    if not course.closed:
        return gap
    around = gap % course.length
    return course.length if around <= 0.0 else around


@inner
def _heading(yaw):
    """Return an angle in degrees, in (-180, 180]."""
    heading = yaw * _DEGREES
    return 180.0 if heading <= -180.0 else heading


@inner
def _rounded(number):
    """Round to where single precision ends, so that a choice of 15 degrees is 15.0."""
    return np.rint(number * 1e4) / 1e4


@inner
def _seen(body, car, thing, half_length, half_width):
    """Return whether the centre or a corner of an object is inside a car's view.

    An object hidden behind another one counts as seen, as in the original.
    """
    cos, sin = math.cos(f64(car.yaw)), math.sin(f64(car.yaw))
    box_cos, box_sin = math.cos(f64(thing.yaw)), math.sin(f64(thing.yaw))
    for along, across in ((0.0, 0.0), (1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)):
        along, across = along * half_length, across * half_width
        dx = thing.x + along * box_cos - across * box_sin - car.x
        dy = thing.y + along * box_sin + across * box_cos - car.y
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
