"""Contacts: who is to blame, what they cost, who was pushed off; by hand-built scenes.

Scenes of commands say where cars are before and after a step, and what touched; scenes that are
driven leave both to the planar solver and to Bullet.
"""

import numpy as np
import pytest

from league.envs.config import EnvConfig
from league.envs.race_env import RaceEnv
from league.sim.config import RULES, ObstacleConfig, RaceRules, SimConfig
from league.sim.records import NOBODY, members
from league.track.track import TrackSet
from tests.scenes import Stages, go_to, make_square, make_straight, put_cars, start, touch


def racing(num_cars: int = 2, **rules) -> SimConfig:
    return SimConfig(kind="head_to_head", num_cars=num_cars, rules=RaceRules(**rules))


def scene(
    tracks, sim, before, after, *pairs, moving=(), ghosts=(), facing=(), things=(), asked=4.0
):
    """Return the verdicts of a step and the world after it, judged and then penalised.

    Args:
        tracks: the course.
        sim: settings.
        before: place of each car along and across the track, or a world.
        after: the same after the step.
        pairs: cars that touched.
        moving: velocity of each car before the step, along the track and to the left [m/s].
        ghosts: cars that are ghosts before it.
        facing: cars that face against the track.
        things: (car, obstacle) that touched.
        asked: speed that all cars ask for [m/s].
    """
    world = put_cars(tracks, sim, before) if isinstance(before, list) else before.copy()
    cars = world.cars
    for car, (along, left) in enumerate(moving):
        frame = tracks.at(world.track, cars["s"][:, [car]])
        cars["velocity_x"][:, car] = (frame.cos * along - frame.sin * left)[:, 0]
        cars["velocity_y"][:, car] = (frame.sin * along + frame.cos * left)[:, 0]
    for car in facing:
        cars["yaw"][:, car] += np.pi
    for car in ghosts:
        cars["ghost"][:, car] = True
    cars["target_speed"] = asked
    stages = Stages(tracks, sim)
    contacts = touch(world, *pairs, obstacles=things)
    verdicts, judged = stages.judge(world, go_to(tracks, world, after), contacts)
    settled = judged.copy()
    settled = stages.settle(settled, verdicts)
    return verdicts[0], judged.cars[0], settled


def to_blame(verdicts: np.ndarray) -> list[int]:
    """Return the cars that are to blame for a contact."""
    return np.flatnonzero(verdicts["crashed"] | verdicts["touched"]).tolist()


# Behind or alongside.


@pytest.mark.parametrize("swap", [False, True])
@pytest.mark.parametrize(
    ("gap", "swerves", "blamed"),
    [
        # A car is 0.324 m long: alongside is an overlap of more than 0.081 m, a gap below 0.243.
        (0.30, "front", 0),  # behind: the rear car, though the one ahead moves across
        (0.25, "front", 0),
        (0.23, "front", 1),  # alongside: who moves across
        (0.23, "rear", 0),
        (0.02, "front", 1),  # two centimetres ahead
        (0.02, "rear", 0),
        (0.00, "front", 1),
    ],
)
def test_alongside_who_moves_across_is_to_blame_or_else_the_rear(ring, gap, swerves, blamed, swap):
    tracks, sim = ring(), racing()
    rear, front = (5.0, -0.12), (5.0 + gap, 0.12)
    moving = [(2.0, 0.6), (2.0, 0.0)] if swerves == "rear" else [(2.0, 0.0), (2.0, -0.6)]
    gone = [(5.13, -0.1), (5.13 + gap, 0.1)]
    places, order = [rear, front], [0, 1]
    if swap:
        places, gone, moving, order = places[::-1], gone[::-1], moving[::-1], [1, 0]
    seen, _, _ = scene(tracks, sim, places, gone, (0, 1), moving=moving)
    assert to_blame(seen) == [order[blamed]]
    assert seen["was_hit"].tolist() == [car != order[blamed] for car in (0, 1)]


def test_across_the_start_line_and_for_a_lapped_car_nothing_is_different(ring):
    tracks, sim = ring(), racing()
    for lap in (0.0, 12.0):
        # Alongside over the line; the inner car, on another lap or not, is pushed into.
        seen, _, _ = scene(
            tracks, sim, [(lap + 11.95, -0.12), (12.05, 0.12)], [(lap + 12.1, -0.1), (12.2, 0.12)],
            (0, 1), moving=[(2.0, 0.5), (2.0, 0.0)],
        )  # fmt: skip
        assert to_blame(seen) == [0]
        # The leader runs into the back of whoever he laps.
        seen, _, _ = scene(
            tracks, sim, [(lap + 11.6, 0.1), (12.0, 0.1)], [(lap + 11.75, 0.1), (12.05, 0.1)],
            (0, 1), moving=[(3.0, 0.0), (1.0, 0.0)],
        )  # fmt: skip
        assert to_blame(seen) == [0]
        assert seen["crashed"][0]


