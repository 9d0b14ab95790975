"""The experiments behind the default settings of training: one change each against one base.

They take hours on one core, so `python -m benchmarks` leaves them out:

    python -m benchmarks.experiments [--table rookie|racer] [--seeds 3] [--only WORD ...]

Samples count, not the clock: schedules run over a budget of samples, evaluation is left out of the
seconds, and those are of one core's own time, so that a busy machine changes nothing.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from unittest.mock import patch

import torch
from rsl_rl.storage import RolloutStorage
from torch import Tensor, nn

from benchmarks.report import heading, machine
from league.agents.checkpoint import Card, Checkpoint
from league.envs.actions import ContinuousActions
from league.envs.rewards import preset
from league.sim.config import CameraConfig, SensorConfig
from league.track import files
from league.track.track import TrackSet
from league.training.config import TrainConfig
from league.training.evaluator import EvalConfig, evaluate_policy
from league.training.ppo import make_env, symmetry
from league.training.ppo.learner import Learner

Change = Callable[[TrainConfig], TrainConfig]
Alter = Callable[[Learner], None]


@dataclass(frozen=True)
class Variation:
    """One change of the base setting."""

    name: str
    """What differs."""
    change: Change = field(default=lambda cfg: cfg)
    """The settings with the change."""
    alter: Alter = field(default=lambda _: None)
    """A change that no setting makes, done to the learner."""
    critic_sees: str = "state"
    """What the critic sees: the true state, or the actor's senses."""


@dataclass(frozen=True)
class Task:
    """What is learnt, from how many samples, and when it counts as learnt."""

    base: TrainConfig
    """The setting that variations change."""
    schedule: int
    """Samples over which learning rate and noise fall."""
    cut: int
    """Samples after which a run is over."""
    check: int
    """Samples between two evaluations."""
    until_complete: bool
    """Whether the first evaluation with every lap complete ends the run."""


@dataclass(frozen=True)
class Trial:
    """One run of one variation."""

    task: str
    """Name of the task."""
    variation: str
    """Name of the variation."""
    seed: int
    """Its seed."""
    samples: int | None
    """Samples at the first evaluation with every lap complete; None: it never was."""
    core_s: float | None
    """Time of one core spent on learning until then [s]."""
    rate: float
    """Samples per second of one core."""
    flying_s: float | None
    """Best flying lap of the last evaluation [s]."""
    clean: int
    """Clean laps of the last evaluation, of 3."""


def _base(reward: str, low: float, high: float) -> TrainConfig:
    return TrainConfig(
        num_worlds=32,
        action_space=ContinuousActions(-30.0, 30.0, low, high),
        reward=preset(reward),
        save_every=1_000_000,
    )


TASKS = {
    "rookie": Task(_base("centerline", 0.5, 1.0), 100_000, 24_576, 2048, until_complete=True),
    "racer": Task(
        replace(_base("progress", 1.0, 4.0), num_worlds=64), 150_000, 150_000, 30_720, False
    ),
}


def _ppo(**settings: object) -> Change:
    return lambda cfg: cfg.with_ppo(**settings)


def _network(**settings: object) -> Change:
    return lambda cfg: replace(cfg, network=replace(cfg.network, **settings))  # type: ignore


def _picture(width: int, height: int) -> Change:
    camera = CameraConfig(width=width, height=height)
    return lambda cfg: replace(cfg, sensors=SensorConfig(camera=camera))


def _rows(num_worlds: int, steps: int = 64) -> Change:
    return lambda cfg: replace(cfg.with_ppo(rollout=steps), num_worlds=num_worlds)


def _unscaled(learner: Learner) -> None:
    learner._normalization.normalize = lambda rewards, dones: rewards  # type: ignore


def _doubled(learner: Learner) -> None:
    cfg = learner.cfg
    learner._alg.symmetry = _Doubling(  # type: ignore
        cfg.sensors, cfg.action_space, cfg.ppo.mini_batches
    )


def _loud(learner: Learner) -> None:
    layers = learner._alg.get_policy().mlp.modules()
    [layer for layer in layers if isinstance(layer, nn.Linear)][-1].reset_parameters()


