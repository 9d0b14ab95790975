"""Each key of params by hand, on a straight of 10 m and a ring of 12 m, both 0.8 m wide."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from scipy.spatial import KDTree

from league.deepracer import params_kernels
from league.deepracer.params import KEYS, ParamsBuilder, Roads
from league.sim.config import RULES, ObstacleConfig, RaceRules, SimConfig
from league.track import importer
from league.track.track import TrackSet
from tests.scenes import Stages, go_to, make_ring, make_straight, put_cars, touch

SHARED = Path(__file__).parents[3] / "shared" / "tracks"
COMMUNITY = sorted(SHARED.glob("*.npy")) if SHARED.is_dir() else []
ALONE = SimConfig(rules=RaceRules(laps=1))
TWO = SimConfig(kind="head_to_head", num_cars=2, rules=replace(RULES["deepracer"], laps=1))
BOXES = SimConfig(
    kind="obstacle_avoidance",
    obstacles=ObstacleConfig(count=2, places=((0.25, 1.0), (0.75, -1.0))),
)
RADIUS = 6.0 / math.pi
NOSE = RADIUS * math.atan(0.14 / RADIUS)  # how far round the ring the nose is ahead: 0.13975
"""Along the ring; across it the nose of a car on the centreline is 5.1 mm outside."""


class Scene:
    """Asks for params step after step, as an environment would."""

    def __init__(self, tracks, sim, start, *, car=0, num_worlds=1):
        self.tracks, self.sim, self.car = tracks, sim, car
        self.builder = ParamsBuilder(sim, (car,))
        self.world = put_cars(tracks, sim, start, num_worlds=num_worlds)
        self.restart()

    def restart(self):
        self.builder.restart(np.ones(self.world.cars.shape, bool))

    def step(self, end, *, pairs=(), speed=1.0, asked=(0.0, 1.0), hits=(), yaw=None):
        after = go_to(self.tracks, self.world, end, speed=speed)
        after.cars["target_steering"], after.cars["target_speed"] = asked
        if yaw is not None:
            after.cars["yaw"] = yaw
        contacts = touch(after, *pairs, obstacles=hits)
        verdicts, after = Stages(self.tracks, self.sim).judge(self.world, after, contacts)
        rows = self.builder.rows(self.tracks, self.world, after, verdicts)
        self.world = after
        return [params for _, _, params in rows]


def alone(tracks, start, end, **options):
    return Scene(tracks, ALONE, [start]).step([end], **options)[0]


@pytest.mark.parametrize("num_worlds", [1, 3])
def test_there_are_27_keys_of_plain_python_types(ring, num_worlds):
    rows = Scene(ring(), BOXES, [(1.0, 0.0)], num_worlds=num_worlds).step([(1.1, 0.0)])
    assert len(rows) == num_worlds
    assert len(KEYS) == 27
    for params in rows:
        assert tuple(sorted(params)) == KEYS
        for key, value in params.items():
            wanted = bool if key.startswith(("is_", "all_", "object_in")) else float
            if key == "steps":
                wanted = int
            elif key.startswith(("closest", "objects", "waypoints")):
                wanted = list
            assert type(value) is wanted, key
        assert all(type(one) is int for one in params["closest_objects"])
        assert all(type(one) is int for one in params["closest_waypoints"])
        assert all(type(one) is tuple and type(one[0]) is float for one in params["waypoints"])
        assert all(type(one) is list for one in params["objects_location"])
        assert all(type(one) is bool for one in params["objects_left_of_center"])


def test_place_is_that_of_the_nose_14_cm_ahead_of_the_base(straight):
    params = alone(straight(), (2.9, 0.1), (3.0, 0.1))
    assert (params["x"], params["y"]) == pytest.approx((3.14, 0.1), abs=1e-6)
    assert params["heading"] == pytest.approx(0.0)
    assert params["distance_from_center"] == pytest.approx(0.1, abs=1e-6)
    assert params["projection_distance"] == pytest.approx(3.14, abs=1e-5)
    assert params["is_left_of_center"] is True
    assert params["track_width"] == pytest.approx(0.8)
    assert params["track_length"] == pytest.approx(10.0)


def test_nose_turns_with_the_car(straight):
    params = alone(straight(), (3.0, 0.0), (3.0, 0.0), yaw=math.pi / 2)
    assert (params["x"], params["y"]) == pytest.approx((3.0, 0.14), abs=1e-6)
    assert params["heading"] == pytest.approx(90.0, abs=1e-4)
    assert params["distance_from_center"] == pytest.approx(0.14, abs=1e-6)


def test_heading_backwards_is_180_and_not_minus_180(straight):
    assert alone(straight(), (3.0, 0.0), (3.0, 0.0), yaw=-math.pi)["heading"] == 180.0


def test_nose_leaves_the_centreline_of_a_bend_to_the_outside(ring):
    outside = math.hypot(RADIUS, 0.14) - RADIUS
    params = alone(ring(), (2.9, 0.0), (3.0, 0.0))
    assert params["distance_from_center"] == pytest.approx(outside, abs=2e-4)
    assert params["projection_distance"] == pytest.approx(3.0 + NOSE, abs=1e-3)
    assert params["is_left_of_center"] is False  # the outside of a left bend is on the right
    assert alone(ring(clockwise=True), (2.9, 0.0), (3.0, 0.0))["is_left_of_center"] is True


@pytest.mark.parametrize("clockwise", [False, True])
@pytest.mark.parametrize("lateral", [0.2, -0.2])
def test_left_is_the_drivers_left_whichever_way_round(ring, clockwise, lateral):
    params = alone(ring(clockwise=clockwise), (2.9, lateral), (3.0, lateral))
    assert params["is_left_of_center"] is (lateral > 0)
    assert params["is_reversed"] is clockwise


@pytest.mark.parametrize(
    ("lateral", "all_on", "off"),
    # Wheels are 8 cm to either side of the base, and the road ends at 40 cm.
    [(0.0, True, False), (0.31, True, False), (0.33, False, False), (0.47, False, False),
     (0.49, False, True), (-0.33, False, False), (-0.49, False, True)],
)  # fmt: skip
def test_one_wheel_ends_all_wheels_and_four_make_offtrack(straight, lateral, all_on, off):
    params = alone(straight(), (2.9, lateral), (3.0, lateral))
    assert (params["all_wheels_on_track"], params["is_offtrack"]) == (all_on, off)


def test_waypoints_close_a_loop_by_repeating_the_first(ring):
    points = alone(ring(), (2.9, 0.0), (3.0, 0.0))["waypoints"]
    assert len(points) == 81  # 12 m in steps of 15 cm
    assert points[0] == points[-1] == pytest.approx((0.0, 0.0))
    assert points[20] == pytest.approx((RADIUS, RADIUS), abs=1e-3)  # a quarter of the way round
    assert points[1][0] > 0  # driving order


def test_waypoints_of_a_straight_end_at_its_end(straight):
    points = alone(straight(), (2.9, 0.0), (3.0, 0.0))["waypoints"]
    assert len(points) == 68
    assert points[0] == (0.0, 0.0)
    assert points[-1] == (10.0, 0.0)


def test_waypoints_of_a_clockwise_track_turn_right(ring):
    points = alone(ring(clockwise=True), (2.9, 0.0), (3.0, 0.0))["waypoints"]
    assert points[20] == pytest.approx((RADIUS, -RADIUS), abs=1e-3)


@pytest.mark.parametrize(
    ("base", "closest"),
    # Waypoints are 15 cm apart; the nose is 13.975 cm further round than the base.
    [(3.0, [20, 21]), (3.02, [21, 22]), (11.8, [79, 80]), (11.9, [0, 1])],
)
def test_closest_waypoints_are_behind_and_ahead_along_the_lap(ring, base, closest):
    assert alone(ring(), (base - 0.1, 0.0), (base, 0.0))["closest_waypoints"] == closest


def test_waypoint_after_the_last_one_is_the_first(straight):
    # At the very end of a straight there is nothing ahead.
    assert alone(straight(), (9.8, 0.0), (9.9, 0.0))["closest_waypoints"] == [67, 0]


def with_waypoints(track, *places):
    """Return a track with its own waypoints at these places, multiples of 5 cm."""
    rows = [round(20 * place) % len(track.center) for place in places]
    return replace(track, waypoints=track.center[rows])


def closest(roads, tracks, s, *, track=0):
    center = tracks[track].center
    line = np.vstack([center, center[:1]]) if tracks[track].closed else center
    x, y = (np.interp(20 * s, np.arange(len(line)), line[:, axis]) for axis in (0, 1))
    course = TrackSet(*tracks).courses[track]
    place = course, roads.records[track], s, float(x), float(y)
    pair = params_kernels.closest_waypoints(roads.own_waypoints, *place)
    return [int(one) for one in pair]


def test_waypoints_of_its_own_are_given_as_they_are():
    track = with_waypoints(make_ring(), 0, 3, 3, 6, 9, 12)
    params = alone(TrackSet(track), (2.9, 0.0), (3.0, 0.0))
    assert params["waypoints"] == [tuple(point) for point in track.waypoints.tolist()]
    assert len(params["waypoints"]) == 6
    assert (
        params["waypoints"][1]
        == params["waypoints"][2]
        == pytest.approx((RADIUS, RADIUS), abs=1e-3)
    )
    assert params["closest_waypoints"] == [2, 3]  # the nose is at 3.14 m
    earlier = alone(TrackSet(track), (2.7, 0.0), (2.8, 0.0))
    assert earlier["closest_waypoints"] == [0, 1]  # the nose is at 2.94 m


@pytest.mark.parametrize("first", [0.0, 1.5, 11.5])
@pytest.mark.parametrize("clockwise", [False, True])
@pytest.mark.parametrize(
    ("further", "pair"),
    # Waypoints 0, 1, 4, 4, 9 and 12 m from the first one; the last is the first again.
    [(0.0, [0, 1]), (0.99, [0, 1]), (1.0, [1, 2]), (1.01, [1, 2]), (3.99, [1, 2]), (4.0, [3, 4]),
     (8.99, [3, 4]), (9.0, [4, 5]), (11.99, [4, 5]), (12.0, [0, 1]), (12.01, [0, 1])],
)  # fmt: skip
def test_closest_of_a_tracks_own_waypoints_wherever_the_first_one_lies(
    first, clockwise, further, pair
):
    places = [first + place for place in (0, 1, 4, 4, 9, 12)]
    track = with_waypoints(make_ring(clockwise=clockwise), *places)
    assert closest(Roads.of(TrackSet(track)), [track], (first + further) % 12) == pair


@pytest.mark.parametrize(
    ("further", "pair"),
    # The other way round: 0, 3, 8, 8, 11 and 12 m from the first one.
    [(0.0, [0, 1]), (2.99, [0, 1]), (3.0, [1, 2]), (7.99, [1, 2]), (8.0, [3, 4]), (11.0, [4, 5]),
     (11.99, [4, 5])],
)  # fmt: skip
def test_closest_waypoints_of_a_reversed_track_count_the_other_way(further, pair):
    track = with_waypoints(make_ring(), 1.5, 2.5, 5.5, 5.5, 10.5, 13.5)
    back = track.reversed()
    roads = Roads.of(TrackSet(track, back))
    assert roads.waypoints[1] == roads.waypoints[0][::-1]
    # The first one is 1.5 m behind the start line now.
    assert closest(roads, [track, back], (10.5 + further) % 12, track=1) == pair


@pytest.mark.parametrize(
    ("s", "pair"),
    [(0.0, [0, 1]), (0.4, [0, 1]), (1.0, [0, 1]), (4.0, [2, 3]), (9.4, [2, 3]), (9.5, [3, 0]),
     (10.0, [3, 0])],
)  # fmt: skip
def test_closest_waypoints_of_a_straight_have_nothing_before_the_first_and_0_after_the_last(
    s, pair
):
    # They begin 0.5 m after the start and end 0.5 m before the end.
    track = with_waypoints(make_straight(), 0.5, 4, 4, 9.5)
    assert closest(Roads.of(TrackSet(track)), [track], s) == pair


def test_tracks_with_waypoints_of_their_own_and_without_stand_side_by_side():
    own = with_waypoints(make_ring(), 0, 1, 4, 4, 9, 12)
    other = with_waypoints(make_ring(), 0, 2, 7, 12)
    plain = make_straight()
    tracks = (own, plain, other, plain)
    roads = Roads.of(TrackSet(*tracks))
    pairs = [closest(roads, tracks, 4.6, track=number) for number in range(4)]
    # 67 stretches on 10 m: 4.6 m is the 30.8th.
    assert pairs == [[3, 4], [30, 31], [1, 2], [30, 31]]
    assert roads.waypoints[1] == Roads.of(TrackSet(plain)).waypoints[0]
    scene = Scene(TrackSet(own, other), ALONE, [(4.5, 0.0)], num_worlds=2)
    scene.world.worlds["track"] = 0, 1
    assert [row["closest_waypoints"] for row in scene.step([(4.6, 0.0)])] == [[3, 4], [1, 2]]


def test_no_two_closest_waypoints_are_the_same_place():
    # The first, the last and one in between come twice, as files have them.
    track = with_waypoints(make_ring(), 0, 0, 3, 3, 9, 12, 12)
    roads = Roads.of(TrackSet(track))
    for s in (0.0, 1.5, 3.0, 6.0, 9.0, 11.9999999, math.nextafter(12.0, 0.0), 12.0):
        behind, ahead = closest(roads, [track], s)
        assert roads.waypoints[0][behind] != roads.waypoints[0][ahead]


@pytest.mark.parametrize("path", COMMUNITY, ids=lambda path: path.stem)
def test_closest_waypoints_of_a_community_track_are_those_of_its_own_polyline(path):
    track = importer.read_npy(path)
    tracks, line = TrackSet(track), shapely.LineString(track.waypoints)
    roads = Roads.of(tracks)
    chords = np.linalg.norm(np.diff(track.waypoints, axis=0), axis=1)
    reached = np.concatenate([[0], chords.cumsum()])
    generator = np.random.default_rng(0)
    center = track.center[generator.integers(len(track.center), size=1000)]
    for x, y in center + generator.uniform(-0.3, 0.3, center.shape):
        nearest, s = KDTree(track.center).query((x, y))[1], line.project(shapely.Point(x, y))
        if np.abs(reached - s).min() > 1e-4:  # right at a waypoint rounding decides
            behind = int(np.searchsorted(reached, s)) - 1
            along = track.length * nearest / len(track.center)
            arguments = (roads.own_waypoints, tracks.courses[0], roads.records[0], along, x, y)
            assert params_kernels.closest_waypoints(*arguments) == (behind, behind + 1)


def test_speed_and_steering_are_what_was_asked_for_not_what_is(straight):
    asked = (math.radians(-15.0), 2.5)
    params = alone(straight(), (3.0, 0.0), (3.1, 0.0), speed=1.0, asked=asked)
    assert (params["speed"], params["steering_angle"]) == (2.5, -15.0)  # to the last bit


def test_steps_count_from_one_and_again_after_a_restart(straight):
    scene = Scene(straight(), ALONE, [(3.0, 0.0)])
    assert [scene.step([(3.0 + 0.1 * n, 0.0)])[0]["steps"] for n in (1, 2, 3)] == [1, 2, 3]
    scene.restart()
    assert scene.step([(3.4, 0.0)])[0]["steps"] == 1


def test_progress_is_counted_from_where_the_episode_began(ring):
    scene = Scene(ring(), ALONE, [(4.0, 0.0)])
    # 30 cm and 60 cm of 12 m are 2.5 and 5 %.
    assert scene.step([(4.3, 0.0)])[0]["progress"] == pytest.approx(2.5, abs=1e-3)
    assert scene.step([(4.6, 0.0)])[0]["progress"] == pytest.approx(5.0, abs=1e-3)
    scene.restart()
    assert scene.step([(4.9, 0.0)])[0]["progress"] == pytest.approx(2.5, abs=1e-3)


def test_progress_grows_across_the_start_line_and_falls_backwards(ring):
    scene = Scene(ring(), ALONE, [(11.7, 0.0)])
    scene.world.cars["best_distance"] = 13.0  # no lap ends here
    assert scene.step([(12.3, 0.0)])[0]["progress"] == pytest.approx(5.0, abs=1e-3)
    assert scene.step([(11.4, 0.0)])[0]["progress"] == pytest.approx(-2.5, abs=1e-3)


def test_progress_is_100_when_the_lap_is_complete_and_then_begins_anew(ring):
    two_laps = replace(ALONE, rules=RaceRules(laps=2))
    scene = Scene(ring(), two_laps, [(0.0, 0.0)])
    # As if it had been round: the book knows of 11.9 m.
    scene.world.cars[:] = put_cars(ring(), two_laps, [(11.9, 0.0)]).cars
    memory = scene.builder.memory
    memory["fresh"], memory["lead"] = False, NOSE
    before, at, after = (scene.step([(s, 0.0)])[0] for s in (11.95, 12.05, 12.17))
    assert before["progress"] == pytest.approx(100 * 11.95 / 12, abs=2e-3)
    assert at["progress"] == 100.0
    assert (at["steps"], after["steps"]) == (2, 1)
    assert after["progress"] == pytest.approx(100 * 0.17 / 12, abs=2e-3)


def test_progress_is_held_below_100_until_the_lap_is_counted(ring):
    scene = Scene(ring(), TWO, [(-0.75, 0.0), (-3.0, 0.0)])
    memory = scene.builder.memory
    memory["fresh"][:], memory["lead"][:], memory["start"][:] = False, NOSE, -0.75
    scene.world.cars[:] = put_cars(ring(), TWO, [(11.8, 0.0), (6.0, 0.0)]).cars
    params = scene.step([(11.9, 0.0), (6.1, 0.0)])[0]  # 12.65 m since the grid
    assert 99.999 < params["progress"] < 100.0


def test_time_is_of_the_simulation(straight):
    scene = Scene(straight(), ALONE, [(3.0, 0.0)])
    scene.step([(3.1, 0.0)])
    assert scene.step([(3.2, 0.0)])[0]["sim_time"] == pytest.approx(2 / 15)


def test_alone_all_object_lists_are_empty_and_closest_is_0_0(ring):
    params = alone(ring(), (2.9, 0.0), (3.0, 0.0))
    lists = [key for key in KEYS if key.startswith("objects_")]
    assert len(lists) == 6
    assert [params[key] for key in lists] == [[]] * 6
    assert params["closest_objects"] == [0, 0]
    assert params["object_in_camera"] is False
    assert params["is_crashed"] is False


def test_boxes_that_are_moved_by_a_restart_are_given_where_they_are_now(ring):
    scene = Scene(ring(), BOXES, [(4.9, 0.0)])
    first, again = (scene.step([(end, 0.0)])[0]["objects_location"] for end in (5.0, 5.1))
    assert again == first
    scene.world.obstacles["x"] += 0.5
    moved = scene.step([(5.2, 0.0)])[0]["objects_location"]
    assert moved == [pytest.approx([x + 0.5, y], abs=1e-6) for x, y in first]


def test_boxes_are_given_with_place_lane_and_heading(ring):
    params = Scene(ring(), BOXES, [(4.9, 0.0)]).step([(5.0, 0.0)])[0]
    assert params["objects_distance"] == pytest.approx([3.0, 9.0], abs=1e-3)
    # A quarter round the ring, 20 cm inside; three quarters, 20 cm outside.
    assert params["objects_location"][0] == pytest.approx([RADIUS - 0.2, RADIUS], abs=1e-3)
    assert params["objects_location"][1] == pytest.approx([-RADIUS - 0.2, RADIUS], abs=1e-3)
    assert params["objects_heading"] == pytest.approx([90.0, -90.0], abs=0.01)
    assert params["objects_left_of_center"] == [True, False]
    assert params["objects_distance_from_center"] == pytest.approx([0.2, 0.2], abs=1e-6)
    assert params["objects_speed"] == [0.0, 0.0]


@pytest.mark.parametrize(
    ("base", "closest"),
    [(1.0, [1, 0]), (2.8, [1, 0]), (2.9, [0, 1]), (8.0, [0, 1]), (10.0, [1, 0])],
)
def test_closest_objects_are_behind_and_ahead_of_the_nose_round_the_lap(ring, base, closest):
    params = Scene(ring(), BOXES, [(base - 0.1, 0.0)]).step([(base, 0.0)])[0]
    assert params["closest_objects"] == closest


def test_only_the_car_to_blame_has_crashed_and_only_in_that_step(ring):
    scene = Scene(ring(), BOXES, [(2.5, 0.2)])
    assert scene.step([(2.6, 0.2)])[0]["is_crashed"] is False
    assert scene.step([(2.7, 0.2)], hits=((0, 0),))[0]["is_crashed"] is True


@pytest.mark.parametrize(("car", "crashed"), [(0, True), (1, False)])
def test_of_two_cars_the_rear_one_crashed(ring, car, crashed):
    scene = Scene(ring(), TWO, [(3.0, 0.1), (3.3, 0.1)], car=car)
    (params,) = scene.step([(3.1, 0.1), (3.4, 0.1)], pairs=((0, 1),))
    assert params["is_crashed"] is crashed


def test_other_car_is_an_object_with_its_true_speed(ring):
    scene = Scene(ring(), TWO, [(3.0, 0.0), (5.9, -0.2)])
    (params,) = scene.step([(3.1, 0.0), (6.0, -0.2)], speed=1.5)
    assert params["objects_distance"] == pytest.approx([6.0], abs=1e-3)
    assert params["objects_location"][0] == pytest.approx([0.0, 2 * RADIUS + 0.2], abs=1e-3)
    assert params["objects_speed"] == pytest.approx([1.5])
    assert params["objects_heading"][0] == pytest.approx(180.0, abs=0.01)
    assert params["objects_left_of_center"] == [False]
    assert params["closest_objects"] == [0, 0]


def test_each_car_is_given_the_other_and_not_of_itself(ring):
    scene = Scene(ring(), TWO, [(3.0, 0.0), (5.9, -0.2)], car=1)
    (params,) = scene.step([(3.1, 0.0), (6.0, -0.2)])
    assert params["objects_distance"] == pytest.approx([3.1], abs=1e-3)


@pytest.mark.parametrize(
    ("gap", "lateral", "seen"),
    # At 30 cm from the lens half of the view is 30 * tan(32.4 deg) = 19 cm wide, at 2 m 127 cm.
    [(1.0, 0.0, True), (2.0, 0.35, True), (0.6, 0.38, False), (-1.0, 0.0, False)],
)
def test_next_object_is_in_the_camera_when_it_lies_in_its_view(straight, gap, lateral, seen):
    scene = Scene(straight(), TWO, [(4.9, -0.38), (4.9 + gap, lateral)])
    (params,) = scene.step([(5.0, -0.38), (5.0 + gap, lateral)])
    assert params["object_in_camera"] is seen


def test_car_that_stands_a_penalty_is_not_asked(ring):
    scene = Scene(ring(), ALONE, [(3.0, 0.0)])
    scene.world.cars["penalty_s"] = 2.0
    assert scene.step([(3.0, 0.0)]) == []


def test_speed_of_an_object_counts_both_axes(ring):
    scene = Scene(ring(), TWO, [(3.0, 0.0), (4.4, 0.0)])
    (params,) = scene.step([(3.1, 0.0), (4.5, 0.0)], speed=2.0)  # 135 deg round the ring
    assert params["objects_speed"] == pytest.approx([2.0])
    assert params["objects_heading"] == pytest.approx([135.0], abs=0.01)
