"""Compiled: the referee: laps, off-track, contacts, penalties, running order.

`judge` looks at a world before and after physics, writes down what happened (VERDICT) and keeps the
cars' book; it moves no car. `penalise` applies the race's penalties; in training a mistake ends the
episode instead. Who is to blame for a contact: blame.py. The rules: docs/rules.md.
"""

import numpy as np

from league.jit import compiled, inner
from league.portable_math import clamp, f32, sincos
from league.sim import blame, grid
from league.sim.physics.vehicle import frozen
from league.sim.records import NOBODY
from league.track.projection import lap_length, project, signed_gap

_CLEAR_PASS = f32(1.0)
"""A pass changes the lead by less than this in one step; more is a car half a lap away [m]."""
_LEAST_TRAVEL = f32(1e-9)
_INFINITE = f32(np.inf)
_ZERO, _ONE = f32(0.0), f32(1.0)


@inner
def judge(before, cars, obstacles, world, verdicts, contacts, points, course, settings):
    """Write down what happened to the cars of one world in a control step; see records.py.

    `before` are the cars before the step, `cars` those after physics, still with the old book; it
    is brought up to date, and so are `leader` and `lead_changes` of the world, after its step was
    counted up. Verdicts are overwritten.
    """
    wanted = world.step % blame.PACE_EVERY == 0
    for c in range(len(cars)):
        _progress(before[c], cars[c], verdicts[c], points, course, settings)
        wanted |= blame.begin(cars[c], verdicts[c], contacts[c])
    if wanted:
        blame.judge_contacts(
            before, cars, obstacles, world, verdicts, contacts, points, course, settings
        )
    for c in range(len(cars)):
        _mistakes(before[c], cars[c], verdicts[c], contacts[c], settings)
        _lap(before[c], cars[c], world, verdicts[c], course, settings)
    _order(before, cars, world, verdicts, course, settings)


@inner
def _progress(old, car, seen, points, course, settings):
    """Find a car's place along the track, how far it came, and whether it is still on the road."""
    if frozen(old):
        # A standing car keeps its place: off the inside of a hairpin the search would creep on.
        seen.advance, seen.off_track = _ZERO, False
        # Counted in whole steps, so that no rounding adds or drops one.
        steps_left = max(f32(np.rint(old.penalty_s * settings.step_hz)) - _ONE, _ZERO)
        car.penalty_s = steps_left / settings.step_hz
        seen.released = steps_left == _ZERO and not car.retired
        return
    frame, lateral = project(points, course, car.x, car.y, old.s)
    seen.advance = signed_gap(course, frame.s, old.s)
    seen.released = False
    car.s, car.lateral = frame.s, lateral
    # Whole laps plus the place on this one, so that no error adds up.
    on_lap, turns = frame.s - old.zero_s, _ZERO
    if course.closed:
        turns = f32(np.rint((old.distance + seen.advance - on_lap) / course.length))
    car.distance = turns * course.length + on_lap
    on_road = _is_on_road(car, frame, points, course, settings)
    seen.off_track = grid.is_racing(old) and not on_road


@inner
def _is_on_road(car, frame, points, course, settings):
    """Return whether any wheel is on the road or its lines."""
    if -frame.right < car.lateral < frame.left:
        return True
    # No wheel is farther than this from the base.
    if abs(car.lateral) >= max(frame.left, frame.right) + settings.wheel_reach:
        return False
    sin, cos = sincos(car.yaw)
    for wheel in range(4):
        along = settings.arm if wheel < 2 else -settings.arm
        across = settings.half_track if wheel % 2 == 0 else -settings.half_track
        x = car.x + (cos * along - sin * across)
        y = car.y + (sin * along + cos * across)
        there, lateral = project(points, course, x, y, frame.s)
        if -there.right <= lateral <= there.left:
            return True
    return False


