"""Compiled: one control step of all worlds, in the order of nature.

    actions -> controls -> physics -> referee -> reward -> penalties or new episodes -> own motion

Observations describe the state after penalties and restarts; verdicts and rewards what really
happened in the step. Bullet, and rewards written in Python, take the stages apart (`phases`).
"""

# Numba gives its types a meaning that the checker does not know.
# pyright: reportArgumentType=false, reportCallIssue=false, reportReturnType=false

import math

import numpy as np

from league.envs import episodes as episodes_room
from league.envs import observations, rewards
from league.jit import compiled, inner
from league.portable_math import f32
from league.sim import grid, referee
from league.sim import obstacles as obstacles_room
from league.sim.physics import planar

PREPARE, PHYSICS, JUDGE, SETTLE = 1, 2, 4, 8
"""Phases of a step: read the actions; move the cars; judge and pay; penalties or new episodes."""
ALL = PREPARE | PHYSICS | JUDGE | SETTLE

OUTCOME = np.dtype(
    [
        ("reward", f32),
        ("terminated", np.bool_),  # a finish; in training any mistake too
        ("truncated", np.bool_),  # the time limit
        ("began", np.bool_),  # a new episode began in this step
    ],
    align=True,
)
"""What a step brought one car."""

FINE, BAD_ACTION, BAD_STATE = 0, 1, 2
"""What `step` returns: all is well; an action is not in [-1, 1]; a car's state is not finite."""
_ZERO, _HALF, _ONE = f32(0.0), f32(0.5), f32(1.0)


@compiled
def step(
    first,
    last,
    phases,
    actions,
    cars,
    before,
    obstacles,
    arrivals,
    worlds,
    controls,
    contacts,
    verdicts,
    outcomes,
    terms,
    motions,
    weight,
    points,
    courses,
    places,
    pairs,
    settings,
    episodes,
):
    """Drive the worlds from `first` to `last` for one control step.

    Args:
        first: first world.
        last: world behind the last one.
        phases: which stages to run, PREPARE to SETTLE.
        actions: steering and speed in [-1, 1], float32 (num_worlds, num_cars, 2).
        cars: CAR records (num_worlds, num_cars).
        before: set to the CAR records before the step.
        obstacles: OBSTACLE records (num_worlds, num_obstacles).
        arrivals: scratch of the same shape.
        worlds: WORLD records (num_worlds,).
        controls: set to target steering [rad] and speed [m/s], float32 (num_worlds, num_cars, 2).
        contacts: CONTACT records (num_worlds, num_cars).
        verdicts: VERDICT records (num_worlds, num_cars).
        outcomes: OUTCOME records (num_worlds, num_cars).
        terms: weighted terms of the reward, float32 (num_worlds, num_cars, num_terms).
        motions: set to the `motion` group, float32 (num_cars, num_worlds, 5).
        weight: weights of the terms, float32 (num_terms,); of length 0: the reward is Python's.
        points: of the TrackSet.
        courses: of the TrackSet.
        places: fixed places of obstacles, float32 (num_obstacles, 2), or (0, 2).
        pairs: planar.schedule.
        settings: SETTINGS record, shape (1,).
        episodes: EPISODES record, shape (1,).

    Returns:
        FINE; or BAD_ACTION or BAD_STATE plus 4 times the number of the first bad car, counted
        through all worlds. After BAD_ACTION nothing has changed.
    """
    sim, rules = settings[0], episodes[0]
    num_cars = cars.shape[1]
    if phases & PREPARE:
        for w in range(first, last):
            for c in range(num_cars):
                # False for NaN.
                if not (abs(actions[w, c, 0]) <= _ONE and abs(actions[w, c, 1]) <= _ONE):
                    return BAD_ACTION + 4 * (w * num_cars + c)
    for w in range(first, last):
        world, course = worlds[w], courses[worlds[w].track]
        things = obstacles[w]
        if phases & PREPARE:
            for c in range(num_cars):
                before[w, c] = cars[w, c]
                _decode(actions[w, c], controls[w, c], sim)
            obstacles_room.aim(things, arrivals[w], world, points, course, places, sim)
        if phases & PHYSICS:
            planar.step_world(cars[w], things, course, controls[w], contacts[w], pairs, sim)
        if phases & JUDGE:
            for c in range(num_cars):
                if not _is_finite(cars[w, c]):
                    return BAD_STATE + 4 * (w * num_cars + c)
                _remember(cars[w, c], controls[w, c], actions[w, c])
            for k in range(len(things)):
                things[k] = arrivals[w, k]
            world.step += 1
            referee.judge(
                before[w], cars[w], things, world, verdicts[w], contacts[w], points, course, sim
            )
            referee.stop_bots(cars[w], things, verdicts[w], sim)
            if len(weight):
                rewards.pay(cars[w], verdicts[w], terms[w], weight, points, course)
                _sum_terms(terms[w], outcomes[w])
        if phases & SETTLE:
            if rules.training:
                _end_episodes(
                    cars[w],
                    things,
                    world,
                    verdicts[w],
                    outcomes[w],
                    points,
                    course,
                    places,
                    sim,
                    rules,
                )
            else:
                referee.penalise(cars[w], things, verdicts[w], points, course, sim)
                _end_race(cars[w], world, outcomes[w])
            for c in range(num_cars):
                observations.motion(cars[w, c], motions[c, w])
    return FINE


