"""model_metadata.json and hyperparameters.json: what they mean, and what is refused."""

import json

import pytest

from league.deepracer import hyperparameters
from league.deepracer import model_metadata as metadata
from league.envs.actions import ContinuousActions, DiscreteActions
from league.errors import ConfigError

TWO = [{"steering_angle": -30, "speed": 0.6}, {"steering_angle": 30.0, "speed": "1.2", "index": 1}]
RANGES = {"steering_angle": {"low": -20, "high": 25}, "speed": {"low": 1, "high": 2.5}}


def test_oldest_file_means_what_it_meant():
    found = metadata.parse({"action_space": TWO})
    assert found.action_space == DiscreteActions(((-30.0, 0.6), (30.0, 1.2)))
    assert found.version == "1"
    assert found.training_algorithm == "clipped_ppo"
    assert found.neural_network == "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW"
    camera = found.sensors.camera
    assert camera is not None
    assert (camera.eyes, camera.width, camera.height, camera.colour) == ("mono", 160, 120, False)
    assert found.sensors.lidar is None
    assert found.notes == ()


def test_file_with_sensors_and_no_version_is_of_version_2():
    assert metadata.parse({"action_space": TWO, "sensor": ["LEFT_CAMERA"]}).version == "2"


@pytest.mark.parametrize("version", ["3", "5", 4, 6.0, "6"])
def test_versions_may_be_strings_or_numbers(version):
    found = metadata.parse({"action_space": TWO, "version": version})
    assert found.version == str(version)[0]


def test_continuous_ranges_are_read():
    found = metadata.parse({"action_space": RANGES, "action_space_type": "continuous"})
    assert found.action_space == ContinuousActions(-20.0, 25.0, 1.0, 2.5)


@pytest.mark.parametrize(
    ("name", "eyes"),
    [("FRONT_FACING_CAMERA", "mono"), ("LEFT_CAMERA", "left"), ("STEREO_CAMERAS", "stereo")],
)
def test_cameras_by_their_names(name, eyes):
    camera = metadata.parse({"action_space": TWO, "sensor": [name]}).sensors.camera
    assert camera is not None
    assert camera.eyes == eyes


def test_lidars_by_their_names():
    def lidar(name, **config):
        given = {"action_space": TWO, "sensor": ["STEREO_CAMERAS", name]}
        if config:
            given["lidar_config"] = config
        return metadata.parse(given).sensors.lidar

    plain = lidar("LIDAR")
    assert (plain.form, plain.beams, plain.min_range, plain.max_range) == ("ranges", 64, 0.15, 1.0)
    assert lidar("SECTOR_LIDAR").size == 8
    bins = lidar("DISCRETIZED_SECTOR_LIDAR")
    assert (bins.form, bins.sectors, bins.bins, bins.clip) == ("discretised", 8, 8, 2.0)
    own = lidar(
        "DISCRETIZED_SECTOR_LIDAR", num_sectors=16, num_values_per_sector=4, clipping_dist=1.5
    )
    assert (own.sectors, own.bins, own.clip, own.size) == (16, 4, 1.5, 64)


def test_sac_is_read_but_not_trained_here():
    given = {"action_space": RANGES, "action_space_type": "continuous", "training_algorithm": "sac"}
    assert metadata.parse(given).notes == ("asks for sac; the league trains by clipped PPO",)