@inner
def _mistakes(old, car, seen, touched, settings):
    """Note a car's mistakes, and count them in its book."""
    racing = grid.is_racing(old)
    hit_thing = seen.crashed_obstacle != NOBODY and not seen.forced_off
    seen.crashed = racing and (seen.crashed_car != NOBODY or hit_thing)
    seen.touched, seen.wall = racing and seen.touched, touched.wall
    pushed_off = racing and seen.pushed_off
    dx, dy = car.x - old.x, car.y - old.y
    still = dx * dx + dy * dy <= settings.still_squared
    car.still_steps = old.still_steps + 1 if racing and still else 0
    seen.immobilised = car.still_steps >= settings.patience_steps
    if seen.immobilised:
        car.still_steps = 0
    car.backward_steps = old.backward_steps + 1 if racing and seen.advance < _ZERO else 0
    seen.reversed = car.backward_steps >= settings.patience_steps
    if seen.reversed:
        car.backward_steps = 0
    seen.mistake = seen.off_track or seen.crashed or seen.immobilised or seen.reversed or pushed_off
    car.touching_cars, car.touching_obstacles = touched.cars, touched.obstacles
    car.off_tracks += seen.off_track
    car.crashes += seen.crashed
    car.touches += seen.touched
    car.contacts_taken += seen.was_hit
    car.immobilised += seen.immobilised
    car.reversed += seen.reversed


@inner
def _lap(old, car, world, seen, course, settings):
    """Count a lap, forward only; the time of crossing is interpolated within the step."""
    target = f32(old.laps + 1) * lap_length(course)
    seen.lap = grid.is_racing(old) and car.distance >= target > old.best_distance
    seen.finished = False
    car.best_distance = max(old.best_distance, car.distance)
    if not seen.lap:
        return
    # The world's step has been counted up already.
    travelled = max(car.distance - old.distance, _LEAST_TRAVEL)
    part = clamp((target - old.distance) / travelled, _ZERO, _ONE)
    crossing = f32(world.step - 1) * settings.step_dt + part * settings.step_dt
    car.last_lap_s = crossing - old.lap_start_s
    car.best_lap_s = min(old.best_lap_s, car.last_lap_s)
    car.lap_start_s = crossing
    car.laps = old.laps + 1
    # An open track is driven once, however many laps were asked.
    if car.laps >= (settings.laps if course.closed else 1):
        seen.finished, car.finish_s = True, crossing


@inner
def _order(before, cars, world, verdicts, course, settings):
    """Find which cars each car is ahead of, which it passed on the road, and who leads."""
    num_cars, old_leader = len(cars), world.leader
    leads, home = False, False
    for c in range(num_cars):
        home |= cars[c].finish_s != _INFINITE
    # Whoever is home first is ahead for good, whatever it does on its cooling lap.
    by_time = home and settings.pursuers == 0
    for c in range(num_cars):
        ahead, passed = 0, 0
        for other in range(num_cars):
            was_ahead = (before[c].ahead >> other) & 1 == 1
            if by_time and min(cars[c].finish_s, cars[other].finish_s) < _INFINITE:
                level = cars[c].finish_s == cars[other].finish_s
                is_ahead = cars[c].finish_s < cars[other].finish_s or (level and was_ahead)
            else:
                # A pair changes only when the pass is clear; no car is ahead of itself. No
                # branches: they could not be predicted.
                lead, margin = _lead(cars[c], cars[other], course), settings.overtake_margin
                is_ahead = (lead > margin) | (was_ahead & (lead >= -margin))
            ahead |= is_ahead << other
        new = ahead & ~before[c].ahead
        for other in range(num_cars if new else 0):
            both = grid.is_racing(before[c]) and grid.is_racing(before[other])
            # Of cars that can drive through each other none passes.
            both = both and not (settings.room and (before[c].ghost or before[other].ghost))
            # Half a lap apart, ahead turns to behind without a pass.
            if (new >> other) & 1 and both and _lead(cars[c], cars[other], course) < _CLEAR_PASS:
                passed |= 1 << other
                cars[c].overtakes += 1
        cars[c].ahead, verdicts[c].overtook = np.uint8(ahead), np.uint8(passed)
        # Of cars side by side none may be ahead of all: then the leader stays.
        others = (1 << num_cars) - 1 - (1 << c)
        if num_cars > 1 and ahead == others and not leads and settings.pursuers == 0:
            leads, world.leader = True, c
    if settings.pursuers > 0:
        world.leader = _leader_of_pursuit(cars, old_leader, settings)
    changed = world.leader != old_leader
    world.lead_changes += changed
    for c in range(num_cars):
        verdicts[c].lead_changed = changed


