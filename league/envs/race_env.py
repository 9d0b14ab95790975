"""RaceEnv: the one owner of the worlds' records; a batched reset and a batched step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from league.envs import episodes, observations, rewards, scenarios
from league.envs import step as stages
from league.envs.config import EnvConfig, RewardConfig, Scenarios
from league.envs.rewards import Reward
from league.envs.sensor_suite import SensorSuite
from league.errors import ActionError, ConfigError, WorldError
from league.sim import records, rng
from league.sim.physics import planar
from league.sim.records import World
from league.sim.settings import settings
from league.threads import shared_out
from league.track.track import TrackSet

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from league.sim.camera.renderer import Renderer

Observations = tuple[Mapping[str, np.ndarray], ...]
"""For each car its groups, each with leading axis num_worlds."""

_WORLD_SEED = 301


@dataclass(frozen=True, eq=False)
class Step:
    """Result of one step, (num_worlds, num_cars) unless said otherwise.

    The arrays belong to the environment, which overwrites them at the next step: copy what is kept.
    """

    observations: Observations  # for each car its groups, of the worlds after restarts
    rewards: np.ndarray  # weighted sum of the reward terms, of the worlds before restarts, float32
    terminated: np.ndarray  # the car has finished, or in training made a mistake, bool
    truncated: np.ndarray  # time is up, bool
    verdicts: np.ndarray  # the referee's findings, VERDICT records
    log: Mapping[str, np.ndarray]  # each weighted reward term by name, float32
    began: np.ndarray  # the car began another episode by the end of the step, bool
    # in training with scenarios: another car was within 1.5 m along the track, bool
    near: np.ndarray
    attack: np.ndarray  # there: how the car's attack ended in this step, uint8; see scenarios.py


class RaceEnv:
    """Races of one kind in a batch of worlds.

    In mode "race" mistakes cost penalty seconds and end no race; when the race is over, `step` goes
    on harmlessly until `reset`. In mode "training" each car has episodes of its own: a mistake, a
    finish or the time limit ends the episode, and the car is restarted on a free stretch in the
    same step (same-step autoreset); the other cars drive on.

    Actions are float32 (num_worlds, num_cars, 2) in [-1, 1]: steering (1 is full left) and speed
    (-1 is the smallest, 1 the largest command).
    """

    def __init__(
        self,
        tracks: TrackSet,
        cfg: EnvConfig,
        *,
        num_worlds: int = 1,
        seed: int = 0,
        track_index: ArrayLike | None = None,
        reward: Reward | None = None,
        renderers: Mapping[int, Renderer] | None = None,
    ) -> None:
        """Build the worlds and put them on the grid.

        Args:
            tracks: courses to race on.
            cfg: settings.
            num_worlds: races in the batch.
            seed: makes the worlds' own seeds, unless `reset` is given some.
            track_index: track of each world, (num_worlds,); by default they take turns.
            reward: None: the built-in terms by the weights of `cfg.reward`.
            renderers: of cars that do not see by pictures painted here.
        """
        if num_worlds < 1:
            raise ValueError(f"num_worlds is {num_worlds}: give at least 1")
        open_tracks = [track.name for track in tracks.tracks if not track.closed]
        if cfg.sim.rules.start == "pursuit" and open_tracks:
            raise ConfigError(
                f"{open_tracks[0]} is an open track, and the cars of a pursuit start round a lap: "
                "choose a closed track, or a standing start"
            )
        self.tracks, self.cfg, self.num_worlds = tracks, cfg, num_worlds
        self._per_thread = stages.worlds_per_thread(cfg.sim.num_cars)
        self._reward, self._closed = reward, False
        self._allocate()
        if track_index is None:
            track_index = np.arange(num_worlds) % len(tracks.tracks)
        self._world.worlds["track"] = self._tracks_of_worlds(track_index)
        self._solver = None
        if cfg.solver == "bullet":
            from league.sim.physics.bullet import BulletSolver  # late: PyBullet takes a while

            self._solver = BulletSolver(cfg.sim, tracks.rooms, num_worlds)
        self._sensors = SensorSuite(tracks, cfg, renderers)
        self._result = self._result_views()
        self._begin(seed, None)

    def _allocate(self) -> None:
        """Allocate all arrays, once: compiled code writes into them in place."""
        sim = self.cfg.sim
        shape = self.num_worlds, sim.num_cars
        obstacle_shape = self.num_worlds, sim.num_obstacles
        self._world = World(
            worlds=np.zeros(self.num_worlds, records.WORLD),
            cars=np.zeros(shape, records.CAR),
            obstacles=np.zeros(obstacle_shape, records.OBSTACLE),
        )
        self._before = np.zeros(shape, records.CAR)
        self._arrivals = np.zeros(obstacle_shape, records.OBSTACLE)
        self._controls = np.zeros((*shape, 2), np.float32)
        self._contacts = np.zeros(shape, records.CONTACT)
        self._verdicts = np.zeros(shape, records.VERDICT)
        self._outcomes = np.zeros(shape, stages.OUTCOME)
        self._encounters = np.zeros(self.num_worlds, scenarios.ENCOUNTER)
        self._terms = np.zeros((*shape, len(rewards.TERMS)), np.float32)
        self._motions = np.zeros((sim.num_cars, self.num_worlds, 5), np.float32)
        self._settings, self._episodes = settings(sim), episodes.settings(self.cfg)
        self._places = np.array(sim.obstacles.places, np.float32).reshape(-1, 2)
        weight = self._weight = rewards.weights(self.cfg.reward)
        course = (self.tracks.points, self.tracks.courses, self._places)
        self._step_arrays = (
            *(self._world.cars, self._before, self._world.obstacles, self._arrivals),
            *(self._world.worlds, self._controls, self._contacts, self._verdicts, self._outcomes),
            *(self._encounters, self._terms, self._motions),
            weight if self._reward is None else weight[:0],
            *(*course, planar.schedule(sim.num_cars), self._settings, self._episodes),
        )
        self._reset_arrays = (
            *(self._encounters, self._world.cars, self._world.obstacles, self._world.worlds),
            self._motions,
            *(*course, self._settings, self._episodes),
        )

    def _result_views(self) -> Step:
        """Return the result of every `step`: views of the arrays, and a Python reward's log."""
        built_in = {
            name: self._terms[..., rewards.TERMS.index(name)] for name in self.cfg.reward.terms
        }
        same = ("terminated", "truncated", "began", "near", "attack")
        return Step(
            observations=self._sensors.groups(self._world, self._motions),
            rewards=self._outcomes["reward"],
            verdicts=self._verdicts,
            log=built_in if self._reward is None else {},
            **{name: self._outcomes[name] for name in same},
        )

    @property
    def world(self) -> World:
        """The worlds now; live, see World."""
        return self._world

    @property
    def observations(self) -> Observations:
        """For each car its groups, of the worlds as they are now; live."""
        return self._result.observations

    @property
    def terms(self) -> tuple[str, ...]:
        """Names under which the reward is logged."""
        return self.cfg.reward.terms if self._reward is None else self._reward.terms

    @property
    def num_cars(self) -> int:
        """Cars in each world."""
        return self.cfg.sim.num_cars

    @property
    def last_action(self) -> np.ndarray:
        """A copy of the actions of the last step, float32 (num_worlds, num_cars, 2)."""
        cars = self._world.cars
        return np.stack([cars["action_steering"], cars["action_speed"]], axis=-1)

    @property
    def time_s(self) -> np.ndarray:
        """Time since the start of each race [s], float64 (num_worlds,)."""
        return self._world.worlds["step"] * self.cfg.sim.step_dt

    @property
    def episode_steps(self) -> np.ndarray:
        """Steps since each car's episode began, int32, (num_worlds, num_cars)."""
        return self._world.cars["episode_steps"]

    @episode_steps.setter
    def episode_steps(self, steps: np.ndarray) -> None:
        """Set the episodes' ages, so that not all end at the same time."""
        self._world.cars["episode_steps"] = steps

    def change_scenarios(self, scenarios: Scenarios) -> None:
        """Change `EnvConfig.scenarios` from the next episodes on."""
        self.cfg = replace(self.cfg, scenarios=scenarios)
        self._episodes[:] = episodes.settings(self.cfg)

    def change_weights(self, reward: RewardConfig) -> None:
        """Change the weights of the built-in reward; the same terms count as before."""
        self.cfg = replace(self.cfg, reward=reward)
        self._weight[:] = rewards.weights(reward)

    @property
    def longest_episode(self) -> int:
        """Steps after which an episode is cut off in training."""
        return int(self._episodes[0]["longest"])

    def reset(
        self,
        seed: int | None = None,
        seeds: ArrayLike | None = None,
        track_index: ArrayLike | None = None,
    ) -> Observations:
        """Start all races; nothing of the past remains.

        Args:
            seed: makes the worlds' own seeds; None goes on to fresh ones.
            seeds: or each world's seed itself, int64, (num_worlds,).
            track_index: other tracks than before for the worlds, (num_worlds,).

        Raises:
            ConfigError: both seed and seeds are given, or the environment was closed.
        """
        self._check_open()
        if seed is not None and seeds is not None:
            raise ConfigError("reset has both a seed and the worlds' seeds: give one of them")
        if track_index is not None:
            self._world.worlds["track"] = self._tracks_of_worlds(track_index)
        self._begin(self._seed + 1 if seed is None else seed, seeds)
        self._sensors.observe(self._world)
        return self._result.observations

    def step(
        self,
        actions: ArrayLike,
        *,
        restart: np.ndarray | None = None,
        seeds: ArrayLike | None = None,
    ) -> Step:
        """Drive all cars for one control step (1/15 s); see step.py for its order.

        Args:
            actions: steering and speed in [-1, 1], (num_worlds, num_cars, 2).
            restart: worlds that are started again at the end of the step, as `reset` would, bool,
                (num_worlds,); verdicts and rewards are still of the race that was.
            seeds: seeds of the worlds that are restarted (those of others are not read), int64,
                (num_worlds,).

        Raises:
            ActionError: the wrong shape, or a number that is not in [-1, 1].
            ConfigError: `restart` without `seeds`, or the other way round.
            WorldError: a car's state is NaN or infinite.
        """
        self._check_open()
        if (restart is None) != (seeds is None):
            raise ConfigError("step has either restart or seeds alone: give both, or neither")
        actions = np.ascontiguousarray(actions, np.float32)
        if actions.shape != self._controls.shape:
            raise ActionError(
                f"actions have shape {actions.shape}: expected {self._controls.shape}, "
                "(num_worlds, num_cars, [steering, speed])"
            )
        if self._solver is None and self._reward is None:
            self._run(stages.ALL, actions)
        else:
            self._run_in_parts(actions)
        if self._reward is not None and self._outcomes["began"].any():
            self._reward.restart(self._world, self._outcomes["began"])
        if self.cfg.mode == "race":
            self._sensors.refresh_after(self._verdicts)
        else:
            self._sensors.refresh(self._outcomes["began"] | self._verdicts["released"])
        if restart is not None and seeds is not None and restart.any():
            self._restart(restart, np.asarray(seeds, np.int64))
        self._sensors.observe(self._world)
        return self._result

    def restart(self, worlds: np.ndarray, seeds: ArrayLike) -> None:
        """Start some races again between two steps; bool and int64 seeds, both (num_worlds,)."""
        self._check_open()
        which = np.flatnonzero(worlds)
        self._start(which, np.asarray(seeds, np.int64)[which])
        self._sensors.observe_again(self._world, which)

    def restore(self, snapshot: World) -> None:
        """Go on from a snapshot, as a search over actions does.

        Args:
            snapshot: `world.copy()` of an earlier moment, or `rows` of it, as many worlds as here.

        Raises:
            ConfigError: Bullet, training and sensors with readings of earlier steps keep more than
                the records of a snapshot.
        """
        if self._solver is not None or self._sensors.remembers or self.cfg.mode != "race":
            raise ConfigError(
                "only planar races with sensors that keep nothing go on from a snapshot: give mode "
                "'race', solver 'planar', one frame, no history, and cameras and lidars "
                f"that read at every step, {self.cfg.sim.step_hz} times a second"
            )
        for name in ("worlds", "cars", "obstacles"):
            getattr(self._world, name)[:] = getattr(snapshot, name)
        for car, motion in enumerate(self._motions):
            observations.motions(np.ascontiguousarray(self._world.cars[:, car]), motion)
        self._sensors.observe(self._world)

    def _run_in_parts(self, actions: np.ndarray) -> None:
        """Run a step with Bullet's physics, or with a reward written in Python."""
        world = self._world
        if self._solver is None:
            self._run(stages.PREPARE | stages.PHYSICS | stages.JUDGE, actions)
        else:
            self._run(stages.PREPARE, actions)
            self._solver.step(world, self._controls, self._contacts)
            self._run(stages.JUDGE, actions)
        if self._reward is not None:
            before = replace(world, cars=self._before)
            rewards, log = self._reward(self.tracks, before, world, actions, self._verdicts)
            self._outcomes["reward"] = rewards
            assert isinstance(self._result.log, dict)
            self._result.log.update(log)
        self._run(stages.SETTLE, actions)

    def _run(self, phases: int, actions: np.ndarray) -> None:
        status = shared_out(
            stages.step, self.num_worlds, self._per_thread, phases, actions, *self._step_arrays
        )
        if status == stages.FINE:
            return
        world, car = divmod(status // 4, self.num_cars)
        if status % 4 == stages.BAD_ACTION:
            raise ActionError(
                f"the action of car {car} in world {world} is {actions[world, car].tolist()}: "
                "steering and speed must be numbers from -1 to 1"
            )
        raise WorldError(
            f"car {car} of world {world} left the numbers at step "
            f"{self._world.worlds['step'][world]}: its state is NaN or infinite; please report the "
            "seed and the settings"
        )

    def retire(self, car: int | slice, world: int | slice = slice(None)) -> None:
        """End a car's race, in all worlds or one: it is frozen for good, without contacts."""
        for name in ("retired", "ghost"):
            self._world.cars[name][world, car] = True

    def close(self) -> None:
        """Release the solver's resources; the environment cannot be used afterwards."""
        self._closed = True
        if self._solver is not None:
            self._solver.close()

    def __getstate__(self) -> dict[str, Any]:
        """Return what a copy or a pickle keeps: not the views, which would not follow a copy."""
        return {name: value for name, value in vars(self).items() if name != "_result"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._result = self._result_views()

    def _begin(self, seed: int, seeds: ArrayLike | None) -> None:
        self._seed = seed
        if seeds is None:
            numbers = np.arange(self.num_worlds)
            seeds = rng.bits(seed, _WORLD_SEED, numbers) & rng.SEED_MASK
        seeds = np.asarray(seeds, np.int64)
        if seeds.shape != (self.num_worlds,):
            raise ValueError(f"seeds have shape {seeds.shape}: give ({self.num_worlds},)")
        rules, length = self.cfg.sim.rules, self.tracks.length[self._world.track]
        limit_s = rules.max_time_s or 30.0 + rules.laps * length.astype(np.float64) / 0.25
        # In whole steps, so that no rounding adds one: 2 s are 30 steps.
        self._world.worlds["last_step"] = np.ceil(limit_s * self.cfg.sim.step_hz - 1e-2)
        self._sensors.reset()
        self._start(np.arange(self.num_worlds), seeds)

    def _start(self, which: np.ndarray, seeds: np.ndarray) -> None:
        self._world.worlds["seed"][which] = seeds
        stages.reset(which, *self._reset_arrays)
        if self._solver is not None:
            self._solver.reset(which.tolist())
        if self._reward is not None:
            begun = np.zeros(self._world.cars.shape, np.bool_)
            begun[which] = True
            self._reward.restart(self._world, begun)

    def _restart(self, restart: np.ndarray, seeds: np.ndarray) -> None:
        which = np.flatnonzero(restart)
        self._start(which, seeds[which])
        self._outcomes["began"][which] = True
        self._sensors.refresh(np.broadcast_to(restart[:, None], self._world.cars.shape))

    def _tracks_of_worlds(self, index: ArrayLike) -> np.ndarray:
        index, number = np.asarray(index, np.int64), len(self.tracks.tracks)
        if index.shape != (self.num_worlds,) or ((index < 0) | (index >= number)).any():
            raise ValueError(
                f"track_index is {index.tolist()}: give each of the {self.num_worlds} worlds the "
                f"number of its track, 0 to {number - 1}"
            )
        return index

    def _check_open(self) -> None:
        if self._closed:
            raise ConfigError("the environment was closed: make a new one")
