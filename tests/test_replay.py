import math
import random
import struct
import zlib
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from league import __version__, replay
from league.errors import LeagueError, ReplayError
from league.racing import race
from league.replay import broadcast
from league.replay import format as file_format
from league.replay.format import PREFIX, decode, encode
from league.sim.camera.renderer import Renderer
from league.sim.config import CameraConfig
from league.track import files
from league.track.track import TrackSet
from tests.recorded import by_hand, finish, first_world, moved, raced, recorder_of


def assert_equal_columns(one, other):
    for item in fields(one):
        assert np.array_equal(getattr(one, item.name), getattr(other, item.name)), item.name


def sealed(header: bytes, body: bytes, version: int = file_format.VERSION) -> bytes:
    """Return a file of these unpacked parts with a right checksum, as only a forger would."""
    packed = zlib.compress(header, 1), zlib.compress(body, 1)
    crc = zlib.crc32(packed[1], zlib.crc32(packed[0]))
    prefix = PREFIX.pack(file_format.MAGIC, version, 0, len(packed[0]), len(packed[1]), crc)
    return prefix + packed[0] + packed[1]


def parts_of(content: bytes) -> tuple[bytes, bytes]:
    size = PREFIX.unpack_from(content)[3]
    middle = PREFIX.size + size
    return zlib.decompress(content[PREFIX.size : middle]), zlib.decompress(content[middle:])


@pytest.mark.parametrize("cars", [1, 2])
def test_a_replay_reads_back_as_it_was_written(tmp_path, cars):
    made = by_hand(7, lambda w, n: moved(w, x=[1.0 + 0.1 * n] * cars), cars)
    path = replay.write(made, tmp_path / "sub" / "a.race")
    read = replay.read(path)
    assert_equal_columns(made.columns, read.columns)
    assert read.result == made.result
    assert read.names == made.names
    assert np.array_equal(read.parameters, made.parameters)
    assert np.array_equal(read.obstacle_sizes, made.obstacle_sizes)
    assert np.array_equal(read.track.center, made.track.center)
    assert [file.name for file in path.parent.iterdir()] == ["a.race"]


def test_a_real_race_reads_back_as_it_was_recorded(tmp_path):
    made = raced()
    read = replay.read(replay.write(made, tmp_path / "a.race"))
    assert_equal_columns(made.columns, read.columns)
    assert replay.compare(made, read).agrees
    assert read.num_frames == made.result.steps + 1
    assert read.columns.distance[-1].max() > 17.0  # one lap of 17.71 m


@pytest.mark.parametrize(
    ("name", "given", "kept"),
    [
        ("x", 1.23449, 1.234),
        ("x", -1.2347, -1.235),
        ("velocity_y", 0.0004, 0.0),
        ("steering", 0.12344, 0.1234),
        ("yaw", 0.1, round(0.1 / (math.tau / 65536)) * math.tau / 65536),
        ("yaw", math.pi - 1e-6, -math.pi),
    ],
)
def test_numbers_are_kept_to_their_grain(name, given, kept):
    made = by_hand(3, lambda w, _: moved(w, **{name: [given, 0.0]}))
    assert getattr(made.columns, name)[:, 0] == pytest.approx([kept] * 3, abs=1e-12)


def test_far_and_fast_numbers_survive_differences_that_overflow(tmp_path):
    far = [2e6, -2e6, 2e6, -2e6]  # 2e9 mm: neighbouring differences do not fit 32 bits
    made = by_hand(4, lambda w, n: moved(w, x=[far[n], 0.0]))
    read = replay.read(replay.write(made, tmp_path / "a.race"))
    assert read.columns.x[:, 0].tolist() == far


def test_a_column_that_does_not_fit_is_refused():
    made = by_hand(2, lambda w, n: moved(w, x=[3e6 * n, 0.0]))
    with pytest.raises(ReplayError, match="too large"):
        encode(made)


def test_a_race_that_left_the_numbers_is_refused():
    recorder = recorder_of(3, lambda w, n: moved(w, x=[math.nan if n == 2 else 0.0, 0.0]))
    with pytest.raises(ReplayError, match="NaN"):
        finish(recorder, 3)


def test_what_happens_to_the_race_later_does_not_reach_the_recording():
    tracks = TrackSet(files.load("reinvent_2018"))
    world = first_world(tracks)
    before = world.cars["x"].copy()
    recorder = replay.Recorder(by_hand(1).spec, tracks)
    recorder.add(world)
    world.cars["action_steering"] = world.cars["action_speed"] = 0.5
    recorder.add(world)
    assert np.array_equal(world.cars["x"], before)
    world.cars["x"], world.cars["action_speed"] = 9.0, -1.0
    made = finish(recorder, 2)
    assert made.columns.x[1] == pytest.approx(before[0].tolist(), abs=6e-4)
    assert made.columns.actions[1].tolist() == [[0.5, 0.5], [0.5, 0.5]]


