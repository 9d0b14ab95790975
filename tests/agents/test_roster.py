"""Names become drivers; what is no name becomes one sentence."""

import numpy as np
import pytest

from league.agents import roster
from league.envs.actions import decode, encode
from league.errors import PolicyError
from league.sim.config import CarConfig, SensorConfig
from league.track import files
from league.track.track import TrackSet


def one_track() -> TrackSet:
    return TrackSet(files.load("harbour_oval"))


@pytest.mark.parametrize("name", roster.NAMES)
def test_every_name_gives_a_driver_without_sensors(name):
    driver = roster.load(name, one_track(), CarConfig())
    assert driver.name == name
    assert driver.sensors == SensorConfig()


def test_an_unknown_driver_is_refused_with_the_nearest_names():
    with pytest.raises(PolicyError, match=r"'racing_lime'.*racing_line"):
        roster.load("racing_lime", one_track(), CarConfig())


def test_a_file_with_another_ending_is_refused_with_the_right_one(tmp_path):
    path = tmp_path / "racer.PT"
    path.touch()
    with pytest.raises(PolicyError, match=r"racer.PT' is a file: rename it, .* ends in \.pt"):
        roster.check(str(path))
    with pytest.raises(PolicyError, match="there is no driver"):
        roster.check("x" * 5000)


def test_a_missing_checkpoint_says_where_checkpoints_come_from():
    with pytest.raises(PolicyError, match="league train"):
        roster.load("runs/best.pt", one_track(), CarConfig())


def test_two_tracks_at_once_are_refused():
    both = TrackSet(files.load("harbour_oval"), files.load("peanut"))
    with pytest.raises(PolicyError, match="2 tracks"):
        roster.load("cautious", both, CarConfig())


def test_actions_are_the_inverse_of_what_the_environment_decodes():
    car = CarConfig()
    steering, speed = np.array([0.0, 0.3, -0.5]), np.array([0.1, 2.0, 4.0])
    found = decode(encode(steering, speed, car), car)
    assert np.allclose(found, (steering, speed), rtol=1e-6)


def test_what_cannot_be_asked_is_clipped():
    action = encode(np.array([2.0, -2.0]), np.array([9.0, -1.0]), CarConfig())
    assert action.tolist() == [[1.0, 1.0], [-1.0, -1.0]]