def test_swerve_that_begins_within_the_step_counts_by_how_far_the_cars_came(straight):
    tracks, sim = straight(), racing()
    # Both drive straight before the step; in it car 1 comes 2 cm nearer and pushes car 0 away.
    seen, _, _ = scene(
        tracks, sim, [(5.0, -0.11), (5.02, 0.11)], [(5.13, -0.12), (5.15, 0.09)],
        (0, 1), moving=[(2.0, 0.0), (2.0, 0.0)],
    )  # fmt: skip
    assert to_blame(seen) == [1]
    assert seen["closing_speed"][1] == pytest.approx(0.02 * 15, abs=1e-3)


def test_alongside_and_neither_moves_across_the_rear_car_is_to_blame(straight):
    tracks, sim = straight(), racing()
    still = [(2.0, 0.0), (2.0, 0.0)]
    seen, _, _ = scene(
        tracks, sim, [(5.0, -0.1), (5.1, 0.1)], [(5.1, -0.1), (5.2, 0.1)], (0, 1), moving=still
    )
    assert to_blame(seen) == [0]
    seen, _, _ = scene(
        tracks, sim, [(5.0, -0.1), (5.0, 0.1)], [(5.1, -0.1), (5.1, 0.1)], (0, 1), moving=still
    )
    assert to_blame(seen) == []  # exactly level
    assert not seen["to_blame"].any()


def test_car_across_the_road_is_short_so_whoever_hits_its_side_from_behind_is_behind(straight):
    # It covers 0.196 m of the track: with 0.27 m between the middles they do not overlap, and that
    # it moves across, towards the other, is no swerve.
    tracks, sim = straight(), racing()
    world = put_cars(tracks, sim, [(5.0, 0.05), (5.27, 0.0)])
    world.cars["yaw"][0, 1] = np.pi / 2
    seen, _, _ = scene(
        tracks, sim, world, [(5.05, 0.05), (5.29, 0.02)], (0, 1), moving=[(2.0, 0.0), (0.0, 0.6)]
    )
    assert to_blame(seen) == [0]


# The wrong way.


@pytest.mark.parametrize("gap", [0.3, 0.1, -0.1, -0.3])
def test_car_that_drives_against_the_track_is_always_to_blame(ring, gap):
    tracks, sim = ring(), racing()
    before, after = [(5.0, 0.1), (5.0 + gap, -0.1)], [(5.05, 0.1), (4.95 + gap, -0.1)]
    moving = [(2.0, 0.5), (-1.5, 0.0)]
    seen, _, _ = scene(tracks, sim, before, after, (0, 1), moving=moving, facing=[1])
    assert to_blame(seen) == [1]
    seen, _, _ = scene(
        tracks, sim, before, after, (0, 1), moving=[(-2.0, 0.0), (-1.5, 0.0)], facing=[0, 1]
    )
    assert to_blame(seen) == [0, 1]


def test_car_that_was_turned_round_or_knocked_back_does_not_drive_the_wrong_way(straight):
    tracks, sim = straight(), racing()
    before, after = [(5.0, 0.0), (5.35, 0.0)], [(5.05, 0.0), (5.36, 0.0)]
    # It faces backwards and stands, or rolls at 5 cm/s; it faces ahead and is thrown back.
    for speed, facing in (0.0, [1]), (-0.05, [1]), (-0.3, []):
        moving = [(2.0, 0.0), (speed, 0.0)]
        seen, _, _ = scene(tracks, sim, before, after, (0, 1), moving=moving, facing=facing)
        assert to_blame(seen) == [0]


# How hard.


@pytest.mark.parametrize("num_cars", [2, 3])
@pytest.mark.parametrize(
    ("closing", "seconds"),
    [
        (0.0, None),
        (0.29, None),
        (0.31, 1 / 15),
        (0.6, 1.25),
        (0.7, 25 / 15),
        (1.5, 5.0),
        (3.0, 5.0),
    ],
)
def test_penalty_grows_with_the_closing_speed(straight, closing, seconds, num_cars):
    # From 0 s at 0.3 m/s to 5 s at 1.5 m/s, in whole steps.
    tracks, sim = straight(), racing(num_cars)
    before = [(5.0, 0.0), (5.33, 0.0), (8.0, 0.0)][:num_cars]
    after = [(5.1, 0.0), (5.44, 0.0), (8.0, 0.0)][:num_cars]
    moving = [(1.0 + closing, 0.0), (1.0, 0.0)]
    seen, judged, world = scene(tracks, sim, before, after, (0, 1), moving=moving)
    assert seen["closing_speed"][0] == pytest.approx(closing, abs=1e-5)
    if seconds is None:
        assert (seen["touched"][0], seen["mistake"].any()) == (True, False)
        assert (judged["touches"][0], judged["crashes"][0]) == (1, 0)
        assert not world.cars["penalty_s"].any()
    else:
        assert (seen["touched"][0], seen["crashed"][0]) == (False, True)
        assert (judged["touches"][0], judged["crashes"][0]) == (0, 1)
        steps = round(seconds * 15)
        assert world.cars["penalty_s"][0, 0] == pytest.approx(steps / 15, abs=1e-6)
        assert seen["penalty_s"].tolist()[:2] == pytest.approx([steps / 15, 0.0], abs=1e-6)
    assert judged["contacts_taken"].tolist()[:2] == [0, 1]