def test_recording_changes_nothing_in_the_race():
    silent = race.run(raced().spec, record=False)
    assert silent.replay is None
    assert silent.result == raced().result


def test_the_same_race_agrees_with_itself_to_the_last_bit():
    asked = raced().spec
    again = race.run(asked).replay
    agreement = replay.compare(raced(), again)
    assert agreement.agrees
    assert agreement.first_difference is None
    assert agreement.steps == raced().num_frames


def test_a_difference_of_one_bit_is_found_though_rounding_hides_it():
    def nudged(world, number):
        x = float(world.cars["x"][0, 1])
        other = float(np.nextafter(np.float32(x), np.float32(9)))
        return moved(world, x=[0.0, other if number >= 3 else x])

    made = by_hand(6, lambda w, n: moved(w, x=[0.0, float(w.cars["x"][0, 1])]))
    other = by_hand(6, nudged)
    assert np.array_equal(made.columns.x, other.columns.x)
    agreement = replay.compare(made, other)
    assert agreement.first_difference == 3
    assert agreement.same_result
    assert not agreement.agrees


def test_a_missing_step_is_a_difference():
    agreement = replay.compare(by_hand(6), by_hand(4))
    assert agreement.first_difference == 4
    assert agreement.steps == 6
    assert agreement.sentence == "The races differ from step 4 on, of 5 steps."


def test_another_result_does_not_agree():
    made = by_hand(3)
    other = replace(made, result=made.result.model_copy(update={"lead_changes": 1}))
    agreement = replay.compare(made, other)
    assert (agreement.first_difference, agreement.same_result, agreement.agrees) == (
        None,
        False,
        False,
    )


def test_two_cars_take_less_than_60_kilobytes_a_minute():
    made = raced("bullet", ("racing_line", "racing_line"))
    assert len(encode(made)) <= 60_000 * made.duration_s / 60


def test_all_frames_are_one_batch_of_worlds():
    made = by_hand(5, lambda w, n: moved(w, x=[0.1 * n, 2.0], yaw=[0.0, 3.0]))
    world = made.worlds()
    assert (world.num_worlds, world.num_cars) == (5, 2)
    assert world.worlds["step"].tolist() == [0, 1, 2, 3, 4]
    assert world.cars["x"][:, 0].tolist() == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4])
    assert world.cars["grip"].tolist() == [pytest.approx([0.7, 0.7])] * 5
    assert world.worlds["seed"].tolist() == [made.spec.seed] * 5


def test_the_ordinary_renderers_draw_a_replay():
    made = by_hand(3, lambda w, n: moved(w, yaw=[0.0, 0.2 * n]))
    renderer = Renderer(made.tracks, made.sim, CameraConfig(width=64, height=48))
    seen = renderer.render(made.worlds(), 1)
    assert seen.shape == (3, 2, 48, 64)
    assert not np.array_equal(seen[0], seen[2])


def test_between_two_frames_cars_are_on_straight_lines_and_turn_the_short_way():
    yaws = [3.1, -3.1]
    made = by_hand(2, lambda w, n: moved(w, x=[0.2 * n, 0.0], yaw=[yaws[n], 0.0]))
    world = made.at(np.array([0.25 / 15]))
    assert world.cars["x"][0, 0].item() == pytest.approx(0.05)
    # 3.1 to -3.1 is 0.083 rad forward over pi; a quarter of it is 0.0208.
    assert world.cars["yaw"][0, 0].item() == pytest.approx(3.1208, abs=2e-4)


def test_a_car_that_was_put_back_is_never_drawn_between():
    made = by_hand(2, lambda w, n: moved(w, x=[float(n), 0.0]))
    assert made.at(np.array([0.9 / 15])).cars["x"][0, 0].item() == 0.0
    assert made.at(np.array([1.0 / 15])).cars["x"][0, 0].item() == 1.0


def test_a_time_that_is_no_number_is_refused():
    made = by_hand(2, lambda w, n: moved(w, x=[float(n), 0.0]))
    with pytest.raises(ReplayError, match="a time is NaN: give seconds"):
        made.at(np.array([0.0, np.nan]))


def test_times_outside_the_race_are_its_ends():
    made = by_hand(3, lambda w, n: moved(w, x=[0.1 * n, 0.0]))
    x = made.at(np.array([-5.0, 99.0])).cars["x"][:, 0]
    assert x.tolist() == pytest.approx([0.0, 0.2])


