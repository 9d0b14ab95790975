"""Evaluations: trials as on the console, the same alone and in a batch, and their trace."""

import csv
import math
from dataclasses import dataclass, field

import numpy as np
import pytest

from league.envs.actions import DiscreteActions
from league.envs.config import RewardConfig
from league.envs.rewards import BuiltIn
from league.errors import ActionError, ConfigError, PolicyError
from league.race_spec import Entry, RaceSpec
from league.racing import race
from league.racing.evaluate import evaluate
from league.racing.trace import COLUMNS, Trace, nearer
from league.sim.config import ObstacleConfig, RaceRules, SensorConfig, SimConfig
from tests.scenes import RING_LENGTH, follow_center, make_ring, make_straight


@dataclass
class Follower:
    """Follows the centreline; in some steps of each attempt it steers straight to the right."""

    name: str = "follower"
    speed: float = 1.5
    lateral: float = 0.0
    leaves: tuple[int, int] = (0, 0)
    """First and last step, since the last reset, of driving off the road."""
    sensors: SensorConfig = field(default_factory=SensorConfig)
    steps: np.ndarray | None = None

    def reset(self, rows):
        if rows is None or self.steps is None:
            self.steps = None
        else:
            self.steps[rows] = 0

    def act(self, observations):
        actions = follow_center(observations, self.speed, self.lateral)
        if self.steps is None:
            self.steps = np.zeros(len(actions), np.int64)
        self.steps = self.steps + 1
        first, last = self.leaves
        leaving = (self.steps >= first) & (self.steps <= last)
        actions[leaving, 0] = -1.0
        return actions


@dataclass
class Stubborn(Follower):
    """Asks for something that is no action."""

    answer: object = None

    def act(self, observations):
        return self.answer


def evaluated(driver=None, track=None, **settings):
    settings = {"solver": "planar", "laps": 2, "variation": 0.0} | settings
    return evaluate(driver or Follower(), track or make_ring(), **settings)


def test_laps_are_trials_and_the_first_starts_at_rest():
    done = evaluated(laps=3)
    assert [one.status for one in done.trials] == ["lap_complete"] * 3
    assert [one.trial for one in done.trials] == [1, 2, 3]
    assert [one.standing for one in done.trials] == [True, False, False]
    assert [one.completion for one in done.trials] == [100.0] * 3
    # 12 m at 1.5 m/s are 8 s; a little less, for the follower cuts the bend by a few centimetres.
    assert done.trials[1].time_s == pytest.approx(8.0, abs=0.3)
    assert done.trials[0].time_s > done.trials[1].time_s
    assert done.best_flying_s == min(done.flying_laps_s) == done.best_lap_s
    assert len(done.flying_laps_s) == 2
    assert done.total_s == pytest.approx(sum(done.lap_times_s))
    assert done.mean_lap_s == pytest.approx(done.total_s / 3)
    assert (done.complete_laps, done.clean_laps, done.asked) == (3, 3, 3)
    assert done.all_complete
    assert done.completion == 100.0


@pytest.mark.parametrize("solver", ["planar", "bullet"])
def test_lap_times_are_those_of_the_race(solver):
    driver = Follower(leaves=(10, 20))
    spec = RaceSpec(
        kind="time_trial", laps=2, seed=5, solver=solver, entries=(Entry(name="follower"),)
    )
    raced = race.run(spec, track=make_ring(), drivers=[driver], record=False).result.order[0]
    done = evaluated(driver, seed=5, solver=solver)
    assert done.lap_times_s == raced.lap_times_s
    assert done.off_tracks == raced.off_tracks > 0
    assert sum(one.penalty_s for one in done.trials) == raced.penalty_s


def test_mistake_costs_seconds_in_a_race_and_counts_in_its_lap():
    clean, left = evaluated(), evaluated(Follower(leaves=(10, 20)))
    first, second = left.trials
    assert (first.status, first.off_tracks, first.penalty_s) == ("lap_complete", 1, 2.0)
    assert first.time_s > clean.trials[0].time_s + 2.0
    assert (second.off_tracks, second.penalty_s) == (0, 0.0)
    assert not first.clean
    assert second.clean
    assert (left.complete_laps, left.clean_laps) == (2, 1)


