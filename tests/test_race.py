"""One race, from its spec to the classification."""

import math
import time
from dataclasses import dataclass, field

import numpy as np
import pytest

from league.agents import roster
from league.agents.policy import Policy
from league.errors import ConfigError, LeagueError
from league.race_spec import CarResult, Entry, RaceResult, RaceSpec, checked
from league.racing import race, race_log
from league.sim.config import CameraConfig, CarConfig, LidarConfig, SensorConfig
from league.track import files
from league.track.track import TrackSet
from tests.agents.trained import make_checkpoint
from tests.scenes import follow_center, make_ring, make_square, make_straight


@dataclass
class Follower:
    """Follows the centreline at a speed; from some step on its answers are something else."""

    name: str = "follower"
    speed: float = 1.5
    lateral: float = 0.0
    answers: list = field(default_factory=list)
    sensors: SensorConfig = field(default_factory=SensorConfig)
    steps: int = 0

    def reset(self, rows):
        self.steps = 0

    def act(self, observations):
        self.steps += 1
        if self.steps <= len(self.answers) and self.answers[self.steps - 1] is not None:
            return self.answers[self.steps - 1]
        return follow_center(observations, self.speed, self.lateral)


@dataclass
class Peeping(Follower):
    """Steers a little by what its sensors read."""

    groups: set = field(default_factory=set)

    def act(self, observations):
        self.groups |= set(observations)
        answer = super().act(observations)
        for name in {"stereo", "lidar"} & set(observations):
            pixel = observations[name].reshape(len(answer), -1)[:, 7].astype(np.float32)
            answer[:, 0] = (answer[:, 0] + pixel * 1e-3).clip(-1, 1)
        return answer


def raced(*drivers, track=None, **settings) -> RaceResult:
    entries = tuple(Entry(name=driver.name) for driver in drivers)
    kind = "time_trial" if len(drivers) == 1 else "head_to_head"
    spec = RaceSpec(**{"entries": entries, "kind": kind, "laps": 1, "solver": "planar"} | settings)
    return race.run(spec, track=track or make_ring(), drivers=drivers, record=False).result


def abreast() -> tuple[Follower, Follower]:
    """Return a slow driver and a fast one that passes it on the other lane."""
    return Follower("slow", 1.5, lateral=-0.2), Follower("fast", 2.0, lateral=0.2)


def kinds(result: RaceResult) -> list[str]:
    return [event.kind for event in result.events]


@pytest.mark.parametrize("solver", ["planar", "bullet"])
def test_faster_driver_wins(solver):
    result = raced(*abreast(), solver=solver, laps=2)
    first, second = result.order
    assert (first.name, first.place, second.place) == ("fast", 1, 2)
    assert first.finished
    assert second.finished
    assert len(first.lap_times_s) == first.laps == 2
    assert math.fsum(first.lap_times_s) == pytest.approx(first.total_s, abs=1e-3)
    assert first.best_lap_s == min(first.lap_times_s)
    assert result.race_s == pytest.approx(result.steps / 15, abs=1e-4)
    assert result.race_s - 1 / 15 <= second.total_s <= result.race_s
    assert first.overtakes == 1
    assert result.lead_changes == 1


def test_events_tell_the_race_in_the_order_of_time():
    result = raced(*abreast(), laps=2)
    times = [event.time_s for event in result.events]
    assert times == sorted(times)
    assert kinds(result)[0] == "start"
    assert kinds(result).count("lap") == 4
    assert kinds(result).count("finish") == 2
    overtakes = [event for event in result.events if event.kind == "overtake"]
    assert [(event.car, event.other) for event in overtakes] == [(1, 0)]
    lead = next(event for event in result.events if event.kind == "lead_change")
    assert lead.car == 1
    for event in result.events:
        if event.kind == "lap":
            assert event.value in result.order[0 if event.car == 1 else 1].lap_times_s


