from __future__ import annotations

import pytest
import torch

from league.envs.actions import ActionSpace, ContinuousActions, DiscreteActions, grid
from league.envs.adapters.rsl_vec_env import RacingVecEnv, checked_device
from league.envs.config import EnvConfig, RewardConfig
from league.errors import ActionError, ConfigError, PolicyError
from league.sim.config import CameraConfig, LidarConfig, SensorConfig, SimConfig
from league.track.track import TrackSet
from tests.envs.vec_env_kit import check_rows_are_apart, check_steps, check_vec_env
from tests.scenes import follow_center, make_ring

NUMBERS = (
    *(torch.float32, torch.float64, torch.float16, torch.bfloat16),
    *(torch.int64, torch.int32, torch.int16, torch.int8, torch.uint8),
)
SMALL = SensorConfig(camera=CameraConfig(width=32, height=24), lidar=LidarConfig(beams=16))


class Follower:
    """Follows the centreline and remembers which rows were reset."""

    def __init__(self, name: str = "follower", sensors: SensorConfig | None = None) -> None:
        self.name, self.sensors = name, sensors or SensorConfig()
        self.forgotten: list[list[int] | None] = []

    def reset(self, rows: torch.Tensor | None) -> None:
        self.forgotten.append(None if rows is None else rows.tolist())

    def act(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        return follow_center(observations)


def build(
    num_worlds: int,
    *,
    cars: int = 1,
    learners: tuple[int, ...] = (0,),
    opponents: dict | None = None,
    sensors: SensorConfig | tuple[SensorConfig, ...] = SMALL,
    action_space: ActionSpace | None = None,
    seed: int = 3,
    **settings: object,
) -> RacingVecEnv:
    kind = "head_to_head" if cars > 1 else "time_trial"
    cfg = EnvConfig(
        **{  # pyright: ignore[reportArgumentType]
            "sim": SimConfig(kind=kind, num_cars=cars),
            "sensors": sensors if isinstance(sensors, tuple) else (sensors,),
            "mode": "training",
            "episode_s": 4.0,
            "reward": RewardConfig(lap=1.0),
            **settings,
        }
    )
    return RacingVecEnv(
        TrackSet(make_ring()),
        cfg,
        num_worlds=num_worlds,
        learners=learners,
        opponents=opponents,
        action_space=action_space,
        seed=seed,
    )


@pytest.mark.parametrize("num_worlds", [1, 3])
def test_one_learner_alone_conforms_to_rsl_rl(num_worlds):
    check_vec_env(lambda: build(num_worlds))


@pytest.mark.parametrize("num_worlds", [1, 3])
def test_two_learners_in_each_world_conform_to_rsl_rl(num_worlds):
    check_vec_env(
        lambda: build(num_worlds, cars=2, learners=(0, 1), sensors=SensorConfig()),
        rows_per_world=2,
    )


@pytest.mark.parametrize("num_worlds", [1, 3])
def test_a_learner_among_driven_cars_conforms_to_rsl_rl(num_worlds):
    check_vec_env(
        lambda: build(
            num_worlds,
            cars=3,
            learners=(1,),
            opponents={0: Follower(), 2: Follower()},
            sensors=SensorConfig(lidar=LidarConfig(beams=8)),
        )
    )


@pytest.mark.parametrize("num_worlds", [1, 3])
def test_rows_count_worlds_first_and_learners_within(num_worlds):
    env = build(num_worlds, cars=3, learners=(2, 0), opponents={1: Follower()})
    assert env.num_envs == 2 * num_worlds
    actions = torch.zeros(env.num_envs, 2)
    actions[:, 0] = torch.arange(env.num_envs) / 10.0  # row r steers by r / 10
    env.step(actions)
    driven = env.race_env.last_action
    for world in range(num_worlds):
        assert float(driven[world, 2, 0]) == pytest.approx((2 * world) / 10)
        assert float(driven[world, 0, 0]) == pytest.approx((2 * world + 1) / 10)


def test_groups_have_the_shapes_of_the_sensors_and_pictures_are_shares_of_white():
    obs = build(3).get_observations()
    assert {name: tuple(group.shape) for name, group in obs.items()} == {
        "stereo": (3, 2, 24, 32),
        "lidar": (3, 16),
        "motion": (3, 5),
        "state": (3, 40),
    }
    assert 0.0 <= float(obs["stereo"].min()) < float(obs["stereo"].max()) <= 1.0
    in_bytes = obs["stereo"] * 255
    assert torch.allclose(in_bytes, in_bytes.round(), atol=1e-4)


def test_a_row_that_restarts_observes_no_action_of_its_past():
    env = build(2, sensors=SensorConfig())
    env.step(torch.full((2, 2), 0.5))
    env.episode_length_buf = torch.tensor([59, 0])  # 4 s are 60 steps
    obs, _, dones, extras = env.step(torch.full((2, 2), 0.5))
    assert dones.tolist() == [1, 0] and extras["time_outs"].tolist() == [True, False]
    # speed, yaw rate, steering, last steering, last speed
    assert obs["motion"][0].tolist() == [0.0, 0.0, 0.0, 0.0, -1.0]
    assert obs["motion"][1, 3:].tolist() == [0.5, 0.5]


def test_a_mistake_is_no_time_out():
    env = build(1, sensors=SensorConfig())
    for _ in range(60):
        _, rewards, dones, extras = env.step(torch.tensor([[-1.0, 0.2]]))
        if dones[0]:
            break
    assert dones[0] and not extras["time_outs"][0]
    assert float(extras["log"]["/mistake/off_track"]) == 1.0
    assert float(extras["log"]["/reward/off_track"]) == -1.0
    assert float(rewards[0]) < -0.5


def test_opponents_drive_and_are_reset_when_their_car_restarts():
    follower = Follower()
    env = build(2, cars=2, opponents={1: follower}, sensors=SensorConfig())
    assert follower.forgotten == [None]
    for step in range(60):
        env.step(torch.tensor([[0.0, -1.0], [0.0, -1.0]]))
        if step == 29:  # 2 s at up to 1.5 m/s
            assert (env.race_env.world.cars["distance"][:, 1] > 1.5).all()
    # The opponents' episodes end after 60 steps, as everybody's.
    assert follower.forgotten[-1] == [0, 1]


def test_opponents_carry_what_their_drivers_need():
    env = build(1, cars=2, opponents={1: Follower(sensors=SMALL)}, sensors=SensorConfig())
    assert env.race_env.cfg.sensors_of(1) == SMALL
    assert set(env.get_observations().keys()) == {"motion", "state"}


def test_opponents_may_be_named():
    env = build(1, cars=2, opponents={1: "centerline"}, sensors=SensorConfig())
    env.step(torch.zeros(1, 2))
    assert float(env.race_env.last_action[0, 1, 1]) > -1.0
    with pytest.raises(PolicyError, match="there is no driver 'centreline'"):
        build(1, cars=2, opponents={1: "centreline"})


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"mode": "race"}, "rows have episodes of their own"),
        ({"cars": 2}, "each of the 2 cars"),
        ({"learners": ()}, "one must learn"),
        ({"cars": 2, "learners": (0, 0)}, "each of the 2 cars"),
        (
            {"cars": 2, "learners": (0, 1), "sensors": (SMALL, SensorConfig())},
            "different sensors",
        ),
    ],
)
def test_a_field_that_cannot_be_is_refused(settings, sentence):
    with pytest.raises(ConfigError, match=sentence):
        build(1, **settings)


