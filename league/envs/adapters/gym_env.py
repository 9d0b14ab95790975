"""Races with one learner for Gymnasium, the other cars driven by given drivers: Env, VectorEnv."""

import os
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Unpack

import gymnasium
import numpy as np
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from league.agents.rollout import DriverPool
from league.envs import make
from league.envs.actions import checked
from league.envs.adapters import load_drivers, load_reward, spaces
from league.envs.adapters.rendering import EnvRenderer
from league.envs.driver import Driver
from league.envs.make import EnvOptions
from league.envs.race_env import RaceEnv, Step
from league.errors import ActionError, ConfigError, brief
from league.sim.config import RaceKind
from league.track.track import Track, TrackSet

Observation = dict[str, np.ndarray]

DEFAULT_OPPONENTS = ("centerline",)  # opponents in a head_to_head race unless others are given


class LearnerEnv:
    """A batch of races in which car `car` learns and drivers drive the others."""

    def __init__(
        self,
        track: str | os.PathLike[str] | Track | TrackSet,
        kind: RaceKind,
        sensors: make.Carried,
        *,
        num_worlds: int = 1,
        car: int = 0,
        opponents: Sequence[Driver | str] | None = None,
        **options: Unpack[EnvOptions],
    ) -> None:
        make.check_whole("num_envs", num_worlds, 1)
        tracks = make.course(track)
        racing = kind == "head_to_head"
        if opponents is None:
            opponents = DEFAULT_OPPONENTS if racing else ()
        options.setdefault("mode", "training")
        sim = make.world(options.get("sim"))
        drivers = load_drivers(opponents, tracks, sim.car) if opponents else ()
        if drivers and kind == "time_trial":
            raise ConfigError(
                f"{len(drivers)} opponents are given for a time_trial race, which is driven alone: "
                "give none, or choose head_to_head"
            )
        make.check_whole("car", car, 0)
        if car > len(drivers):
            raise ConfigError(f"car is {car}: the field has {len(drivers) + 1} cars, from 0")
        field, own = [*drivers[:car], None, *drivers[car:]], make.sensors_of_car(sensors)
        cfg = make.configure(
            kind=kind,
            sensors=tuple(own if driver is None else driver.sensors for driver in field),
            num_cars=len(field),
            restarting=tuple(slot for slot in range(len(field)) if slot != car),
            **options,
        )
        reward = load_reward(options.get("reward"), tracks, cfg, num_worlds, (car,))
        self.env, self.car = RaceEnv(tracks, cfg, num_worlds=num_worlds, reward=reward), car
        self.sensors, self.infos = cfg.sensors_of(car), spaces.Infos(self.env, car)
        self._drivers = DriverPool([field] * num_worlds, strict=True)

    def reset(self, seeds: list[int]) -> Mapping[str, np.ndarray]:
        """Start all races; return the learner's observations."""
        self._drivers.reset()
        return self.env.reset(seeds=seeds)[self.car]

    def step(
        self, actions: np.ndarray, restart: np.ndarray | None = None, seeds: list[int] | None = None
    ) -> Step:
        """Drive the learner by (num_worlds, 2) actions, the others by drivers; see RaceEnv.step."""
        driven = self._drivers.act(self.env.observations)
        driven[:, self.car] = actions
        step = self.env.step(driven, restart=restart, seeds=seeds)
        self._drivers.reset(step.began)
        return step

    def restart(self, worlds: np.ndarray, seeds: list[int]) -> None:
        """Start some races again between two steps; bool (num_worlds,), see RaceEnv."""
        self.env.restart(worlds, seeds)
        self._drivers.reset(np.broadcast_to(worlds[:, None], self.env.world.cars.shape))


class Seeds:
    """The generators from which a batch of races draws its seeds, as Gymnasium's own vectors do."""

    def __init__(self, num_envs: int) -> None:
        made = [np_random() for _ in range(num_envs)]
        self.generators = [generator for generator, _ in made]
        self.generator_seeds = [seed for _, seed in made]
        self.begun = False
        """Whether `restart` was called."""

    def restart(self, seed: int | Sequence[int | None] | None, which: np.ndarray) -> list[int]:
        """Return seeds for the races that restart; the others keep their generators, undrawn.

        `seed` is that of the first race, from which the next ones count up, or one for each; None
        goes on to other races.
        """
        number = len(self.generators)
        if seed is None or isinstance(seed, str) or not isinstance(seed, Iterable):
            first = None if seed is None else make.checked_seed(seed)
            seeds = [None if first is None else first + race for race in range(number)]
        else:
            seeds = [None if one is None else make.checked_seed(one) for one in seed]
        if len(seeds) != number:
            raise ConfigError(f"{len(seeds)} seeds for {number} races: give one for each")
        for race, one in enumerate(seeds):
            if one is not None and which[race]:
                self.generators[race], self.generator_seeds[race] = np_random(one)
        self.begun = True
        return self.draw(which)

    def draw(self, which: np.ndarray) -> list[int]:
        """Return seeds for the races that restart; the others draw none."""
        pairs = zip(self.generators, which, strict=True)
        return [make.draw_seed(generator) if over else 0 for generator, over in pairs]