@compiled
def reset(which, cars, obstacles, worlds, motions, points, courses, places, settings, episodes):
    """Start the races of some worlds: on the grid, or in training wherever episodes begin.

    Args:
        which: worlds to start, int64 (num_started,); their seeds and tracks have been set.
        cars: see `step`, as for the rest.
        obstacles: see `step`.
        worlds: see `step`.
        motions: see `step`.
        points: see `step`.
        courses: see `step`.
        places: see `step`.
        settings: see `step`.
        episodes: see `step`.
    """
    sim, rules = settings[0], episodes[0]
    for n in range(len(which)):
        w = which[n]
        world, course = worlds[w], courses[worlds[w].track]
        grid.start(cars[w], obstacles[w], world, points, course, places, sim)
        if rules.training:
            episodes_room.begin_all(
                cars[w], obstacles[w], world, points, course, places, sim, rules
            )
        for c in range(cars.shape[1]):
            episodes_room.encode(cars[w, c], sim)
            observations.motion(cars[w, c], motions[c, w])


@inner
def _decode(action, control, sim):
    """Turn an action in [-1, 1] into a steering angle [rad] and a target speed [m/s]."""
    control[0] = action[0] * sim.max_steering
    share = (action[1] + _ONE) * _HALF
    control[1] = sim.min_speed + share * (sim.max_speed - sim.min_speed)


@inner
def _remember(car, control, action):
    car.target_steering, car.target_speed = control[0], control[1]
    car.action_steering, car.action_speed = action[0], action[1]


@inner
def _is_finite(car):
    total = car.x + car.y + car.yaw + car.velocity_x + car.velocity_y + car.yaw_rate
    return math.isfinite(total)


@inner
def _sum_terms(terms, outcomes):
    for c in range(len(outcomes)):
        total = _ZERO
        for k in range(terms.shape[1]):
            total += terms[c, k]
        outcomes[c].reward = total


@inner
def _end_race(cars, world, outcomes):
    for c in range(len(cars)):
        home = math.isfinite(cars[c].finish_s)
        outcomes[c].terminated = home
        outcomes[c].truncated = world.step >= world.last_step and not home
        outcomes[c].began = False


@inner
def _end_episodes(cars, obstacles, world, verdicts, outcomes, points, course, places, sim, rules):
    done = 0
    for c in range(len(cars)):
        cars[c].episode_steps += 1
        over = verdicts[c].mistake or verdicts[c].finished
        outcomes[c].terminated = over
        outcomes[c].truncated = cars[c].episode_steps >= rules.longest and not over
        if over or outcomes[c].truncated:
            done |= 1 << c
    begins = episodes_room.end_and_begin(
        done, cars, obstacles, world, points, course, places, sim, rules
    )
    for c in range(len(cars)):
        outcomes[c].began = (begins >> c) & 1 == 1