class _Doubling(symmetry.Symmetry):
    """rsl-rl's own way: mirror images are added to each mini-batch."""

    def augment_batch(self, batch: RolloutStorage.Batch, original_batch_size: int) -> None:
        """Append the mirror images."""
        mirrored = symmetry.observations(batch.observations, self._sensors)  # type: ignore
        batch.observations = torch.cat([batch.observations, mirrored])  # type: ignore
        batch.actions = torch.cat([batch.actions, self._space.mirror(batch.actions)])  # type: ignore
        for name in ("old_actions_log_prob", "values", "advantages", "returns"):
            value: Tensor = getattr(batch, name)
            setattr(batch, name, torch.cat([value, value]))


VARIATIONS = {
    "rookie": (
        Variation("base"),
        Variation("relu", _network(activation="relu")),
        Variation("no mirror images", lambda cfg: replace(cfg, symmetry=False)),
        Variation("mirror images added (rsl-rl)", alter=_doubled),
        Variation("3 epochs x 4 mini-batches", _ppo(epochs=3, mini_batches=4)),
        Variation("4 epochs x 8", _ppo(epochs=4, mini_batches=8)),
        Variation("6 epochs x 4", _ppo(mini_batches=4)),
        Variation("10 epochs x 16", _ppo(epochs=10)),
        Variation("gamma .9", _ppo(gamma=0.9)),
        Variation("gamma .99, lambda .95", _ppo(gamma=0.99, lam=0.95)),
        Variation("learning rate 1e-3, constant", _ppo(learning_rate=(1e-3, 1e-3))),
        Variation("learning rate 3e-4, constant", _ppo(learning_rate=(3e-4, 3e-4))),
        Variation("noise .5, constant", _ppo(noise=(0.5, 0.5))),
        Variation("noise 1 to .06", _ppo(noise=(1.0, 0.06))),
        Variation("noise .25 to .06", _ppo(noise=(0.25, 0.06))),
        Variation("16 worlds", _rows(16)),
        Variation("64 worlds", _rows(64)),
        Variation("128 worlds", _rows(128)),
        Variation("64 worlds x 32 steps", _rows(64, 32)),
        Variation("picture 48x36", _picture(48, 36)),
        Variation("picture 96x72", _picture(96, 72)),
        Variation("strides 3, 2, 2", _network(strides=(3, 2, 2))),
        Variation("value loss clipped", _ppo(value_clip=True)),
        Variation("returns not scaled", alter=_unscaled),
        Variation("last layer as torch draws it", alter=_loud),
        Variation("no pull on means", _ppo(pull=0.0)),
        Variation("critic sees what the car sees", critic_sees="senses"),
    ),
    "racer": (
        Variation("base"),
        Variation("last layer as torch draws it", alter=_loud),
        Variation("no pull on means", _ppo(pull=0.0)),
        Variation("learning rate 1e-3, constant", _ppo(learning_rate=(1e-3, 1e-3))),
        Variation("noise .5 to .2", _ppo(noise=(0.5, 0.2))),
        Variation("gamma .99, lambda .95", _ppo(gamma=0.99, lam=0.95)),
        Variation("3 epochs x 4 mini-batches", _ppo(epochs=3, mini_batches=4)),
        Variation("no mirror images", lambda cfg: replace(cfg, symmetry=False)),
        Variation("relu", _network(activation="relu")),
        Variation("critic sees what the car sees", critic_sees="senses"),
    ),
}


def run(task_name: str, variation: Variation, seed: int) -> Trial:
    """Train one variation from one seed."""
    task = TASKS[task_name]
    cfg = replace(variation.change(task.base), seed=seed)
    exam = EvalConfig(tracks=(files.load("reinvent_2018"),))
    learner = _learner(cfg, variation)
    spent, next_check = 0.0, task.check
    learnt: tuple[int, float] | None = None
    flying, clean = None, 0
    while learner.samples < task.cut and not (learnt and task.until_complete):
        started = time.process_time()
        learner.update(learner.samples / task.schedule)
        spent += time.process_time() - started
        if learner.samples < next_check:
            continue
        next_check += task.check
        found = evaluate_policy(exam, Checkpoint(_card(cfg), learner.weights()))
        flying, clean = found.best_flying_s, found.clean_laps
        if found.all_complete and learnt is None:
            learnt = learner.samples, spent
    learner.env.close()
    first, core_s = learnt or (None, None)
    rate = learner.samples / spent
    return Trial(task_name, variation.name, seed, first, core_s, rate, flying, clean)