class GymEnv(gymnasium.Env[Any, np.ndarray]):
    """One race, or in training one episode of the learner in it.

    Observations are dicts of the groups its car carries (docs/observations.md), actions are
    float32 [steering, speed] in [-1, 1].
    """

    metadata = {"render_modes": ["rgb_array", "human"], "render_fps": 15}  # noqa: RUF012

    def __init__(
        self,
        track: str | os.PathLike[str] | Track = "reinvent_2018",
        kind: RaceKind = "time_trial",
        *,
        sensors: make.Carried = make.BOTH,
        car: int = 0,
        opponents: Sequence[Driver | str] | None = None,
        privileged: bool = False,
        render_mode: str | None = None,
        view: str = "chase",
        **options: Unpack[EnvOptions],
    ) -> None:
        """Set up the race.

        Args:
            track: name of a track, path of its .yaml file, or a Track.
            kind: time_trial, obstacle_avoidance or head_to_head.
            sensors: of the learner: stereo and lidar, or CameraConfig and LidarConfig.
            car: grid slot of the learner, 0 in front.
            opponents: names or drivers of the other slots; in head_to_head one by default.
            privileged: whether the learner also observes the truth, as group `state`.
            render_mode: rgb_array for pictures, human for the live viewer, or None.
            view: of pictures: chase, from behind the learner, or top.
            options: see league.envs.make.EnvOptions; training is the default mode and planar the
                default solver here.

        Raises:
            LeagueError: an unknown track or name, or settings that contradict each other.
        """
        make.check_options(options, GymEnv.__init__)
        self.learner = LearnerEnv(track, kind, sensors, car=car, opponents=opponents, **options)
        self.render_mode = render_mode
        self._renderer = EnvRenderer(self.learner.env, render_mode, view, car)
        self.observation_space = spaces.observation_space(self.learner.sensors, privileged)
        self._reader = spaces.ObservationReader(self.observation_space)
        self.action_space = spaces.action_space()
        self._over = True

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start a race or episode from a seed; None goes on to another. `options` is not used."""
        super().reset(seed=None if seed is None else make.checked_seed(seed))
        groups = self.learner.reset([make.draw_seed(self.np_random)])
        self._over = False
        self._renderer.reset()
        return self._reader.read(groups), self.learner.infos.of_first(None)

    def step(self, action: np.ndarray) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Drive for 1/15 s; ActionError if the action is not sound, or the race over."""
        if self._over:
            raise ActionError("step was called on a race that is over or not begun: call reset")
        step, car = self.learner.step(checked(action, "the learner")), self.learner.car
        self._renderer.update()
        terminated, truncated = step.terminated.item(0, car), step.truncated.item(0, car)
        self._over = terminated or truncated
        observation = self._reader.read(step.observations[car])
        info = self.learner.infos.of_first(step)
        return observation, step.rewards.item(0, car), terminated, truncated, info

    def render(self) -> np.ndarray | None:
        """Return a picture, uint8 (height, width, 3), or show the race in the live viewer."""
        return self._renderer.render()

    def close(self) -> None:
        """Close the physics engine and the viewer; may be called twice."""
        self._renderer.close()
        self.learner.env.close()