@pytest.mark.parametrize(("left", "closing"), [(1.0, 0.5 / 0.13**0.5), (-1.0, 0.1 / 0.13**0.5)])
def test_cars_close_along_the_line_between_them(straight, left, closing):
    # From 0.3 m behind and 0.2 m to the right: (1, left) m/s along (3, 2) / sqrt(13).
    places = [(5.0, -0.1), (5.3, 0.1)]
    moving = [(1.0, left), (0.0, 0.0)]
    seen, _, _ = scene(straight(), racing(), places, places, (0, 1), moving=moving)
    assert seen["closing_speed"].tolist() == pytest.approx([closing, 0.0], abs=1e-4)


def test_both_cars_movement_counts_for_how_fast_they_close(straight):
    # Along (3, 2) / sqrt(13) again: by velocity (0.6, 1.6) m/s; by movement (0.06, 0.05) m a step.
    places, root = [(5.0, -0.1), (5.3, 0.1)], 13**0.5
    moving = [(1.0, 1.0), (0.4, -0.6)]
    seen, _, _ = scene(straight(), racing(), places, places, (0, 1), moving=moving)
    assert seen["closing_speed"].tolist() == pytest.approx([5.0 / root, 0.0], abs=1e-4)
    after = [(5.05, -0.08), (5.29, 0.07)]
    seen, _, _ = scene(straight(), racing(), places, after, (0, 1))
    assert seen["closing_speed"].tolist() == pytest.approx([0.28 * 15 / root, 0.0], abs=1e-4)


def test_cars_in_one_spot_close_at_no_speed(straight):
    # There is no line between them; the rear car is to blame for a touch, not for a crash.
    tracks, sim = straight(), racing(room=False)
    seen, _, _ = scene(
        tracks, sim, [(5.0, 0.0), (5.0, 0.0)], [(5.0, 0.0), (5.1, 0.0)], (0, 1),
        moving=[(2.0, 0.0), (1.0, 0.0)],
    )  # fmt: skip
    assert seen["touched"].tolist() == [True, False]
    assert not seen["closing_speed"].any()


def test_a_touch_that_lasts_is_counted_once(straight):
    tracks, sim = straight(), racing()
    world = put_cars(tracks, sim, [(3.0, 0.0), (3.33, 0.0)])
    for push in range(1, 4):
        places = [(3.0 + 0.07 * push, 0.0), (3.33 + 0.07 * push, 0.0)]
        contacts = touch(world, (0, 1))
        _, world = Stages(tracks, sim).judge(world, go_to(tracks, world, places), contacts)
    assert world.cars["touches"].tolist() == [[1, 0]]
    assert world.cars["contacts_taken"].tolist() == [[0, 1]]


def test_rubbing_alongside_costs_nothing_however_fast_one_passes(straight):
    tracks, sim = straight(), racing()
    seen, _, world = scene(
        tracks, sim, [(5.0, -0.1), (5.1, 0.1)], [(5.25, -0.1), (5.15, 0.1)],
        (0, 1), moving=[(4.0, 0.1), (1.0, 0.0)],
    )  # fmt: skip
    assert to_blame(seen) == [0]
    assert seen["closing_speed"][0] == pytest.approx(0.1, abs=1e-5)
    assert not world.cars["penalty_s"].any()


def test_speeds_of_light_and_full_contacts_can_be_set(straight):
    tracks, sim = straight(), racing(light_contact=0.0, full_contact=0.0)
    places = [(5.0, 0.0), (5.33, 0.0)]
    _, _, world = scene(tracks, sim, places, places, (0, 1), moving=[(1.0, 0.0)] * 2)
    assert world.cars["penalty_s"].tolist() == [[5.0, 0.0]]


