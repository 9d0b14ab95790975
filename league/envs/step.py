"""Compiled: one control step of all worlds, in the order of nature.

    actions -> controls -> physics -> referee -> reward -> penalties or new episodes -> own motion

Observations describe the state after penalties and restarts; verdicts and rewards what really
happened in the step. Bullet, and rewards written in Python, take the stages apart (`phases`).
"""

import math

import numpy as np

from league.envs import episodes as episode_kernels
from league.envs import observations, rewards, scenarios
from league.jit import compiled, inner
from league.portable_math import f32
from league.sim import grid, referee
from league.sim.physics import planar

PREPARE, PHYSICS, JUDGE, SETTLE = 1, 2, 4, 8
"""Phases of a step: read the actions; move the cars; judge and pay; penalties or new episodes."""
ALL = PREPARE | PHYSICS | JUDGE | SETTLE

OUTCOME = np.dtype(
    [
        ("reward", f32),
        ("terminated", np.bool_),  # a finish; in training any mistake too
        ("truncated", np.bool_),  # the time limit; in training also pushed off the road
        ("began", np.bool_),  # a new episode began in this step
        ("near", np.bool_),  # in training where cars meet: another car is near
        ("attack", np.uint8),  # there: how this car's attack ended in this step; see scenarios.py
    ],
    align=True,
)
"""What a step yields for one car."""

FINE, BAD_ACTION, BAD_STATE = 0, 1, 2
"""What `step` returns: all is well; an action is not in [-1, 1]; a car's state is not finite."""
_ZERO, _HALF, _ONE = f32(0.0), f32(0.5), f32(1.0)


@compiled(vectorizes=False)
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
    encounters,
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
    """Drive the worlds from `first` to before `last` for one control step.

    Records and what belongs to them, of all worlds:
        phases: which stages to run, PREPARE to SETTLE.
        actions: steering and speed in [-1, 1], float32 (num_worlds, num_cars, 2).
        cars: CAR records (num_worlds, num_cars); of the same shape are contacts, verdicts,
            outcomes, and `before`, which is set to the cars before the step, unless all stages are
            run: then it is scratch.
        obstacles: OBSTACLE records (num_worlds, num_obstacles); `arrivals` is scratch like it.
        worlds: WORLD records (num_worlds,); `encounters` are those of training where cars meet.
        controls: set to target steering [rad] and speed [m/s], float32 (num_worlds, num_cars, 2);
            scratch as `before` is.
        terms: weighted terms of the reward, float32 (num_worlds, num_cars, num_terms).
        motions: set to the `motion` group, float32 (num_cars, num_worlds, 5).
        weight: weights of the terms, float32 (num_terms,); of length 0: the reward is Python's.
        points, courses: of the TrackSet.
        places: fixed places of obstacles, float32 (num_obstacles, 2), or (0, 2).
        pairs: planar.schedule.
        settings, episodes: SETTINGS and EPISODES records, shape (1,).

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
        # One place for all worlds stays in the processor's nearest cache.
        slot = first if phases == ALL else w
        if phases & PREPARE:
            for c in range(num_cars):
                before[slot, c] = cars[w, c]
                # As actions.decode does.
                controls[slot, c, 0] = actions[w, c, 0] * sim.max_steering
                share = (actions[w, c, 1] + _ONE) * _HALF
                speed = sim.min_speed + share * (sim.max_speed - sim.min_speed)
                controls[slot, c, 1] = min(speed, cars[w, c].top_speed)
            grid.aim_obstacles(things, arrivals[w], world, points, course, places, sim)
        if phases & PHYSICS:
            planar.step_world(cars[w], things, course, controls[slot], contacts[w], pairs, sim)
        if phases & JUDGE:
            for c in range(num_cars):
                car = cars[w, c]
                motion = car.x + car.y + car.yaw + car.velocity_x + car.velocity_y + car.yaw_rate
                if not math.isfinite(motion):
                    return BAD_STATE + 4 * (w * num_cars + c)
                cars[w, c].target_steering = controls[slot, c, 0]
                cars[w, c].target_speed = controls[slot, c, 1]
                cars[w, c].action_steering = actions[w, c, 0]
                cars[w, c].action_speed = actions[w, c, 1]
            for k in range(len(things)):
                things[k] = arrivals[w, k]
            world.step += 1
            seen = verdicts[w]
            referee.judge(
                before[slot], cars[w], things, world, seen, contacts[w], points, course, sim
            )
            referee.stop_bots(cars[w], things, seen, sim)
            if len(weight):
                rewards.pay(cars[w], seen, terms[w], weight, points, course)
                _sum_terms(terms[w], outcomes[w])
        if phases & SETTLE:
            if rules.training:
                if rules.meeting:
                    referee.release(cars[w], things, verdicts[w], points, course, sim)
                    over = scenarios.judge(
                        encounters[w], cars[w], verdicts[w], outcomes[w], course, sim, rules
                    )
                    done = (1 << num_cars) - 1 if over else 0
                else:
                    done = _end_episodes(cars[w], verdicts[w], outcomes[w], rules)
                begins = episode_kernels.end_and_begin(
                    done, encounters[w], cars[w], things, world, points, course, places, sim, rules
                )
                for c in range(num_cars):
                    outcomes[w, c].began = (begins >> c) & 1 == 1
            else:
                referee.penalise(cars[w], things, verdicts[w], points, course, sim)
                _end_race(cars[w], world, outcomes[w])
            for c in range(num_cars):
                observations.motion(cars[w, c], motions[c, w])
    return FINE


@compiled
def reset(
    which,
    encounters,
    cars,
    obstacles,
    worlds,
    motions,
    points,
    courses,
    places,
    settings,
    episodes,
):
    """Start the races of the worlds `which`, int64; their seeds and tracks have been set."""
    sim, rules = settings[0], episodes[0]
    for n in range(len(which)):
        w = which[n]
        world, course = worlds[w], courses[worlds[w].track]
        grid.start(cars[w], obstacles[w], world, points, course, places, sim)
        if rules.training:
            all_cars, things = (1 << cars.shape[1]) - 1, obstacles[w]
            episode_kernels.begin(
                all_cars, encounters[w], cars[w], things, world, points, course, places, sim, rules
            )
        for c in range(cars.shape[1]):
            episode_kernels.encode(cars[w, c], sim)
            observations.motion(cars[w, c], motions[c, w])


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
        finished = math.isfinite(cars[c].finish_s)
        outcomes[c].terminated = finished
        outcomes[c].truncated = world.step >= world.last_step and not finished
        outcomes[c].began = False


@inner
def _end_episodes(cars, verdicts, outcomes, rules):
    """Return the mask of the cars that end an episode in this step."""
    done = 0
    for c in range(len(cars)):
        cars[c].episode_steps += 1
        over = verdicts[c].mistake or verdicts[c].finished
        outcomes[c].terminated = over
        # Pushed off the road an episode is cut off: it ends, but through no fault of the car.
        cut_off = cars[c].episode_steps >= rules.longest or verdicts[c].forced_off
        outcomes[c].truncated = cut_off and not over
        if over or outcomes[c].truncated:
            done |= 1 << c
    return done


CARS_PER_THREAD = 256  # fewest cars that are worth another thread


def worlds_per_thread(num_cars: int) -> int:
    """Return the fewest worlds that are worth another thread."""
    return max(1, CARS_PER_THREAD // num_cars)