def test_car_off_the_track_loses_its_penalty_and_is_put_back():
    straight_on = [np.array([[0.0, 0.0]])] * 30
    result = raced(Follower(answers=straight_on))
    car = result.order[0]
    assert (car.off_tracks, car.penalty_s) == (1, 2.0)
    off, back = (
        next(e for e in result.events if e.kind == kind) for kind in ("off_track", "put_back")
    )
    assert back.time_s - off.time_s == pytest.approx(2.0, abs=1e-3)
    clean = raced(Follower()).order[0]
    assert car.total_s > clean.total_s + 2.0


def test_penalties_are_as_long_as_the_spec_says():
    straight_on = [np.array([[0.0, 0.0]])] * 30
    result = raced(Follower(answers=straight_on), off_track_penalty_s=3.0)
    assert result.order[0].penalty_s == 3.0
    off, back = (
        next(e for e in result.events if e.kind == kind) for kind in ("off_track", "put_back")
    )
    assert back.time_s - off.time_s == pytest.approx(3.0, abs=1e-3)


def test_contacts_given_are_contacts_taken():
    drivers = [Follower("a", 0.8), Follower("b", 1.5), Follower("c", 2.5)]
    result = raced(*drivers, crash_penalty_s=1.0, rules="deepracer")
    crashes = sum(kind == "crash" for kind in kinds(result))
    assert crashes > 0
    assert sum(car.crashes for car in result.order) == crashes
    taken = sum(car.contacts_taken for car in result.order)
    assert taken == kinds(result).count("contact")
    assert 0 < taken <= crashes


@pytest.mark.parametrize(
    "answer",
    [
        None.__class__,
        np.array([[float("nan"), 0.0]]),
        np.array([[2.0, 0.0]]),
        np.zeros(2),
        np.zeros((1, 2), bool),
        np.zeros((1, 2), np.complex64),
        "left",
    ],
    ids=["nothing", "nan", "range", "shape", "bool", "complex", "text"],
)
def test_answer_that_is_no_action_is_replaced_by_the_last_one_and_reported(answer):
    result = raced(Follower(answers=[None] * 10 + [answer] * 5))
    assert kinds(result).count("driver_fault") == 5
    assert result.order[0].finished


def test_driver_that_keeps_failing_is_retired_and_the_others_race_on():
    result = raced(Follower("broken", answers=["no"] * 100), Follower("fine"))
    assert [car.name for car in result.order] == ["fine", "broken"]
    assert result.order[0].finished
    assert not result.order[1].finished
    assert kinds(result).count("driver_fault") == race.FAULTS_TO_END


def test_an_answer_that_comes_too_late_is_as_good_as_none():
    class Slow(Follower):
        def act(self, observations):
            answer = super().act(observations)
            until = time.thread_time() + 0.05
            while time.thread_time() < until:
                pass
            return answer

    late = race.run_together([contest((Slow("late"), Follower("fine")))], patience_s=0.04)
    none = race.run_together(
        [contest((Follower("late", answers=["no"] * 100), Follower("fine")))], patience_s=0.04
    )
    assert late[0].result == none[0].result
    assert kinds(late[0].result).count("driver_fault") == race.FAULTS_TO_END
    assert [car.name for car in late[0].result.order] == ["fine", "late"]


def test_race_ends_when_all_drivers_are_retired():
    result = raced(Follower(answers=["no"] * 100))
    assert result.steps == race.FAULTS_TO_END
    assert not result.order[0].finished


def test_race_is_stopped_after_its_time_and_ranked_by_distance():
    result = raced(Follower("slow", 0.5), Follower("fast", 2.0), laps=50, max_time_s=12.0)
    assert result.steps == 180
    assert [car.finished for car in result.order] == [False, False]
    assert result.order[0].distance > result.order[1].distance
    assert result.order[0].total_s == 12.0


