"""The tracks and the worlds a learner trains in, made from the settings of a run."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from league.envs.adapters.rsl_vec_env import RacingVecEnv
from league.envs.config import EnvConfig, Scenarios
from league.envs.driver import Driver
from league.envs.rewards import Reward
from league.errors import ConfigError, brief
from league.sim.config import (
    RULES,
    DynamicsRandomization,
    ObstacleConfig,
    SimConfig,
    VisualRandomization,
)
from league.track import files
from league.track.generate import generate
from league.track.track import Track, TrackSet
from league.training.config import GRIP_SPREAD, TrainConfig

GENERATED = "generated:"
MAX_GENERATED = 2000
MAX_EVALUATED = 4  # largest number of named tracks to evaluate on
RANDOM_EVALUATED = 12  # random tracks to evaluate on
FIRST_EVALUATED = 1_000_000  # seed of the first of these, beyond those of training


def load_tracks(names: Sequence[str]) -> list[Track]:
    """Return the tracks of some names; TrackError or ConfigError says which is none."""
    if not names:
        raise ConfigError("no track was named: give --track NAME, `league tracks` lists them")
    tracks: list[Track] = []
    for name in names:
        if name.startswith(GENERATED):
            tracks += [random_track(seed) for seed in range(_num_generated(name))]
        else:
            tracks.append(files.load(name))
    return tracks


def count_tracks(names: Sequence[str]) -> int:
    """Return the number of tracks of some names, without generating any; see `load_tracks`."""
    return sum(_num_generated(name) if name.startswith(GENERATED) else 1 for name in names)


def random_track(seed: int) -> Track:
    """Return a random track to train on.

    Every third one has bends near the smallest turn a car can make; every third one is narrow with
    its white lines outside the road, as the older half of the community's tracks are.
    """
    length = (15.0, 45.0)
    if seed % 3 == 0:
        return generate(seed, min_radius=0.34, length=length)
    if seed % 3 == 1:
        return replace(generate(seed, width=(0.58, 0.95), length=length), line_inside=False)
    return generate(seed, length=length)


def tracks_for_evaluation(names: Sequence[str]) -> list[Track]:
    """Return the tracks to evaluate on, by those of training: some of them, or random others."""
    named = [name for name in names if not name.startswith(GENERATED)]
    if named:
        return load_tracks(named[:MAX_EVALUATED])
    return [random_track(FIRST_EVALUATED + number) for number in range(RANDOM_EVALUATED)]


def track_set(tracks: Sequence[Track], both_directions: bool) -> TrackSet:
    """Return the set of tracks, with each one reversed too if asked."""
    if both_directions:
        tracks = [either for track in tracks for either in (track, track.reversed())]
    return TrackSet(*tracks)


def _num_generated(name: str) -> int:
    text = name.removeprefix(GENERATED)
    if not text.isdecimal() or not 1 <= int(text) <= MAX_GENERATED:
        raise ConfigError(
            f"{brief(name)} is no number of random tracks: give generated:1 to "
            f"generated:{MAX_GENERATED}"
        )
    return int(text)


_ENDLESS = 1000  # Laps of a race in training: a mistake or time ends an episode, not the flag.
LEARNER_ATTACKS = 0.5  # Share of scenarios in which the only car that learns is the fastest around.
PENALISED = 0.15  # Share of cars that begin as if for a penalty, where sensors see such cars.
VISUAL_RANDOMIZATION = VisualRandomization(light=0.3, colour=0.15, noise=6.0, blur=0.6)


def env_config(cfg: TrainConfig) -> EnvConfig:
    """Return the settings of the worlds."""
    share = cfg.dynamics_randomization
    sim = SimConfig(
        kind=cfg.kind,
        num_cars=cfg.num_cars,
        obstacles=ObstacleConfig(count=cfg.obstacles, kind="bot" if cfg.bots else "box"),
        rules=replace(RULES[cfg.rules], laps=_ENDLESS),
        spread=DynamicsRandomization(
            grip=GRIP_SPREAD * share,
            mass=0.1 * share,
            latency_s=0.03 * share,
            steering_offset=0.02 * share,
            camera_position=0.01 * share,
            camera_angle=0.02 * share,
        ),
    )
    # Cars that start anywhere on a lap hardly ever meet.
    shortest = min(Scenarios.shortest, cfg.episode_s)
    # The groups `truth` and `ahead` do not tell of ghosts.
    penalised = 0.0 if cfg.sensors.privileged else PENALISED
    meeting = Scenarios(shortest=shortest, penalised=penalised) if cfg.num_cars > 1 else None
    return EnvConfig(
        sim=sim,
        solver="planar",
        sensors=(cfg.sensors,) * cfg.num_cars,
        looks=VISUAL_RANDOMIZATION if cfg.visual_randomization else None,
        mode="training",
        reward=cfg.reward,
        episode_s=cfg.episode_s,
        scenarios=meeting,
    )


def make(
    tracks: TrackSet,
    cfg: TrainConfig,
    *,
    opponents: Mapping[int, Driver | str] | None = None,
    guests: Mapping[int, Sequence[Driver]] | None = None,
    reward: Reward | None = None,
) -> RacingVecEnv:
    """Build the worlds: in each, the cars without an opponent's driver learn.

    Opponents are by the number of the car, as are guests, which have learners' cars in some
    worlds; `reward`, in Python, replaces that of the settings.
    """
    settings = env_config(cfg)
    if opponents and settings.scenarios is not None:
        # Attacks teach most, and the other cars' drivers do not learn from them.
        scenarios = replace(settings.scenarios, learner=LEARNER_ATTACKS)
        settings = replace(settings, scenarios=scenarios)
    return RacingVecEnv(
        tracks,
        settings,
        num_worlds=cfg.num_worlds,
        learners=[car for car in range(cfg.num_cars) if car not in (opponents or {})],
        opponents=opponents,
        guests=guests,
        action_space=cfg.action_space,
        reward=reward,
        as_bytes=True,
        seed=cfg.seed,
        device=cfg.device,
    )