def test_box_costs_all_however_lightly_it_is_touched(ring):
    things = ObstacleConfig(places=((0.5, 1.0),))
    tracks, sim = ring(), SimConfig(kind="head_to_head", num_cars=2, obstacles=things)
    seen, _, world = scene(
        tracks, sim, [(5.6, 0.2), (3.0, 0.0)], [(5.64, 0.2), (3.1, 0.0)],
        things=((0, 0),), moving=[(0.1, 0.0), (1.0, 0.0)],
    )  # fmt: skip
    assert seen["crashed"].tolist() == [True, False]
    assert world.cars["penalty_s"].tolist() == [[5.0, 0.0]]


def test_a_bot_exactly_beside_is_not_run_into(straight):
    # Half way along 10 m; the car behind runs into the car ahead.
    things = ObstacleConfig(kind="bot", places=((0.5, 1.0),), lane_change=False)
    tracks, sim = straight(), SimConfig(kind="head_to_head", num_cars=2, obstacles=things)
    for place, crashed in ((5.0, False), (4.99, True)):
        seen, _, _ = scene(
            tracks, sim, [(4.9, 0.0), (3.0, 0.0)], [(place, 0.0), (3.0, 0.0)], things=((0, 0),)
        )
        assert seen["crashed"].tolist() == [crashed, False]


# Impeding.


def slow_car_ahead(tracks, sim, *, pace=1.0, speed=1.0, asked=0.1, then=(), more=()):
    """Return the verdicts when car 0 runs into car 1, which is slow."""
    world = put_cars(tracks, sim, [(5.0, 0.0), (5.33, 0.0), *more])
    world.cars["pace"] = pace
    moving = [(2.5, 0.0), (speed, 0.0), *then]
    after = [(5.12, 0.0), (5.42, 0.0), *more]
    return scene(tracks, sim, world, after, (0, 1), moving=moving, asked=asked)


def test_who_brakes_for_nothing_shares_the_blame_and_the_penalty(straight):
    tracks, sim = straight(), racing()
    seen, judged, world = slow_car_ahead(tracks, sim)
    # 1.5 m/s of closing speed costs 5 s, half of it for each, 37.5 steps.
    assert to_blame(seen) == [0, 1]
    assert world.cars["penalty_s"][0].tolist() == pytest.approx([38 / 15] * 2, abs=1e-6)
    assert not seen["was_hit"].any()
    # Neither was pushed by the other: who leaves the road now does so by itself.
    assert judged["pushed_steps"].tolist() == [0, 0]
    # Both are put behind each other: the one that was hit loses its place.
    assert world.cars["distance"][0, 1] < world.cars["distance"][0, 0]


@pytest.mark.parametrize(
    ("scenery", "why"),
    [
        ({"speed": 2.0}, "it is not far slower: the road allows 4 m/s"),
        ({"asked": 2.0}, "it wants to be as fast as that"),
        ({"asked": 3.0}, "it is slow because it gains speed after a start or a penalty"),
        ({"pace": 0.4, "speed": 0.9}, "it has never been faster"),
        ({"more": [(6.3, 0.2)], "then": [(0.2, 0.0)]}, "a car is in its way"),
    ],
)
def test_a_car_that_is_slow_for_a_reason_is_not_to_blame(straight, scenery, why):
    tracks = straight()
    sim = racing(2 + len(scenery.get("more", ())))
    seen, _, _ = slow_car_ahead(tracks, sim, **scenery)
    assert to_blame(seen) == [0], why


def test_a_car_that_is_slow_for_a_box_is_not_to_blame(straight):
    things = ObstacleConfig(places=((0.65, 0.5),))
    sim = SimConfig(kind="head_to_head", num_cars=2, obstacles=things)
    seen, _, _ = slow_car_ahead(straight(), sim)
    assert to_blame(seen) == [0]


def test_pace_is_what_the_bends_allow(ring):
    # On the ring of 1.91 m radius the grip of 0.7 allows 3.62 m/s: 3 m/s are a share of 0.83.
    tracks, sim = ring(), racing()
    world = put_cars(tracks, sim, [(3.0, 0.0), (8.0, 0.0)], step=15)
    _, world = Stages(tracks, sim).judge(world, go_to(tracks, world, [(3.2, 0.0), (8.1, 0.0)]))
    assert world.cars["pace"][0].tolist() == pytest.approx([0.829, 0.414], abs=0.005)


@pytest.mark.parametrize("ahead", [-0.8, -0.4, 0.0, 0.4, 0.8, 1.2])
def test_pace_knows_a_short_bend_nearby(ahead):
    # A corner of 0.3 m radius and 0.47 m length, from 3 m on: it allows 1.435 m/s.
    tracks, sim = TrackSet(make_square(corner=0.3, width=0.5)), racing()
    place = 3.0 + 0.3 * np.pi / 4 - ahead
    world = put_cars(tracks, sim, [(place - 0.08, 0.0), (5.0, 0.0)], step=15)
    _, world = Stages(tracks, sim).judge(world, go_to(tracks, world, [(place, 0.0), (5.0, 0.0)]))
    assert world.cars["pace"][0, 0] == pytest.approx(1.2 / 1.435, rel=0.05)