@pytest.mark.parametrize("solver", ["planar", "bullet"])
def test_a_pursuit_is_won_by_who_drives_its_own_laps_first(solver):
    # Half a lap, 6 m, is what the fast one gains in 24 m: it passes once and is home first.
    slow, fast = abreast()
    result = raced(slow, fast, solver=solver, laps=3, format="pursuit")
    assert [car.name for car in result.order] == ["fast", "slow"]
    assert all(car.finished and len(car.lap_times_s) == 3 for car in result.order)
    assert [car.overtakes for car in result.order] == [1, 0]
    assert [event.other for event in result.events if event.kind == "overtake"] == [0]
    # It led by its own laps long before it had caught the other.
    lead = next(event for event in result.events if event.kind == "lead_change")
    caught = next(event for event in result.events if event.kind == "overtake")
    assert lead.car == 1 and lead.time_s < caught.time_s / 2


def test_qualifying_orders_the_grid_by_the_best_lap_alone():
    entries = tuple(Entry(name=name) for name in ("centerline", "racing_line", "cautious"))
    spec = RaceSpec(entries=entries, solver="planar", format="qualifying", obstacles=3)
    laps = race.qualifying_laps(spec, files.load("reinvent_2018"))
    assert laps[1] < laps[2] < laps[0] < 12.0
    assert [entry.name for entry in race.line_up(spec, laps).entries] == [
        "racing_line", "cautious", "centerline"
    ]  # fmt: skip
    backwards = spec.model_copy(update={"format": "reverse"})
    names = [entry.name for entry in race.line_up(backwards, laps).entries]
    assert names == ["centerline", "cautious", "racing_line"]
    # Who has no lap counts as slowest; equals stay as they were named.
    level = race.line_up(spec, [float("inf"), 5.0, 5.0]).entries
    assert [entry.name for entry in level] == ["racing_line", "cautious", "centerline"]


def test_open_track_is_raced_to_its_end():
    result = raced(Follower("a"), Follower("b", 1.0), track=make_straight(), laps=3)
    assert [car.laps for car in result.order] == [1, 1]
    assert all(car.finished for car in result.order)


def test_the_rules_a_race_names_decide_what_a_contact_costs():
    found = {}
    for rules in ("league", "deepracer"):
        field = (Follower("slow", 1.0), Follower("quick", 1.25))
        found[rules] = raced(*field, track=make_straight(), rules=rules, max_time_s=6.0)
    nudge = next(event for event in found["league"].events if event.kind == "touch")
    assert (nudge.car, nudge.other) == (1, 0)
    assert nudge.value == pytest.approx(0.25, abs=0.1)
    league, deepracer = ({car.car: car for car in one.order} for one in found.values())
    assert (league[1].touches, league[1].crashes, league[1].penalty_s) == (1, 0, 0.0)
    assert (deepracer[1].touches, deepracer[1].crashes, deepracer[1].penalty_s) == (0, 1, 5.0)
    assert [e.kind for e in found["league"].events].count("contact") == league[0].contacts_taken


@pytest.mark.parametrize("kind", ["box", "bot"])
def test_several_cars_race_round_obstacles(kind):
    result = raced(
        Follower("a"), Follower("b", 2.0), Follower("c", 1.0),
        obstacles=3, obstacle_kind=kind, track=make_square(), max_time_s=20.0,
    )  # fmt: skip
    assert {event.car for event in result.events if event.kind == "obstacle_contact"}


@pytest.mark.parametrize("kind", ["box", "bot"])
def test_obstacles_are_raced_round_or_run_into_and_the_race_goes_on(kind):
    result = raced(
        Follower(),
        kind="obstacle_avoidance",
        obstacles=3,
        obstacle_kind=kind,
        track=make_square(),
        max_time_s=30.0,
    )
    hits = [event for event in result.events if event.kind == "obstacle_contact"]
    assert len(hits) == result.order[0].crashes
    assert all(event.other in (0, 1, 2) for event in hits)