def test_penalties_are_those_of_the_rules():
    done = evaluated(Follower(leaves=(10, 20)), rules=RaceRules(off_track_penalty_s=5.0, laps=77))
    assert done.trials[0].penalty_s == 5.0
    assert len(done.trials) == 2  # the laps asked for, not those of the rules


def test_mistake_ends_the_trial_of_an_episode_and_the_next_begins_at_the_line():
    done = evaluated(Follower(leaves=(60, 75)), mode="episode", laps=3)
    assert [one.status for one in done.trials] == ["off_track"] * 3
    assert [one.standing for one in done.trials] == [True] * 3
    assert [one.off_tracks for one in done.trials] == [1] * 3
    # Nothing is random here, so every attempt from the line ends alike.
    assert len({(one.time_s, one.completion) for one in done.trials}) == 1
    # 60 steps are 4 s: about half of the lap of 8 s.
    assert 40.0 < done.trials[0].completion < 60.0
    assert done.trials[0].time_s == pytest.approx(done.trials[0].completion / 100 * 8.0, abs=1.0)
    assert done.trials[0].penalty_s == 0.0
    assert (done.complete_laps, done.asked) == (0, 3)
    assert done.completion == pytest.approx(done.trials[0].completion)
    assert done.best_lap_s is done.mean_lap_s is done.best_flying_s is None


def test_episode_without_a_mistake_drives_on_into_a_flying_lap():
    done = evaluated(mode="episode", laps=3)
    assert done.model_copy(update={"mode": "race"}) == evaluated(laps=3)


def test_attempt_after_a_mistake_is_a_fresh_one():
    # Left the road in the second lap; the third trial is again a standing one, to the bit.
    done = evaluated(Follower(leaves=(160, 175)), mode="episode", laps=3)
    assert [one.status for one in done.trials] == ["lap_complete", "off_track", "lap_complete"]
    assert [one.standing for one in done.trials] == [True, False, True]
    assert done.trials[2].time_s == done.trials[0].time_s


def test_runs_vary_by_their_seeds_within_the_limits():
    begun = {}

    def note(step):
        for trial in step.trials:
            if trial.step == 1:
                begun[trial.run, trial.trial] = step.before[trial.row, 0].copy()

    done = evaluated(laps=1, trials=20, variation=1.0, watch=note)
    assert len({one.time_s for one in done.trials}) > 1
    speeds = [float(np.hypot(car["velocity_x"], car["velocity_y"])) for car in begun.values()]
    assert 0.0 < min(speeds) < 0.1 and 0.4 < max(speeds) < 0.5
    plain = SimConfig().car
    for name, middle, reach in (
        ("grip", plain.grip, 0.02 * plain.grip),
        ("mass", plain.mass, 0.02 * plain.mass),
        ("steering_offset", 0.0, 0.005),
    ):
        deviations = [abs(float(car[name]) - middle) for car in begun.values()]
        assert 0.5 * reach < max(deviations) <= reach * 1.001
    assert evaluated(laps=1, trials=20, variation=1.0) == done
    (last,) = evaluated(laps=1, seed=19, variation=1.0).trials
    assert last.time_s == done.trials[19].time_s
    with pytest.raises(ConfigError, match="variation is 11: give 0"):
        evaluated(variation=11)


def test_attempts_of_a_run_vary_and_a_grid_stands():
    done = evaluated(Follower(leaves=(60, 75)), mode="episode", laps=3, variation=1.0)
    assert len({one.time_s for one in done.trials} | {one.completion for one in done.trials}) > 2
    speeds = []
    evaluated(
        opponents=[Follower("slow", 1.0)],
        laps=1,
        variation=1.0,
        watch=lambda step: speeds.append(step.before["velocity_x"].copy()),
    )
    assert not speeds[0].any()