def _learner(cfg: TrainConfig, variation: Variation) -> Learner:
    env = make_env.make(TrackSet(files.load("reinvent_2018")), cfg)
    if variation.critic_sees == "state":
        learner = Learner(env, cfg)
    else:
        with patch.object(Learner, "_settings", _blindfolded):
            learner = Learner(env, cfg)
    variation.alter(learner)
    return learner


_settings_as_they_are = Learner._settings


def _blindfolded(learner: Learner) -> dict:
    """Return rsl-rl's settings with a critic of the actor's layers, which sees no more."""
    settings = _settings_as_they_are(learner)
    critic = dict(settings["actor"])
    del critic["distribution_cfg"]
    groups = {**settings["obs_groups"], "critic": settings["obs_groups"]["actor"]}
    return settings | {"critic": critic, "obs_groups": groups}


def _card(cfg: TrainConfig) -> Card:
    return Card(
        name="experiment", sensors=cfg.sensors, action_space=cfg.action_space, network=cfg.network
    )


def runs(task: str, seeds: Sequence[int], only: Sequence[str]) -> Iterator[Trial]:
    """Yield every run; all variations of one seed before the next, so that a table fills evenly."""
    for seed in seeds:
        for variation in VARIATIONS[task]:
            if not only or any(word in variation.name for word in only):
                yield run(task, variation, seed)


def table(trials: Sequence[Trial]) -> list[str]:
    """Return a Markdown table, a row for each variation in order of appearance."""
    racing = trials[0].task == "racer"
    last = "best flying lap [s] | clean laps |" if racing else "to 3 of 3 laps [core-s] |"
    lines = [
        f"| variation | seeds | samples to 3 of 3 laps, each seed | samples/core-s | {last}",
        "|---|--:|---|--:|--:|" + ("--:|" if racing else ""),
    ]
    for name in dict.fromkeys(one.variation for one in trials):
        mine = [one for one in trials if one.variation == name]
        reached = ", ".join("never" if t.samples is None else f"{t.samples:,}" for t in mine)
        rate = statistics.median(one.rate for one in mine)
        if racing:
            flying = " / ".join("-" if t.flying_s is None else f"{t.flying_s:.2f}" for t in mine)
            end = f"{flying} | {' / '.join(f'{t.clean} of 3' for t in mine)} |"
        else:
            core = statistics.median(float("inf") if t.core_s is None else t.core_s for t in mine)
            end = "never |" if core == float("inf") else f"{core:.1f} |"
        lines.append(f"| {name} | {len(mine)} | {reached} | {rate:,.0f} | {end}")
    return lines


def main() -> None:
    """Run the experiments asked for and print their tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=_AsWritten)
    parser.add_argument("--table", choices=tuple(TASKS), action="append")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--only", nargs="*", default=())
    parser.add_argument("--keep", type=Path, help="a file that each run is added to as it ends")
    parser.add_argument("--from-file", type=Path, help="print the tables of such a file, run none")
    given = parser.parse_args()
    torch.set_num_threads(1)
    if given.from_file:
        lines = given.from_file.read_text(encoding="utf-8").splitlines()
        found = [Trial(**json.loads(line)) for line in lines]
        for task in dict.fromkeys(one.task for one in found):
            print("\n".join(table([one for one in found if one.task == task])), end="\n\n")
        return
    heading("Experiments behind the settings")
    print(machine(), end="\n\n", flush=True)
    for task in given.table or TASKS:
        trials = []
        seeds = range(given.first_seed, given.first_seed + given.seeds)
        for trial in runs(task, seeds, given.only):
            trials.append(trial)
            if given.keep:
                with given.keep.open("a", encoding="utf-8") as out:
                    out.write(json.dumps(asdict(trial)) + "\n")
        print("\n".join(table(trials)), end="\n\n", flush=True)


_AsWritten = argparse.RawDescriptionHelpFormatter

if __name__ == "__main__":
    main()