@pytest.mark.parametrize(
    ("kind", "drivers", "said"),
    [
        ("head_to_head", 1, "name 2 to 8"),
        ("time_trial", 2, "driven alone"),
    ],
)
def test_wrong_number_of_drivers_is_refused_with_a_way_out(kind, drivers, said):
    entries = tuple(Entry(name="centerline") for _ in range(drivers))
    with pytest.raises(ConfigError, match=said):
        race.run(RaceSpec(kind=kind, entries=entries), track=make_ring())


def test_drivers_and_entries_must_be_as_many():
    spec = RaceSpec(kind="time_trial", entries=(Entry(name="a"),))
    with pytest.raises(ConfigError, match="2 drivers for 1"):
        race.run(spec, track=make_ring(), drivers=[Follower(), Follower()])


@pytest.mark.parametrize("name", ["centerlin", "../../etc/passwd", "nobody.pt"])
def test_unknown_driver_is_an_error_a_user_can_read(name):
    spec = RaceSpec(kind="time_trial", entries=(Entry(name=name),))
    with pytest.raises(LeagueError):
        race.run(spec, track=make_ring())


# Races run together.


def together(*contests: race.RaceJob) -> None:
    """Check that these races go together, to the bit, as each goes alone."""
    both = race.run_together(contests)
    assert len(both) == len(contests)
    for contest, found in zip(contests, both, strict=True):
        (alone,) = race.run_together([contest])
        assert found.result == alone.result
        assert found.replay is not None and alone.replay is not None
        assert found.replay.columns.checksum.tolist() == alone.replay.columns.checksum.tolist()


def contest(drivers, *, seed: int = 1, track=None, **settings) -> race.RaceJob:
    entries = tuple(Entry(name=driver.name) for driver in drivers)
    asked = {"laps": 1, "solver": "planar", "variation": 1.0, "max_time_s": 12.0} | settings
    spec = RaceSpec(entries=entries, seed=seed, **asked)
    return race.RaceJob(spec, track or make_ring(), drivers)


@pytest.mark.parametrize("solver", ["planar", "bullet"])
def test_races_run_together_go_to_the_bit_as_alone_though_one_ends_first(solver):
    slow, fast = abreast()
    quick, ram = Follower("quick", 3.0), Follower("ram", 3.0)
    ring, square = make_ring(), make_square()
    contests = (
        contest((slow, fast), track=ring, solver=solver),
        contest((quick, ram), seed=2, track=square, solver=solver),
        contest((fast, slow), seed=3, track=ring, solver=solver),
    )
    steps = {one.result.steps for one in race.run_together(contests)}
    assert len(steps) > 1
    together(*contests)


def test_drivers_of_races_run_together_may_carry_other_sensors():
    sees = Peeping("sees", sensors=SensorConfig(CameraConfig(width=24, height=16)))
    hears = Peeping("hears", sensors=SensorConfig(lidar=LidarConfig()))
    together(
        contest((sees, hears, Follower("blind")), max_time_s=3.0),
        contest((hears, Follower("blind"), sees), seed=2, max_time_s=3.0),
    )
    assert sees.groups == {"stereo", "motion", "state"}
    assert hears.groups == {"lidar", "motion", "state"}


def test_scripted_drivers_with_seats_in_two_races_remember_each_of_them():
    tracks = TrackSet(files.load("reinvent_2018"))
    one, two = (roster.load(name, tracks, CarConfig()) for name in ("racing_line", "blocker"))
    asked = {"track": tracks.tracks[0], "max_time_s": 4.0}
    together(contest((one, two), **asked), contest((two, one), seed=2, **asked))


def test_policies_that_remember_race_together_as_alone():
    one, two = (Policy(make_checkpoint("remembering", seed=seed), CarConfig()) for seed in (1, 2))
    together(
        contest((one, two), max_time_s=4.0),
        contest((two, one), seed=2, max_time_s=4.0),
    )


def test_a_driver_is_asked_once_a_step_for_all_its_cars():
    both, other = Follower("both"), Follower("other")
    finished = race.run_together(
        [contest((both, other), max_time_s=1.0), contest((other, both), seed=2, max_time_s=1.0)]
    )
    assert [one.result.steps for one in finished] == [15, 15]
    assert both.steps == other.steps == 15