# Forcing off.


def pushed_wide(tracks, sim, **scenery):
    """Return the world after car 0 has pushed car 1 to the left border, alongside."""
    seen, judged, world = scene(
        tracks, sim, [(5.0, 0.2), (5.05, 0.42)], [(5.13, 0.21), (5.18, 0.43)],
        (0, 1), moving=[(2.0, 0.2), (2.0, 0.0)], **scenery,
    )  # fmt: skip
    assert to_blame(seen) == [0]
    assert not seen["mistake"].any()
    assert judged["pushed_by"][1] == 0
    return world


def test_who_is_pushed_off_is_not_penalised_and_who_pushes_is(straight):
    tracks, sim = straight(), racing()
    world = pushed_wide(tracks, sim)
    seen, judged, world = scene(tracks, sim, world, [(5.26, 0.26), (5.31, 0.5)])
    assert seen["forced_off"].tolist() == [False, True]
    assert seen["pushed_off"].tolist() == [True, False]
    assert not seen["off_track"].any()
    assert seen["mistake"].tolist() == [True, False]
    assert judged["off_tracks"].tolist() == [0, 0]
    # The one stands 2 s, the other is put back on the nearer lane with the next step.
    assert world.cars["penalty_s"][0].tolist() == pytest.approx([2.0, 1 / 15], abs=1e-6)
    assert seen["penalty_s"].tolist() == [2.0, 0.0]
    stages = Stages(tracks, sim)
    verdicts, world = stages.judge(world, world)
    world = stages.settle(world, verdicts)
    assert verdicts["released"].tolist() == [[False, True]]
    assert world.cars["lateral"][0, 1] == pytest.approx(0.2, abs=1e-3)
    assert world.cars["s"][0, 1] == pytest.approx(5.31, abs=1e-3)
    assert not world.cars["ghost"][0, 1]


@pytest.mark.parametrize(("steps", "forced"), [(7, True), (8, False)])
def test_a_push_counts_for_half_a_second(straight, steps, forced):
    tracks, sim = straight(), racing()
    world = pushed_wide(tracks, sim)
    for _ in range(steps - 1):
        _, _, world = scene(tracks, sim, world, [(5.2, 0.26), (5.25 + 0.01 * _, 0.4)])
    seen, _, world = scene(tracks, sim, world, [(5.26, 0.26), (5.5, 0.5)])
    assert seen["forced_off"].tolist() == [False, forced]
    assert seen["off_track"].tolist() == [False, not forced]


def test_who_is_to_blame_for_the_contact_has_left_the_road_by_itself(straight):
    tracks, sim = straight(), racing()
    world = pushed_wide(tracks, sim)
    seen, _, world = scene(tracks, sim, world, [(5.26, 0.5), (5.31, 0.4)])
    assert seen["off_track"].tolist() == [True, False]
    assert not seen["forced_off"].any()


def test_pusher_that_is_frozen_already_stands_longer(straight):
    tracks, sim = straight(), racing()
    # A hard push is penalised by itself, here with 2.5 s; then the other leaves the road.
    seen, _, world = scene(
        tracks, sim, [(5.0, 0.2), (5.05, 0.42)], [(5.13, 0.23), (5.18, 0.45)],
        (0, 1), moving=[(2.0, 0.9), (2.0, 0.0)],
    )  # fmt: skip
    assert seen["penalty_s"].tolist() == pytest.approx([37 / 15, 0.0], abs=1e-3)
    moved_to = world.cars["s"][0, 0]
    seen, _, world = scene(tracks, sim, world, [(moved_to, -0.2), (5.31, 0.5)])
    assert seen["forced_off"].tolist() == [False, True]
    assert seen["penalty_s"].tolist() == [2.0, 0.0]
    assert world.cars["penalty_s"][0, 0] == pytest.approx(36 / 15 + 2.0, abs=1e-3)


@pytest.mark.parametrize(("name", "value"), [("finish_s", 9.0), ("retired", True)])
def test_pusher_whose_race_is_over_stands_no_penalty(straight, name, value):
    tracks, sim = straight(), racing()
    world = pushed_wide(tracks, sim)
    world.cars[name][0, 0] = value
    seen, _, world = scene(tracks, sim, world, [(5.26, 0.26), (5.31, 0.5)])
    assert seen["forced_off"].tolist() == [False, True]
    assert seen["penalty_s"].tolist() == [0.0, 0.0]
    assert world.cars["penalty_s"][0, 0] == 0.0