def test_models_of_2019_ask_for_8_and_drive_4_as_in_the_original():
    fast = [{"steering_angle": a, "speed": v} for a, v in [(-30, 2.0), (0, 8.0), (30, 5.33)]]
    found = metadata.parse({"action_space": fast})
    assert found.action_space == DiscreteActions(((-30.0, 2.0), (0.0, 4.0), (30.0, 4.0)))
    assert found.notes == ("asks for 8 m/s; cars drive at most 4",)
    ranges = {"steering_angle": {"low": -20, "high": 20}, "speed": {"low": 1, "high": 6}}
    found = metadata.parse({"action_space": ranges, "action_space_type": "continuous"})
    assert found.action_space == ContinuousActions(-20.0, 20.0, 1.0, 4.0)
    with pytest.raises(ConfigError, match=r"choice 1: a speed is 8\.1 m/s: give 0\.1 to 4"):
        metadata.parse({"action_space": [*TWO[:1], {"steering_angle": 0, "speed": 8.1}]})


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"action_space": None}, "action_space is None"),
        ({"action_space": TWO[:1]}, "1 choices"),
        ({"action_space": [{"speed": 1.0}] * 2}, "steering_angle is missing"),
        ({"action_space": [TWO[0], {"steering_angle": 31, "speed": 1}]}, "31"),
        ({"action_space": [TWO[0], {"steering_angle": 0, "speed": 9}]}, "9.0 m/s"),
        ({"action_space": [TWO[0], {"steering_angle": 0, "speed": float("nan")}]}, "nan"),
        ({"action_space": RANGES}, "an object of ranges"),
        ({"action_space_type": "continuous"}, "is a list"),
        ({"action_space_type": "both"}, "action_space_type"),
        ({"sensor": ["STEREO_CAMERA"]}, "nearest: STEREO_CAMERAS"),
        ({"sensor": ["LIDAR"]}, "exactly one camera"),
        ({"sensor": ["LEFT_CAMERA", "STEREO_CAMERAS"]}, "exactly one camera"),
        ({"sensor": ["LEFT_CAMERA", "LIDAR", "SECTOR_LIDAR"]}, "at most one lidar"),
        ({"sensor": "LEFT_CAMERA"}, "sensor"),
        ({"version": "7"}, "version"),
        ({"neural_network": "TRANSFORMER"}, "neural_network"),
        ({"training_algorithm": "dqn"}, "training_algorithm"),
        ({"training_algorithm": "sac"}, "sac takes continuous"),
        (
            {
                "sensor": ["LEFT_CAMERA", "DISCRETIZED_SECTOR_LIDAR"],
                "lidar_config": {"num_sectors": 3},
            },
            "num_sectors is 3",
        ),
    ],
)
def test_what_describes_no_model_is_refused_in_one_sentence(change, says):
    with pytest.raises(ConfigError) as caught:
        metadata.parse({"action_space": TWO} | change, "m.json")
    assert str(caught.value).startswith("m.json: ")
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_metadata_is_read_from_a_file(tmp_path):
    path = tmp_path / "model_metadata.json"
    path.write_text(json.dumps({"action_space": TWO, "version": "5"}))
    assert metadata.read(path).version == "5"


@pytest.mark.parametrize(
    ("text", "says"), [("{", "no JSON"), ("[1]", "one object"), ("\xff", "no JSON")]
)
@pytest.mark.parametrize("room", [metadata, hyperparameters])
def test_file_that_is_no_json_object_is_refused(tmp_path, room, text, says):
    path = tmp_path / "x.json"
    path.write_text(text, encoding="latin-1")
    with pytest.raises(ConfigError, match=says):
        room.read(path)
    with pytest.raises(ConfigError, match="there is no file"):
        room.read(tmp_path / "none.json")


def test_hyperparameters_of_the_original_are_read_by_their_names(tmp_path):
    path = tmp_path / "hyperparameters.json"
    given = {
        "batch_size": 64,
        "beta_entropy": 0.01,
        "discount_factor": 0.99,
        "e_greedy_value": 0.05,
        "epsilon_steps": 10000,
        "exploration_type": "categorical",
        "loss_type": "huber",
        "lr": 0.0003,
        "num_episodes_between_training": 20,
        "num_epochs": 5,
        "stack_size": 1,
        "term_cond_avg_score": 350.0,
        "term_cond_max_episodes": 1000,
        "sac_alpha": 0.2,
    }
    path.write_text(json.dumps(given))
    found = hyperparameters.read(path)
    assert {name: getattr(found, name) for name in given} == given


def test_absent_hyperparameters_are_none_and_numbers_may_be_strings():
    found = hyperparameters.parse({"lr": "0.0003", "loss_type": "mean squared error"})
    assert (found.lr, found.loss_type, found.batch_size) == (0.0003, "mse", None)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"batchsize": 64}, "nearest: batch_size"),
        ({"learning_rate": 1, "entropy": 0}, "lr is 1: give 1e-08 to 0.1"),
        ({"lr": 0.5}, "give 1e-08 to 0.1"),
        ({"lr": float("nan")}, "finite"),
        ({"num_epochs": 0}, "give 1 to 100"),
        ({"num_epochs": 2.5}, "integer"),
        ({"num_epochs": True}, "True"),
        ({"discount_factor": 1.5}, "give 0 to 1"),
        ({"beta_entropy": None}, "None"),
        ({"loss_type": "l1"}, "mse or huber"),
        ({"stack_size": 4}, "give 1"),
    ],
)
def test_hyperparameter_out_of_range_is_refused_in_one_sentence(given, says):
    with pytest.raises(ConfigError) as caught:
        hyperparameters.parse(given, "h.json")
    assert str(caught.value).startswith("h.json: ")
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)