def test_driver_that_fails_in_one_race_is_retired_there_alone():
    class HalfBroken(Follower):
        def act(self, observations):
            answer = super().act(observations)
            answer[0] = math.nan
            return answer

    half = HalfBroken("half")
    races = race.run_together(
        [contest((half, Follower("a"))), contest((half, Follower("b")), seed=2)]
    )
    faults = [kinds(one.result).count("driver_fault") for one in races]
    assert faults == [race.FAULTS_TO_END, 0]
    assert races[0].result.order[-1].name == "half"
    distances = [
        next(car.distance for car in one.result.order if car.name == "half") for one in races
    ]
    assert distances[0] < 1.0 < distances[1]


def test_races_with_other_settings_are_not_run_together():
    with pytest.raises(ConfigError, match="seeds 1 and 2 have other settings"):
        race.run_together([contest(abreast()), contest(abreast(), seed=2, laps=2)])


def test_no_races_are_run_together_at_once():
    assert race.run_together([]) == []


# The classification by hand.


def result_of(**car) -> CarResult:
    settings = {
        "car": 0, "name": "x", "place": 1, "finished": True, "laps": 3, "total_s": 30.0,
        "lap_times_s": (10.0, 10.0, 10.0), "distance": 36.0, "off_tracks": 0, "crashes": 0,
        "contacts_taken": 0, "immobilised": 0, "reversed": 0, "penalty_s": 0.0, "overtakes": 0,
    }  # fmt: skip
    return CarResult(**settings | car)


A = result_of(car=0, total_s=31.0, lap_times_s=(8.0, 11.0, 12.0))
B = result_of(car=1, total_s=30.0, lap_times_s=(10.0, 10.0, 10.0))
SLOW = result_of(
    car=2, finished=False, laps=2, total_s=40.0, lap_times_s=(7.0, 33.0), distance=30.0
)
STUCK = result_of(car=3, finished=False, laps=0, total_s=40.0, lap_times_s=(), distance=9.0)


@pytest.mark.parametrize(
    ("ranking", "order"),
    [
        ({"ranking": "total"}, [1, 0, 2, 3]),
        ({"ranking": "best"}, [2, 0, 1, 3]),
        # The best two laps in a row: 9.5, 10 and 20 s; all three are the total.
        ({"ranking": "average"}, [0, 1, 2, 3]),
        ({"ranking": "average", "average_laps": 1}, [2, 0, 1, 3]),
        ({"ranking": "average", "average_laps": 3}, [1, 0, 2, 3]),
        ({"ranking": "average", "average_laps": 9}, [1, 0, 2, 3]),
    ],
)
def test_ranking_by_total_best_or_mean_of_consecutive_laps(ranking, order):
    spec = RaceSpec(**ranking, entries=(Entry(name="x"),))
    placed = sorted([STUCK, SLOW, A, B], key=lambda car: race_log.merit(spec, car))
    assert [car.car for car in placed] == order


def test_equal_times_are_ranked_by_mistakes_then_by_the_grid():
    spec = RaceSpec(entries=(Entry(name="x"),))
    clean = result_of(car=2)
    careless, lucky = result_of(car=0, off_tracks=1), result_of(car=1)
    placed = sorted([clean, careless, lucky], key=lambda car: race_log.merit(spec, car))
    assert [car.car for car in placed] == [1, 2, 0]


@pytest.mark.parametrize("name", ["\x1b[31mred", "two\nlines", "\u202eesrever", "\x9b1m"])
def test_a_name_that_would_act_on_a_terminal_is_refused(name):
    with pytest.raises(ConfigError, match=r"a driver's name is .*: give .* printable characters"):
        checked({"entries": [{"name": name}]})
    assert checked({"entries": [{"name": "Zoë [/x]"}]}).entries[0].name == "Zoë [/x]"