@pytest.mark.parametrize("name", ["meta", "cuda:99", "hpu", "xla", "abacus", "", "cpu:-1"])
def test_a_device_that_does_not_compute_is_refused_and_those_that_do_are_named(name):
    with pytest.raises(ConfigError, match=rf"on the device '{name}': give cpu, or .* here: cpu"):
        checked_device(name)


def test_the_cpu_computes():
    assert checked_device("cpu") == torch.device("cpu")


def test_one_driver_object_cannot_drive_two_cars():
    driver = Follower()
    with pytest.raises(ConfigError, match="mix their memories"):
        build(1, cars=3, opponents={1: driver, 2: driver})


@pytest.mark.parametrize("space", [None, ContinuousActions()])
@pytest.mark.parametrize(
    ("actions", "sentence"),
    [
        (torch.full((1, 2), torch.nan), r"the action of row 0 is \[nan, nan\]"),
        (torch.tensor([[0.0, torch.inf]]), r"row 0 is \[0.0, inf\]: give finite numbers"),
        (torch.tensor([[-torch.inf, 0.0]]), "give finite numbers"),
        (torch.zeros(2, 2), r"shape \(2, 2\): expected \(1, 2\)"),
        (torch.zeros(1, 3), r"shape \(1, 3\)"),
        (torch.zeros(2), r"shape \(2,\)"),
        (torch.zeros(1, 2, dtype=torch.bool), r"real numbers .* shape \(1, 2\), \(rows, actions"),
        (torch.zeros(1, 2, dtype=torch.complex64), "expected real numbers"),
        ([["a", 0.0]], r"the action of the rows is \[\['a', 0.0\]\]: expected real numbers"),
        (None, "None: expected real numbers"),
    ],
)
def test_actions_that_are_none_are_refused(actions, sentence, space):
    env = build(1, sensors=SensorConfig(), action_space=space)
    before = env.race_env.world
    with pytest.raises(ActionError, match=sentence) as refusal:
        env.step(actions)
    assert "\n" not in str(refusal.value)
    assert env.race_env.world is before