def test_pushed_into_a_box_is_the_pushers_fault_too(straight):
    things = ObstacleConfig(places=((0.56, 1.0),))
    tracks, sim = straight(), SimConfig(kind="head_to_head", num_cars=2, obstacles=things)
    world = put_cars(tracks, sim, [(5.0, -0.1), (5.05, 0.1)])
    seen, judged, world = scene(
        tracks, sim, world, [(5.13, -0.09), (5.3, 0.11)], (0, 1), things=((1, 0),),
        moving=[(2.0, 0.2), (2.0, 0.0)],
    )  # fmt: skip
    assert seen["forced_off"].tolist() == [False, True]
    assert seen["crashed"].tolist() == [False, False]
    assert judged["crashes"].tolist() == [0, 0]
    assert world.cars["penalty_s"][0].tolist() == pytest.approx([5.0, 1 / 15], abs=1e-6)
    # A metre behind the box, on the other lane.
    assert world.cars["s"][0, 1] == pytest.approx(4.6, abs=1e-3)
    assert world.cars["lateral"][0, 1] == pytest.approx(-0.2, abs=1e-3)


def test_in_training_a_pushed_cars_episode_is_cut_off_and_the_pushers_is_over(straight):
    tracks, sim = straight(), racing()
    env = RaceEnv(tracks, EnvConfig(sim=sim, mode="training"))
    world = pushed_wide(tracks, sim)
    env.world.cars[:], env.world.worlds[:] = world.cars, world.worlds
    for car, (s, lateral) in enumerate([(5.26, 0.2), (5.31, 0.55)]):
        env.world.cars["x"][0, car], env.world.cars["y"][0, car] = s, lateral
    step = env.step(np.zeros((1, 2, 2)))
    assert step.verdicts["forced_off"].tolist() == [[False, True]]
    assert step.terminated.tolist() == [[True, False]]
    assert step.truncated.tolist() == [[False, True]]
    assert step.began.all()
    # Nothing of that is left in the next episodes.
    assert not env.world.cars["pushed_steps"].any()


# Three cars.


@pytest.mark.parametrize("forced_off_s", [0.5, 1 / 15])
def test_a_car_that_is_pushed_into_another_is_not_to_blame(straight, forced_off_s):
    # In the same step: however short a push counts, it does so here.
    tracks, sim = straight(), racing(3, forced_off_s=forced_off_s)
    seen, judged, world = scene(
        tracks, sim, [(5.0, 0.0), (5.33, 0.0), (5.66, 0.0)], [(5.1, 0.0), (5.43, 0.0), (5.76, 0.0)],
        (0, 1), (1, 2), moving=[(3.0, 0.0), (1.0, 0.0), (1.0, 0.0)],
    )  # fmt: skip
    assert to_blame(seen) == [0]
    assert seen["was_hit"].tolist() == [False, True, True]
    assert world.cars["penalty_s"][0].tolist() == [5.0, 0.0, 0.0]
    # Whoever began it is to blame for what becomes of the last one.
    assert judged["pushed_by"][[1, 2]].tolist() == [0, 0]


def test_a_car_that_is_pushed_reaches_the_third_a_step_later(straight):
    tracks, sim = straight(), racing(3, light_contact=9.0, full_contact=9.0)
    seen, _, world = scene(
        tracks, sim, [(5.0, 0.0), (5.33, 0.0), (5.8, 0.0)], [(5.1, 0.0), (5.45, 0.0), (5.85, 0.0)],
        (0, 1), moving=[(3.0, 0.0), (1.0, 0.0), (1.0, 0.0)],
    )  # fmt: skip
    seen, _, _ = scene(
        tracks, sim, world, [(5.2, 0.0), (5.6, 0.0), (5.92, 0.0)], (1, 2),
        moving=[(2.0, 0.0), (2.0, 0.0), (1.0, 0.0)],
    )  # fmt: skip
    assert to_blame(seen) == []
    assert seen["was_hit"].tolist() == [False, False, True]


def test_between_two_cars_the_one_that_moves_across_is_to_blame_towards_both(straight):
    tracks, sim = straight(), racing(3)
    # The middle car swerves to the left, into car 2; car 0 on its right follows into it.
    seen, _, world = scene(
        tracks, sim, [(5.0, -0.22), (5.02, 0.0), (5.04, 0.22)],
        [(5.13, -0.2), (5.15, 0.02), (5.17, 0.23)], (0, 1), (1, 2),
        moving=[(2.0, 0.4), (2.0, 0.7), (2.0, 0.0)],
    )  # fmt: skip
    assert to_blame(seen) == [0, 1]
    # Towards the right it moves away, so that the car there comes at 0.1 m/s.
    assert seen["touched"].tolist() == [True, False, False]
    assert seen["crashed_car"].tolist() == [NOBODY, 2, NOBODY]
    assert world.cars["penalty_s"][0].tolist() == pytest.approx([0.0, 25 / 15, 0.0], abs=1e-6)