@inner
def _leader_of_pursuit(cars, leader, settings):
    """Return the car that is home first, or leads the old leader by a margin."""
    for c in range(len(cars)):
        first, best = cars[c], cars[leader]
        farther = first.finish_s == best.finish_s and (
            first.distance > best.distance + settings.overtake_margin
        )
        if first.finish_s < best.finish_s or farther:
            leader = c
    return leader


@inner
def _lead(car, rival, course):
    """Return how far a car is ahead of another [m]."""
    if car.zero_s == rival.zero_s:
        return car.distance - rival.distance
    # Cars with laps that begin at different places are compared by who is ahead on the road.
    return signed_gap(course, car.s, rival.s)


@inner
def stop_bots(cars, obstacles, verdicts, settings):
    """Have all bot cars stand for a while after one ran into a car ahead of it."""
    if not settings.bots:
        return
    hit = False
    for c in range(len(cars)):
        hit |= cars[c].touching_obstacles != 0 and verdicts[c].crashed_obstacle == NOBODY
    if hit:
        for k in range(len(obstacles)):
            obstacles[k].stopped_s = settings.bot_stop_s


@inner
def penalise(cars, obstacles, verdicts, points, course, settings):
    """Apply the race's penalties to one world: a car that made a mistake is frozen, then goes on.

    After a crash the car is moved first, behind what it hit and to the other lane, then frozen.
    Off the track, backwards, immobilised or to blame for another car that left the road: frozen
    where it stands, then put on the nearer lane. The other car is put back at once.
    Frozen cars are ghosts, and stay so until nothing is near; so are cars that have finished. On an
    occupied spot a car thus drives on as a ghost until it is clear of whoever is there.
    """
    changing, crashes = False, False
    for c in range(len(cars)):
        seen = verdicts[c]
        changing |= seen.mistake or seen.released or seen.finished or cars[c].ghost
        changing |= seen.forced_off
        crashes |= _is_moved(seen)
        if seen.released:
            grid.release(cars[c], points, course)
    if crashes:
        _put_behind(cars, obstacles, verdicts, points, course, settings)
    if not changing:
        return
    _price(cars, verdicts, settings)
    for c in range(len(cars)):
        car, seen = cars[c], verdicts[c]
        # A frozen car that is to blame for one that leaves the road now stands longer.
        car.penalty_s += seen.penalty_s
        if seen.mistake:
            car.put_back = not seen.crashed
        elif seen.forced_off:
            car.penalty_s, car.put_back = settings.step_dt, not _is_moved(seen)
    _set_ghosts(cars, obstacles, settings)


@inner
def release(cars, obstacles, verdicts, points, course, settings):
    """Let cars go on after penalties that they began with, in training; see `penalise`."""
    changing = False
    for c in range(len(cars)):
        changing |= cars[c].ghost
        if verdicts[c].released:
            grid.release(cars[c], points, course)
    if changing:
        _set_ghosts(cars, obstacles, settings)


@inner
def _set_ghosts(cars, obstacles, settings):
    """Make ghosts of the cars that stand or are home, and solid cars of ghosts that are clear."""
    solid, wanting = 0, 0
    for c in range(len(cars)):
        car = cars[c]
        stays = frozen(car) or car.finish_s != _INFINITE
        if car.ghost and not stays:
            wanting |= 1 << c
        elif not stays:
            solid |= 1 << c
        car.ghost = car.ghost or stays
    for c in range(len(cars)):
        if (wanting >> c) & 1 and grid.is_clear(c, cars, obstacles, solid, wanting, settings):
            cars[c].ghost = False