def test_clean_runs_are_counted():
    assert evaluated(laps=2, trials=2).clean_runs == 2
    done = evaluated(Follower(leaves=(160, 175)), laps=2, trials=2)
    assert (done.clean_laps, done.clean_runs, done.runs) == (2, 0, 2)


def test_standing_still_has_its_own_status():
    done = evaluated(Stubborn(answer=np.array([[0.0, -1.0]])), mode="episode", laps=1)
    # The smallest speed is 0.1 m/s, so the car creeps off the ring's bend straight ahead.
    assert done.trials[0].status == "off_track"
    done = evaluated(
        Follower(speed=0.3), rules=RaceRules(still_distance=0.05), mode="episode", laps=1
    )
    assert (done.trials[0].status, done.trials[0].immobilised) == ("immobilized", 1)


@pytest.mark.parametrize("mode", ["race", "episode"])
def test_time_up_ends_the_run_with_its_completion(mode):
    # 10 s of 8 s laps: one lap is complete, the second is not, the third was never begun.
    done = evaluated(mode=mode, laps=3, rules=RaceRules(max_time_s=10.0))
    assert [one.status for one in done.trials[:2]] == ["lap_complete", "time_up"]
    assert 10.0 < done.trials[1].completion < 30.0
    assert done.trials[0].time_s + done.trials[1].time_s == pytest.approx(10.0, abs=1e-3)
    assert done.asked == 3
    if mode == "race":
        assert len(done.trials) == 2
        assert done.completion == pytest.approx((100 + done.trials[1].completion) / 3)


def test_open_track_is_one_lap():
    done = evaluated(track=make_straight(), laps=3, trials=2)
    assert [one.status for one in done.trials] == ["lap_complete"] * 2
    assert done.asked == 2
    assert done.laps == 1


def test_runs_are_the_same_alone_and_in_a_batch():
    settings = {
        "kind": "obstacle_avoidance",
        "obstacles": ObstacleConfig(count=2),
        "rules": RaceRules(crash_penalty_s=0.5, max_time_s=12.0),
        "laps": 1,
    }
    together = evaluated(trials=3, seed=10, **settings)
    assert {one.seed for one in together.trials} == {10, 11, 12}
    assert len({(one.time_s, one.completion) for one in together.trials}) > 1
    for seed in (10, 11, 12):
        (alone,) = evaluated(seed=seed, **settings).trials
        (there,) = (one for one in together.trials if one.seed == seed)
        assert there.model_dump(exclude={"trial", "run"}) == alone.model_dump(
            exclude={"trial", "run"}
        )


def test_opponents_make_it_head_to_head_and_places_are_given():
    slow, fast = Follower("slow", 1.5, lateral=0.0), Follower("fast", 2.5, lateral=0.0)
    won = evaluated(fast, opponents=[slow], laps=1)
    assert (won.kind, won.places, won.driver) == ("head_to_head", (1,), "fast")
    slow, fast = Follower("slow", 1.5, lateral=-0.2), Follower("fast", 2.5, lateral=0.2)
    lost = evaluated(slow, opponents=[fast], laps=1)
    assert lost.places == (2,)
    assert evaluated(laps=1).places == ()


def test_drivers_may_be_named():
    done = evaluate("centerline", "reinvent_2018", laps=1, solver="planar")
    assert (done.driver, done.track, done.all_complete) == ("centerline", "reinvent_2018", True)
    with pytest.raises(PolicyError, match="nobody"):
        evaluate("nobody", "reinvent_2018")


def test_summary_is_plain_numbers():
    done = evaluated(laps=1)
    assert done.summary["complete_laps"] == 1
    assert done.summary["best_flying_s"] is None
    assert all(value is None or isinstance(value, int | float) for value in done.summary.values())
    assert type(done).model_validate_json(done.model_dump_json()) == done


@pytest.mark.parametrize(
    ("settings", "named"),
    [({"trials": 0}, "trials"), ({"laps": 0}, "laps"), ({"seed": -1}, "seed")],
)
def test_settings_out_of_range_are_refused(settings, named):
    with pytest.raises(ConfigError, match=named):
        evaluated(**settings)