def test_of_two_cars_hit_at_once_the_harder_contact_decides(straight):
    tracks, sim = straight(), racing(3)
    seen, _, _ = scene(
        tracks, sim, [(5.0, 0.0), (5.3, 0.12), (5.31, -0.12)],
        [(5.1, 0.0), (5.4, 0.12), (5.4, -0.12)], (0, 1), (0, 2),
        moving=[(2.0, 0.0), (1.7, 0.0), (0.7, 0.0)],
    )  # fmt: skip
    assert to_blame(seen) == [0]
    assert seen["crashed_car"][0] == 2


# Passes.


@pytest.mark.parametrize(("ghost", "counts"), [((), True), ((0,), False), ((1,), False)])
def test_a_pass_counts_only_between_cars_that_can_collide(straight, ghost, counts):
    before, after = [(5.0, 0.1), (5.05, -0.1)], [(5.3, 0.1), (5.1, -0.1)]
    for rules, expected in ((RULES["league"], counts), (RULES["deepracer"], True)):
        sim = SimConfig(kind="head_to_head", num_cars=2, rules=rules)
        seen, judged, _ = scene(straight(), sim, before, after, ghosts=ghost)
        assert bool(seen["overtook"][0]) == expected
        assert judged["overtakes"].tolist() == [int(expected), 0]
        # The order is what it is.
        assert members(judged["ahead"], 2).tolist() == [[False, True], [False, False]]


# The same in both solvers.


class Driven:
    """A race of two or more cars on a straight, driven by actions."""

    def __init__(self, solver, places, speeds, *, width=1.6, obstacles=None, **rules) -> None:
        sim = SimConfig(
            kind="head_to_head",
            num_cars=len(places),
            rules=RaceRules(**rules),
            obstacles=obstacles or ObstacleConfig(),
        )
        tracks = TrackSet(make_straight(width=width, length=20.0))
        self.env = RaceEnv(tracks, EnvConfig(sim=sim, solver=solver))
        world = put_cars(tracks, sim, places)
        for name in ("x", "y", "yaw", "s", "lateral", "distance", "best_distance", "ahead"):
            self.env.world.cars[name] = world.cars[name]
        self.env.world.cars["velocity_x"] = self.env.world.cars["target_speed"] = speeds
        self.seen = []

    def drive(self, steps, *commands):
        """Drive: steering in [-1, 1] and speed [m/s] of each car; keep what the referee saw."""
        actions = [[(steering, (speed - 0.1) / 3.9 * 2 - 1) for steering, speed in commands]]
        for _ in range(steps):
            self.seen.append(self.env.step(np.array(actions, np.float32)).verdicts[0].copy())
        return self

    def that(self, field) -> list[int]:
        """Return the cars for which a flag was ever set."""
        return np.flatnonzero(np.stack(self.seen)[field].any(axis=0)).tolist()


BOTH = pytest.mark.parametrize("solver", ["planar", "bullet"])


@BOTH
def test_driven_ramming_from_behind_costs_the_rear_car(solver):
    race = Driven(solver, [(2.0, 0.0), (3.0, 0.0)], [3.0, 0.8]).drive(12, (0, 4.0), (0, 0.8))
    assert (race.that("crashed"), race.that("was_hit")) == ([0], [1])
    assert race.env.world.cars["penalty_s"][0, 0] > 3


@BOTH
def test_driven_nudge_from_behind_is_a_touch(solver):
    race = Driven(solver, [(2.0, 0.0), (2.35, 0.0)], [2.2, 2.0]).drive(12, (0, 2.2), (0, 2.0))
    assert (race.that("touched"), race.that("crashed")) == ([0], [])


@BOTH
@pytest.mark.parametrize(("ahead", "side"), [(0.02, 1), (0.02, -1), (0.15, 1), (-0.15, -1)])
def test_driven_swerve_into_a_car_alongside_is_the_swerving_cars_fault(solver, ahead, side):
    places = [(2.0, side * -0.25), (2.0 + ahead, side * 0.05)]
    race = Driven(solver, places, [2.5, 2.5]).drive(10, (0, 2.5), (side * -0.5, 2.5))
    blamed = set(race.that("crashed")) | set(race.that("touched"))
    assert blamed == {1}
    assert race.that("was_hit") == [0]


@BOTH
def test_driven_ramming_the_wrong_way_is_the_ramming_cars_fault(solver):
    race = Driven(solver, [(2.0, 0.0), (4.0, 0.0)], [0.5, 0.0])
    race.env.world.cars["yaw"][0, 1] = -np.pi
    race.drive(25, (0, 0.5), (0, 2.0))
    assert race.that("crashed") == [1]