def test_the_recorder_says_what_is_missing():
    with pytest.raises(ValueError, match="nothing was recorded"):
        finish(replay.Recorder(by_hand(1).spec, TrackSet(files.load("reinvent_2018"))), 1)


# Broadcast data.


def test_gaps_are_given_in_metres_and_in_seconds():
    # Car 0 drives 0.1 m a frame, car 1 follows 0.3 m behind on the same way: 3 frames, 0.2 s.
    def driven(world, number):
        return moved(world, distance=[0.1 * number, 0.1 * number - 0.3])

    made = by_hand(10, driven)
    assert made.gaps_m[9].tolist() == pytest.approx([0.0, 0.3])
    assert made.gaps_s[9].tolist() == pytest.approx([0.0, 0.2])
    assert made.running_order[9].tolist() == [0, 1]


def test_the_chase_follows_the_rear_car_of_a_fight_and_then_the_leader():
    def driven(world, number):
        distance = [5.0, 3.0 if number < 30 else 1.0]
        return moved(world, x=[10.0, 20.0], y=[0.0, 0.0], yaw=[0.0, 0.0], distance=distance)

    path = broadcast.chase_path(by_hand(60, driven))
    assert path.x[0] == pytest.approx(20.0)  # 2 m behind: both in the picture
    assert path.x[-1] == pytest.approx(10.0)  # 4 m behind: the leader alone


@pytest.mark.parametrize(("gap", "moved_by"), [(0.2, 0.25), (0.525, 0.125), (0.8, 0.0)])
def test_the_chase_stands_farther_back_between_two_cars_side_by_side(gap, moved_by):
    def driven(world, number):
        # Both head for +y; the front one is half a metre to the right.
        ahead = {"x": [0.5, 0.0], "y": [3.0 + gap, 3.0], "yaw": [np.pi / 2] * 2}
        return moved(world, distance=[3.0 + gap, 3.0], **ahead)

    path = broadcast.chase_path(by_hand(60, driven))
    assert path.x == pytest.approx(moved_by, abs=1e-4)
    assert path.y == pytest.approx(3.0 - moved_by, abs=1e-4)


def test_the_chase_of_a_pursuit_does_not_jump_round_the_lap():
    def driven(world, number):
        distance = [5.0, 5.0 + 0.1 * (-1) ** number]  # in turn ahead, half a lap apart
        return moved(world, x=[10.0, 20.0], y=[0.0, 0.0], yaw=[0.0, 0.0], distance=distance)

    made = by_hand(60, driven)
    spec = made.result.spec.model_copy(update={"format": "pursuit"})
    pursuit = replace(made, result=made.result.model_copy(update={"spec": spec}))
    assert broadcast.chase_path(pursuit).x == pytest.approx(20.0)


# Files that are not sound replays.


def test_nothing_is_left_where_nothing_can_be_written(tmp_path):
    (tmp_path / "taken").mkdir()
    with pytest.raises(ReplayError, match="cannot be written"):
        replay.write(by_hand(2), tmp_path / "taken")
    assert [file.name for file in tmp_path.iterdir()] == ["taken"]


@pytest.mark.parametrize("share", [0.0, 0.001, 0.1, 0.5, 0.9, 0.999])
def test_a_truncated_replay_is_refused(tmp_path, share):
    path = replay.write(by_hand(20), tmp_path / "a.race")
    content = path.read_bytes()
    path.write_bytes(content[: int(len(content) * share)])
    with pytest.raises(ReplayError, match=r"a\.race (ends after|is empty)"):
        replay.read(path)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "is empty"),
        (b"\x89PNG\r\n\x1a\n" + bytes(100), "is not a replay"),
        (b"track: reinvent_2018\n", "is not a replay"),
        (b"\x80\x04cos\nsystem\n", "is not a replay"),
    ],
)
def test_a_foreign_file_is_refused(tmp_path, content, reason):
    path = tmp_path / "a.race"
    path.write_bytes(content)
    with pytest.raises(ReplayError, match=reason):
        replay.read(path)


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    with pytest.raises(ReplayError, match="cannot be read"):
        replay.read(tmp_path / "none.race")
    with pytest.raises(ReplayError, match="not a file"):
        replay.read(tmp_path)


def test_another_version_is_named():
    header, body = parts_of(encode(by_hand(2)))
    with pytest.raises(ReplayError, match="version 7"):
        decode(sealed(header, body, version=7))


def test_bytes_after_the_end_are_refused():
    with pytest.raises(ReplayError, match="goes on for 1 bytes"):
        decode(encode(by_hand(2)) + b"x")