@pytest.mark.parametrize(
    "answer", [None, np.zeros(2), np.full((1, 2), math.nan), np.full((1, 2), 1.5)]
)
def test_answer_that_is_no_action_is_refused(answer):
    with pytest.raises(ActionError, match="follower"):
        evaluated(Stubborn(answer=answer))


# The trace --------------------------------------------------------------------------------------


def traced(driver=None, track=None, space=None, **settings):
    trace = Trace(space, started_s=1000.0)
    done = evaluated(driver, track, watch=trace.add, **settings)
    return done, trace.rows()


def test_trace_changes_nothing():
    assert traced(laps=1)[0] == evaluated(laps=1)


def test_trace_has_the_nineteen_columns_in_order(tmp_path):
    trace = Trace()
    evaluated(watch=trace.add, laps=1)
    lines = trace.write(tmp_path / "new" / "trace.csv").read_text().splitlines()
    assert lines[0] == (
        "episode,steps,X,Y,yaw,steer,throttle,action,reward,done,all_wheels_on_track,progress,"
        "closest_waypoint,track_len,tstamp,episode_status,pause_duration,obstacle_crash_counter,"
        "wall_clock"
    )
    # Readers of the older files count commas: no field may hold one.
    assert {line.count(",") for line in lines} == {18}
    (first, *_) = csv.DictReader(lines)
    assert tuple(first) == COLUMNS
    assert (first["episode"], first["steps"], first["done"]) == ("0", "1", "False")


def test_trace_counts_episodes_from_0_and_steps_from_1():
    done, rows = traced(laps=2, trials=2)
    assert [row["episode"] for row in rows if row["steps"] == 1] == [0, 1, 2, 3]
    ends = [row for row in rows if row["done"]]
    assert [row["episode_status"] for row in ends] == ["lap_complete"] * 4
    assert [row["progress"] for row in ends] == [100.0] * 4
    # A lap of t seconds that begins on a step takes ceil(15 t) steps.
    assert ends[0]["steps"] == math.ceil(done.trials[0].time_s * 15)
    times = [row["tstamp"] for row in rows]
    assert times == pytest.approx([(k + 1) / 15 for k in range(len(rows))], abs=1e-5)
    assert rows[-1]["wall_clock"] == pytest.approx(1000.0 + times[-1], abs=1e-5)


def test_trace_tells_the_nose_in_degrees_and_metres():
    # Along +x from (0.2, 0) on the straight, nose 0.14 m ahead of the base.
    _, rows = traced(track=make_straight(), laps=1)
    first = rows[0]
    assert 0.34 < first["X"] < 0.36
    assert first["Y"] == pytest.approx(0.0, abs=1e-6)
    assert first["yaw"] == pytest.approx(0.0, abs=1e-3)
    assert first["throttle"] == pytest.approx(1.5, abs=1e-5)
    assert first["track_len"] == pytest.approx(10.0)
    assert first["all_wheels_on_track"] is True
    # A lap of an open track ends 0.3 m before it does: 9.7 m; it began at 0.
    half = min(rows, key=lambda row: abs(row["X"] - 4.85))
    assert half["progress"] == pytest.approx(100 * half["X"] / 9.7, abs=0.01)
    # Waypoints every 10/67 m, the nearer of two.
    assert half["closest_waypoint"] == round(half["X"] / (10 / 67))


def test_trace_tells_yaw_and_steering_to_the_left_as_positive():
    # A quarter of the ring's 12 m further the car heads along +y.
    _, rows = traced(laps=1)
    quarter = min(rows, key=lambda row: abs(row["progress"] - 25 - 100 * 0.14 / RING_LENGTH))
    assert quarter["yaw"] == pytest.approx(90.0, abs=4.0)
    # A radius of 1.91 m asks for atan(0.164 / 1.91) = 4.9 degrees to the left.
    assert quarter["steer"] == pytest.approx(4.9, abs=0.5)
    _, rows = traced(track=make_ring(clockwise=True), laps=1)
    quarter = min(rows, key=lambda row: abs(row["progress"] - 26.2))
    assert quarter["yaw"] == pytest.approx(-90.0, abs=4.0)
    assert quarter["steer"] == pytest.approx(-4.9, abs=0.5)