class GymVectorEnv(VectorEnv[Observation, np.ndarray, np.ndarray]):
    """Races stepped as one batch; each equals a GymEnv of the same seed.

    A race that has ended is restarted by the next step, which ignores its action and has no reward
    (AutoresetMode.NEXT_STEP), as in Gymnasium's own vectors.
    """

    metadata = {  # noqa: RUF012
        "render_modes": [],
        "render_fps": 15,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        track: str | os.PathLike[str] | Track | TrackSet = "reinvent_2018",
        kind: RaceKind = "time_trial",
        *,
        sensors: make.Carried = make.BOTH,
        car: int = 0,
        opponents: Sequence[Driver | str] | None = None,
        privileged: bool = False,
        render_mode: str | None = None,
        max_episode_steps: int | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        **options: Unpack[EnvOptions],
    ) -> None:
        """Set up the races, by the arguments of GymEnv.

        `track` may also be a TrackSet: the races take its tracks in turn; a driver in `opponents`
        serves all races; `max_episode_steps` is Gymnasium's name for `max_steps`. A batch is not
        drawn, so `render_mode` is None. With `autoreset_mode` SAME_STEP a race that has ended is
        restarted at once, its last observation and info in the info's `final_obs` and
        `final_info`; with DISABLED by `reset(options={"reset_mask": ended})`.
        """
        if render_mode is not None:
            raise ConfigError(
                f"render_mode is {render_mode!r}: a batch is not drawn, give None, or choose "
                "vectorization_mode='sync'"
            )
        make.check_options(options, GymVectorEnv.__init__)
        make.set_longest(options, "max_episode_steps", max_episode_steps)
        self.learner = LearnerEnv(
            track, kind, sensors, num_worlds=num_envs, car=car, opponents=opponents, **options
        )
        modes = [mode.value for mode in AutoresetMode]
        if autoreset_mode not in (*AutoresetMode, *modes):
            raise ConfigError(
                f"autoreset_mode is {autoreset_mode!r}: choose one of {', '.join(modes)}"
            )
        self.num_envs, self.autoreset_mode = num_envs, AutoresetMode(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self.single_observation_space = spaces.observation_space(self.learner.sensors, privileged)
        self.single_action_space = spaces.action_space()
        self.observation_space = spaces.batched(self.single_observation_space, num_envs)
        self._reader = spaces.ObservationReader(self.observation_space)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._seeds = Seeds(num_envs)
        self._done = np.zeros(num_envs, dtype=bool)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observation, dict[str, Any]]:
        """Start all races.

        `seed` is that of the first race, from which the next ones count up, or one for each; None
        goes on to other races. `options` may hold a `reset_mask`, bool (num_envs,), of the races
        to start; the others go on.
        """
        if not isinstance(options, Mapping | None):
            raise ConfigError(
                f"options is {brief(options)}: give a dict, such as "
                '{"reset_mask": ended}, or None'
            )
        mask = None if options is None else options.get("reset_mask")
        if mask is None:
            which = np.ones(self.num_envs, bool)
            groups = self.learner.reset(self._seeds.restart(seed, which))
        else:
            which = self._checked_mask(mask)
            self.learner.restart(which, self._seeds.restart(seed, which))
            groups = self.learner.env.observations[self.learner.car]
        self._done &= ~which
        return self._reader.read(groups), spaces.masked(self.learner.infos.of_all(None), which)

    @property
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore
        """The generators from which the races draw their seeds, as in Gymnasium's own vectors."""
        return tuple(self._seeds.generators)

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore
        """The seeds of these generators."""
        return tuple(self._seeds.generator_seeds)

    def _checked_mask(self, mask: object) -> np.ndarray:
        if not self._seeds.begun:
            raise ConfigError("a reset_mask was given to the first reset: omit it there")
        shape = (self.num_envs,)
        if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_ or mask.shape != shape:
            raise ConfigError(
                f"reset_mask is {brief(mask)}: give a NumPy array of {self.num_envs} bools, "
                "one for each race"
            )
        return mask

    def step(
        self, actions: np.ndarray
    ) -> tuple[Observation, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Drive all for 1/15 s, or restart those that have ended; ActionError as `checked`."""
        if not self._seeds.begun:
            raise ActionError("step was called before the first reset: call reset")
        actions, ended = checked(actions, "the learners", rows=self.num_envs), self._done
        if ended.any() and self.autoreset_mode != AutoresetMode.NEXT_STEP:
            raise ActionError(
                f"step was called while race {int(ended.argmax())} is over: call "
                'reset(options={"reset_mask": ended})'
            )
        seeds = self._seeds.draw(ended) if ended.any() else None
        step = self.learner.step(actions, None if seeds is None else ended, seeds)
        car = self.learner.car
        terminated, truncated = step.terminated[:, car] & ~ended, step.truncated[:, car] & ~ended
        rewards = np.where(ended, 0.0, step.rewards[:, car].astype(np.float64))
        observations = self._reader.read(step.observations[car])
        info = self.learner.infos.of_all(step)
        if seeds is not None:
            info = spaces.mixed(ended, self.learner.infos.of_all(None), info)
        done = terminated | truncated
        if self.autoreset_mode == AutoresetMode.SAME_STEP and done.any():
            observations, info = self._restarted(done, observations, info)
        else:
            self._done, info = done, spaces.masked(info, np.ones(self.num_envs, bool))
        return observations, rewards, terminated, truncated, info

    def _restarted(
        self, done: np.ndarray, final: Observation, info: dict[str, Any]
    ) -> tuple[Observation, dict[str, Any]]:
        """Restart races; return what they observe, and infos with what they observed last."""
        last = np.full(self.num_envs, None, object)
        for race in np.flatnonzero(done):
            last[race] = {name: values[race] for name, values in final.items()}
        self.learner.restart(done, self._seeds.draw(done))
        begun = spaces.mixed(done, self.learner.infos.of_all(None), info)
        ended = {"final_obs": last, "final_info": spaces.masked(info, done)}
        masks = {f"_{name}": done for name in ended}
        observations = self._reader.read(self.learner.env.observations[self.learner.car])
        return observations, spaces.masked(begun, np.ones(self.num_envs, bool)) | ended | masks

    def close_extras(self, **kwargs: Any) -> None:  # noqa: ANN401
        """Close the physics engine."""
        self.learner.env.close()