def test_a_flipped_bit_is_refused():
    content = bytearray(encode(by_hand(5)))
    content[-20] ^= 4
    with pytest.raises(ReplayError, match="damaged"):
        decode(bytes(content))


def test_bombs_are_refused_before_they_unfold():
    header, body = parts_of(encode(by_hand(2)))
    with pytest.raises(ReplayError, match="header of more than"):
        decode(sealed(header + b" " * 17 * 2**20, body))
    with pytest.raises(ReplayError, match="body of more than"):
        decode(sealed(header, body + bytes(10**8)))
    many = header.replace(b'"frames":2,', b'"frames":540001,')
    with pytest.raises(ReplayError, match="which no race fills"):
        decode(sealed(many, bytes(10**8)))


def test_headers_that_contradict_themselves_are_refused():
    header, body = parts_of(encode(by_hand(2)))
    for old, new in (
        (b'"cars":2', b'"cars":3'),
        (b'"car":1,"name"', b'"car":0,"name"'),
        (b'"obstacle_frames":1', b'"obstacle_frames":9'),
        (b'"kind":"start","car":0', b'"kind":"start","car":5'),
        (b'"step_hz":15', b'"step_hz":0'),
        (b'"track":"', b'"track":"? '),
    ):
        assert old in header
        with pytest.raises(ReplayError):
            decode(sealed(header.replace(old, new, 1), body))


def test_no_mutation_of_a_file_does_worse_than_a_sentence():
    content = encode(by_hand(12, lambda w, n: moved(w, x=[0.1 * n, 0.0]), cars=2))
    header, body = parts_of(content)
    draw = random.Random(7)
    outcomes = {"refused": 0, "read": 0}
    for number in range(3000):
        kind = number % 3
        if kind == 0:
            mutant = _mutated(content, draw)
        elif kind == 1:
            mutant = sealed(_mutated(header, draw), body)
        else:
            mutant = sealed(header, _mutated(body, draw))
        try:
            made = decode(mutant)
        except LeagueError as error:
            assert len(str(error)) > 20
            outcomes["refused"] += 1
        else:
            assert made.columns.all_finite()
            assert made.worlds().num_worlds == made.num_frames
            outcomes["read"] += 1
    assert outcomes["refused"] > 500
    assert outcomes["read"] > 100  # changed columns of the right length are a replay


def _mutated(content: bytes, draw: random.Random) -> bytes:
    changed = bytearray(content)
    for _ in range(draw.choice((1, 1, 1, 3, 20))):
        at = draw.randrange(len(changed))
        kind = draw.randrange(6)
        if kind <= 2:
            changed[at] = draw.randrange(256)
        elif kind == 3:
            changed[at : at + 4] = struct.pack("<I", draw.choice((0, 1, 2**31, 2**32 - 1)))
        elif kind == 4:
            del changed[at : at + draw.randrange(1, 9)]
        else:
            changed[at:at] = draw.randbytes(draw.randrange(1, 9))
    return bytes(changed)


def test_a_replay_of_the_first_version_is_read_and_shown():
    old = replay.read(Path(__file__).parent / "data" / "version_1.race")
    assert (old.num_frames, old.names, old.physics) == (46, ("centerline", "cautious"), "")
    assert not old.columns.z.any() and not old.columns.roll.any()
    # Where the league of then left the cars.
    assert old.columns.x[-1] == pytest.approx([7.228, 7.478], abs=1e-3)
    assert old.worlds().cars["x"][-1] == pytest.approx([7.228, 7.478], abs=1e-3)


def test_height_roll_and_pitch_are_kept():
    made = by_hand(5, lambda w, n: moved(w, z=[0.01 * n] * 2, roll=[-0.2 * n] * 2, pitch=[3.0] * 2))
    cars = decode(encode(made)).worlds().cars
    assert cars["z"][-1] == pytest.approx([0.04, 0.04], abs=1e-3)
    assert cars["roll"][-1] == pytest.approx([-0.8, -0.8], abs=1e-4)
    assert cars["pitch"][-1] == pytest.approx([3.0, 3.0], abs=1e-4)


def test_a_replay_keeps_the_version_of_its_league_and_older_ones_have_none():
    recorded = by_hand(3)
    assert recorded.league_version == decode(encode(recorded)).league_version == __version__
    header, body = parts_of(encode(recorded))
    assert f'"league":"{__version__}",'.encode() in header
    older = sealed(header.replace(f'"league":"{__version__}",'.encode(), b""), body)
    assert decode(older).league_version == ""
    assert_equal_columns(decode(older).columns, recorded.columns)