def test_the_refusal_names_the_row_that_left_the_numbers():
    actions = torch.zeros(3, 2)
    actions[1, 0] = torch.nan
    with pytest.raises(ActionError, match="the action of row 1 is"):
        build(3, sensors=SensorConfig()).step(actions)


@pytest.mark.parametrize("dtype", NUMBERS)
@pytest.mark.parametrize("space", [None, ContinuousActions(), grid(3, 30, 2, 3)])
def test_actions_may_be_of_any_numbers(dtype, space):
    env = build(2, sensors=SensorConfig(), action_space=space)
    env.step(torch.ones(2, env.num_actions).to(dtype))
    # Full left and the largest speed, or the first choice: 30 deg and half of 3 m/s.
    speed = 1.0 if not isinstance(space, DiscreteActions) else 2 * (1.5 - 0.1) / 3.9 - 1
    last = env.race_env.last_action[:, 0].tolist()
    assert last == [pytest.approx([1.0, speed], abs=0.02)] * 2


@pytest.mark.parametrize("size", [1.5, 1e30])
def test_finite_actions_beyond_the_range_are_cut_off_there(size):
    env = build(1, sensors=SensorConfig())
    env.step(torch.tensor([[size, -size]], dtype=torch.float64))
    assert env.race_env.last_action.tolist() == [[[1.0, -1.0]]]


def test_no_step_holds_on_to_a_gradient():
    env = build(1, sensors=SensorConfig())
    obs, rewards, *_ = env.step(torch.zeros(1, 2, requires_grad=True))
    assert not rewards.requires_grad and not obs["motion"].requires_grad


class ForgetsWhy(RacingVecEnv):
    """Calls every end a time-out."""

    def step(self, actions):
        obs, rewards, dones, extras = super().step(actions)
        return obs, rewards, dones, {**extras, "time_outs": dones.to(torch.bool)}


class LogsAtTimes(RacingVecEnv):
    """Logs what happened only when it happened."""

    def step(self, actions):
        obs, rewards, dones, extras = super().step(actions)
        log = {name: value for name, value in extras["log"].items() if value != 0}
        return obs, rewards, dones, {**extras, "log": log}


class RestartsAll(RacingVecEnv):
    """Restarts every row when one has ended."""

    def step(self, actions):
        _, rewards, dones, extras = super().step(actions)
        if dones.any():
            self.race_env.reset(seed=1)
            self.race_env.step(self.race_env.last_action)
        return self.get_observations(), rewards, dones, extras


@pytest.mark.parametrize(
    ("broken", "check", "sentence"),
    [
        (ForgetsWhy, check_steps, "a time-out before its time"),
        (LogsAtTimes, check_steps, "log keys change"),
        (RestartsAll, lambda env: check_rows_are_apart(lambda: remade(env), 1), "restart of row 0"),
    ],
)
def test_the_kit_finds_a_broken_environment(broken, check, sentence):
    env = build(3, sensors=SensorConfig())
    env.__class__ = broken
    with pytest.raises(AssertionError, match=sentence):
        check(env)


def remade(env: RacingVecEnv) -> RacingVecEnv:
    again = build(3, sensors=SensorConfig())
    again.__class__ = env.__class__
    return again