@BOTH
def test_driven_push_off_the_road_costs_the_pusher(solver):
    costless = {"light_contact": 9.0, "full_contact": 9.0}
    race = Driven(solver, [(2.0, 0.0), (2.1, 0.22)], [2.0, 2.0], width=0.8, **costless)
    race.drive(25, (0.25, 2.5), (0, 2.0))
    assert race.that("touched") == [0]
    assert race.that("forced_off") == [1]
    assert race.that("pushed_off") == [0]


@BOTH
def test_driven_brake_test_is_shared(solver):
    race = Driven(solver, [(2.0, 0.0), (3.0, 0.0)], [3.5, 3.5])
    race.drive(17, (0, 3.5), (0, 3.5)).drive(15, (0, 3.5), (0, 0.1))
    assert race.that("crashed") == [0, 1]
    penalties = race.env.world.cars["penalty_s"][0]
    assert penalties.min() > 0


@BOTH
def test_driven_leader_that_laps_a_car_and_hits_it_is_to_blame(solver):
    race = Driven(solver, [(2.0, 0.0), (3.0, 0.0)], [3.0, 1.0])
    for name in ("distance", "best_distance"):
        race.env.world.cars[name][0, 0] += 40.0
    race.drive(12, (0, 4.0), (0, 1.0))
    assert race.that("crashed") == [0]


@BOTH
@pytest.mark.parametrize("laps", [0, 1, 2])
@pytest.mark.parametrize("swerves", [0, 1])
def test_driven_lapping_alongside_who_moves_across_is_to_blame(solver, laps, swerves):
    # The faster car has come past by half a car's length, on the left, as one of them swerves.
    race = Driven(solver, [(2.15, 0.15), (2.0, -0.15)], [2.4, 2.2])
    for name in ("distance", "best_distance"):
        race.env.world.cars[name][0, 0] += 20.0 * laps
    straight, across = (0, 2.4), (-0.5 if swerves == 0 else 0.5, 2.4)
    race.drive(10, *((across, straight) if swerves == 0 else (straight, across)))
    assert set(race.that("crashed")) | set(race.that("touched")) == {swerves}
    assert race.that("was_hit") == [1 - swerves]


@BOTH
def test_driven_chain_of_three_is_the_last_cars_fault(solver):
    race = Driven(solver, [(2.0, 0.0), (2.9, 0.0), (3.26, 0.0)], [3.5, 0.8, 0.8])
    race.drive(12, (0, 4.0), (0, 0.8), (0, 0.8))
    assert race.that("crashed") == [0]


@BOTH
@pytest.mark.parametrize("kind", ["box", "bot"])
def test_driven_several_cars_among_obstacles(solver, kind):
    things = ObstacleConfig(kind=kind, places=((0.3, 1.0), (0.6, -1.0)), lane_change=False)
    race = Driven(solver, [(2.0, 0.4), (3.0, -0.4), (1.0, -0.4)], [2.0, 2.0, 2.0], obstacles=things)
    race.drive(130, (0, 2.0), (0, 2.0), (0, 1.5))
    hit = np.stack(race.seen)["crashed_obstacle"].max(axis=0)
    assert hit.tolist() == [0, 1, NOBODY if kind == "bot" else 1]


# Several cars and obstacles.


@pytest.mark.parametrize("num_cars", [1, 4, 8])
@pytest.mark.parametrize("closed", [True, False])
def test_obstacles_keep_clear_of_the_starting_grid(ring, straight, num_cars, closed):
    tracks = ring() if closed else straight()
    for random_places in (True, False):
        things = ObstacleConfig(count=3, random_places=random_places)
        sim = SimConfig(kind="obstacle_avoidance", num_cars=num_cars, obstacles=things)
        world = start(tracks, sim, list(range(50)))
        gap = np.abs(world.cars["s"][:, :, None] - world.obstacles["s"][:, None, :])
        gap = np.minimum(gap, 12.0 - gap) if closed else gap
        assert gap.min() > 0.9


def test_number_of_obstacles_by_kind():
    def number(kind, num_cars=1, **things):
        sim = SimConfig(kind=kind, num_cars=num_cars, obstacles=ObstacleConfig(**things))
        return sim.num_obstacles

    assert number("time_trial") == number("head_to_head", 2) == 0
    assert number("obstacle_avoidance") == number("obstacle_avoidance", 3) == 6
    assert number("head_to_head", 4, count=6) == 6
    assert number("head_to_head", 2, places=((0.1, 0.0),)) == 1
    assert number("obstacle_avoidance", count=0) == 0