@inner
def _price(cars, verdicts, settings):
    """Set what each car has to stand for the mistakes of this step [s]."""
    for c in range(len(cars)):
        # Of several mistakes the last one here decides; that of a crash has been set already.
        seen, cost = verdicts[c], _ZERO
        if seen.immobilised:
            cost = settings.immobilised_penalty_s
        if seen.reversed:
            cost = settings.reversed_penalty_s
        if seen.off_track:
            cost = settings.off_track_penalty_s
        if not seen.crashed:
            seen.penalty_s = cost
    for c in range(len(cars)):
        if verdicts[c].forced_off:
            to_blame = cars[c].pushed_by
            if cars[to_blame].finish_s == _INFINITE and not cars[to_blame].retired:
                into_thing = verdicts[c].crashed_obstacle != NOBODY
                verdicts[to_blame].penalty_s += (
                    settings.crash_penalty_s if into_thing else settings.off_track_penalty_s
                )


@inner
def _is_moved(seen):
    """Return whether a car is put behind what it hit, be it its own fault or not."""
    return seen.crashed or (seen.forced_off and seen.crashed_obstacle != NOBODY)


@inner(allocates=True)
def _put_behind(cars, obstacles, verdicts, points, course, settings):
    """Move crashed cars; all are placed by where the others were before anybody was moved."""
    places = np.empty((len(cars), 2), np.float32)
    for c in range(len(cars)):
        seen = verdicts[c]
        if _is_moved(seen):
            target, side = _ZERO, _ZERO
            if seen.crashed_obstacle != NOBODY:
                target = obstacles[seen.crashed_obstacle].s
                side = obstacles[seen.crashed_obstacle].lateral
            else:
                target, side = cars[seen.crashed_car].s, cars[seen.crashed_car].lateral
            shift, lateral = grid.place_behind(cars[c], target, side, points, course, settings)
            places[c, 0], places[c, 1] = shift, lateral
    for c in range(len(cars)):
        if _is_moved(verdicts[c]):
            grid.move(cars[c], points, course, places[c, 0], places[c, 1])


@compiled(allocates=True)
def running_order(cars, pursuit):
    """Return each car's place from 0, by finish, then by who is ahead; (num_worlds, num_cars).

    Of three cars side by side each may still be ahead of the next, in a ring; distance unties them,
    and then the slot. In a pursuit no car is ahead of another, and the distance driven decides.
    """
    num_worlds, num_cars = cars.shape
    out = np.zeros((num_worlds, num_cars), np.int64)
    beaten = np.empty(num_cars, np.int64)
    for w in range(num_worlds):
        for c in range(num_cars):
            beaten[c] = 0
            for other in range(num_cars):
                if pursuit:
                    beaten[c] += cars[w, c].finish_s < cars[w, other].finish_s
                else:
                    beaten[c] += (cars[w, c].ahead >> other) & 1
        for c in range(num_cars):
            mine = cars[w, c].distance
            for other in range(num_cars):
                theirs = cars[w, other].distance
                level = theirs > mine or (theirs == mine and other < c)
                if beaten[other] > beaten[c] or (beaten[other] == beaten[c] and level):
                    out[w, c] += 1
    return out


def wheel_positions(half_base: float, half_track: float, cars: np.ndarray) -> np.ndarray:
    """Return the wheel centres of CAR records in the world frame [m], (*cars.shape, 4, 2).

    `half_base` is from the base to either axle, `half_track` from its middle to its wheels [m].
    """
    cos, sin = np.cos(cars["yaw"])[..., None], np.sin(cars["yaw"])[..., None]
    along = np.array([half_base, half_base, -half_base, -half_base], np.float32)
    across = np.array([half_track, -half_track, half_track, -half_track], np.float32)
    x = cars["x"][..., None] + cos * along - sin * across
    y = cars["y"][..., None] + sin * along + cos * across
    return np.stack([x, y], axis=-1)