def test_trace_tells_a_mistake_and_the_pause_after_it():
    _, rows = traced(Follower(leaves=(10, 20)), laps=1)
    (fault,) = (k for k, row in enumerate(rows) if row["episode_status"] == "off_track")
    assert rows[fault]["pause_duration"] == 2.0
    assert rows[fault]["all_wheels_on_track"] is False
    assert rows[fault]["done"] is False
    pause = [row for row in rows if row["episode_status"] == "pause"]
    assert len(pause) == 30  # 2 s
    assert all(row["reward"] == 0.0 for row in pause)
    assert [row["pause_duration"] for row in pause[:2]] == pytest.approx([29 / 15, 28 / 15])
    statuses = {row["episode_status"] for row in rows}
    assert statuses == {"in_progress", "off_track", "pause", "lap_complete"}


def test_trace_of_an_episode_ends_with_the_mistake():
    _, rows = traced(Follower(leaves=(60, 75)), mode="episode", laps=2)
    ends = [row for row in rows if row["done"]]
    assert [(row["episode"], row["episode_status"]) for row in ends] == [
        (0, "off_track"),
        (1, "off_track"),
    ]
    assert rows[-1] is ends[-1]
    again = [row for row in rows if row["episode"] == 1]
    assert (again[0]["steps"], again[0]["X"]) == (1, rows[0]["X"])


def test_trace_counts_crashes_with_obstacles_where_they_happened():
    boxes = ObstacleConfig(count=1, places=((0.25, 0.0),))
    rules = RaceRules(crash_penalty_s=1.0, max_time_s=10.0)
    done, rows = traced(kind="obstacle_avoidance", obstacles=boxes, laps=1, rules=rules)
    assert done.crashes >= 1
    crash = next(row for row in rows if row["episode_status"] == "crashed")
    assert crash["obstacle_crash_counter"] == 1
    assert crash["pause_duration"] == 1.0
    # It is placed where it crashed, not 1 m behind the box, where the car is put: the nose is at
    # the rear of the box, 0.2 m before a quarter of the ring.
    assert crash["progress"] == pytest.approx(100 * (3.0 - 0.2) / RING_LENGTH, abs=1.5)
    assert rows[-1]["obstacle_crash_counter"] == done.crashes


def test_trace_tells_the_action_as_a_pair_or_as_the_index_of_a_choice():
    _, rows = traced(laps=1)
    steer, throttle = (float(part) for part in str(rows[30]["action"]).strip("[]").split(" "))
    assert steer == pytest.approx(rows[30]["steer"], abs=1e-3)
    assert throttle == pytest.approx(1.5, abs=1e-3)
    space = DiscreteActions(((0.0, 0.5), (5.0, 1.5), (-5.0, 1.5)))
    _, rows = traced(laps=1, space=space)
    assert rows[30]["action"] == 1


def test_trace_pays_by_the_reward_that_was_asked_for():
    made = []

    def reward(num_worlds: int) -> BuiltIn:
        made.append(num_worlds)
        return BuiltIn(RewardConfig(progress=10.0))

    _, rows = traced(laps=1, trials=2, reward=reward)
    assert made == [2]
    assert rows[30]["reward"] == pytest.approx(10 * 1.5 / 15, abs=0.05)  # 0.1 m in a step
    _, plain = traced(laps=1)
    assert rows[30]["reward"] == pytest.approx(10 * plain[30]["reward"], rel=1e-4)


def test_nearer_waypoint_is_the_nearer_of_the_two():
    points = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)]
    assert nearer(points, [0, 1], 0.4, 0.3) == 0
    assert nearer(points, [0, 1], 0.6, 0.3) == 1
    assert nearer(points, [1, 2], 1.0, 0.5) == 1
