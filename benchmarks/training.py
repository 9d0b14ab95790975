"""How long a driver takes to learn, and where the time of training goes.

The rookie is measured from the command to the prompt: once in an installation that has compiled
nothing yet, then with the simulator compiled before. The learner is measured against a plain
loop: PPO written out on the same network, batch and number of passes, fed with stored random
pictures, with nothing around it. Both loops and the shares are counted in one core's own time, so
that a busy machine changes nothing.
"""

from __future__ import annotations

import os
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import torch
from torch import Tensor, nn

from benchmarks.report import figure, heading, note
from league.envs import rewards
from league.envs.actions import ContinuousActions
from league.sim.config import SensorConfig
from league.track import files
from league.track.track import TrackSet
from league.training.config import TrainConfig
from league.training.ppo import make_env
from league.training.ppo.learner import Learner, threads
from league.training.ppo.self_play import make_racing
from tests.actor import Actor

ROOT = Path(__file__).parents[1]
ROOKIE = (
    *("train", "--reward", "centerline", "--action-space", "0.5-1"),
    *("--minutes", "1", "--plain", "--no-tensorboard"),
)


@dataclass(frozen=True)
class Learnt:
    """What one run of `league train` took."""

    wall_s: float
    """From the command to the prompt [s]."""
    samples: int
    """Decisions learnt from."""
    complete: bool
    """Whether the best policy drove 3 of 3 laps."""


def learnt(arguments: Sequence[str], root: Path = ROOT) -> Learnt:
    """Train as the arguments of `league` say, in a process of its own.

    The league is imported from `root`: with its machine code, if it was compiled there.
    """
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        done = subprocess.run(
            [sys.executable, "-m", "league.cli", *arguments, "--out", str(Path(folder) / "new.pt")],
            cwd=root,
            env={**os.environ, "PYTHONPATH": str(root)},
            capture_output=True,
            text=True,
            check=True,
        )
        taken = time.perf_counter() - began
    found = re.search(r"(\d+) decisions in", done.stdout)
    assert found is not None, done.stdout
    return Learnt(taken, int(found[1]), "3 of 3 laps complete" in done.stdout)


def rookie(seed: int, evaluations: int, root: Path = ROOT) -> Learnt:
    """Train until some evaluations in a row were complete; see `learnt`."""
    asked = ["--stop-when-complete", str(evaluations), "--seed", str(seed)]
    return learnt([*ROOKIE, *asked], root)


def first_rookie() -> None:
    """Print what the rookie takes in an installation that has compiled nothing yet."""
    with tempfile.TemporaryDirectory() as folder:
        for name in ("league", "tracks", "garage"):
            uncompiled = shutil.ignore_patterns("__pycache__")
            shutil.copytree(ROOT / name, Path(folder) / name, ignore=uncompiled)
        run = rookie(1, 1, Path(folder))
    name = "rookie: command to prompt, compiling included, 3 of 3 laps once, seed 1"
    figure(name if run.complete else f"{name}: NOT COMPLETE", run.wall_s, "s")


def rookies(seeds: tuple[int, ...] = (0, 1, 2, 3, 4)) -> None:
    """Print what the rookie takes, each seed and the median."""
    for evaluations in (1, 2):
        runs = [rookie(seed, evaluations) for seed in seeds]
        for seed, run in zip(seeds, runs, strict=True):
            laps = "3 of 3 laps" if run.complete else "NOT COMPLETE"
            note(f"  seed {seed}: {run.wall_s:.1f} s, {run.samples:,} decisions, {laps}")
        times = 1 if evaluations == 1 else evaluations
        middle = statistics.median(run.wall_s for run in runs)
        name = f"rookie: command to prompt, compiled before, 3 of 3 laps {times}x in a row"
        figure(name, middle, "s", 15 if evaluations == 1 else None, most=True)
        samples = statistics.median(run.samples for run in runs)
        figure("rookie: decisions learnt from", samples, "")


class Plain:
    """PPO on stored random observations, without rsl-rl and without the league's learner."""

    def __init__(self, cfg: TrainConfig, groups: dict[str, Tensor], state: Tensor) -> None:
        """Build actor, critic and optimiser of the same shapes."""
        self.cfg, self.groups, self.state = cfg, groups, state
        shapes = {name: tuple(group.shape[1:]) for name, group in groups.items()}
        self.actor = Actor(cfg.network, shapes, cfg.action_space.size)
        sizes = [state.shape[1], *cfg.critic_hidden]
        layers: list[nn.Module] = []
        for before, after in pairwise(sizes):
            layers += [nn.Linear(before, after), nn.ELU()]
        self.critic = nn.Sequential(*layers, nn.Linear(sizes[-1], 1))
        every = [*self.actor.parameters(), *self.critic.parameters()]
        self.adam = torch.optim.Adam(every, lr=1e-4)
        self.noise = torch.full((cfg.action_space.size,), 0.5)

    def run(self) -> tuple[float, float]:
        """Return the time of acting and of learning from one round [s]."""
        began = time.process_time()
        kept = self._collect()
        collected = time.process_time()
        self._learn(*kept)
        return collected - began, time.process_time() - collected

    def _collect(self) -> tuple[dict[str, Tensor], Tensor, Tensor, Tensor, Tensor]:
        pictures: dict[str, list[Tensor]] = {name: [] for name in self.groups}
        actions, odds, values = [], [], []
        with torch.inference_mode():
            for _ in range(self.cfg.ppo.rollout):
                spread = torch.distributions.Normal(self.actor(_floats(self.groups)), self.noise)
                chosen = spread.sample()
                actions.append(chosen)
                odds.append(spread.log_prob(chosen).sum(-1))
                values.append(self.critic(self.state)[:, 0])
                for name, group in self.groups.items():
                    pictures[name].append(group.clone())
        groups = {name: torch.cat(groups) for name, groups in pictures.items()}
        paid = torch.rand(len(values), len(self.state))
        returns, ahead = [], values[-1]
        for number in reversed(range(len(values))):
            ahead = paid[number] + self.cfg.ppo.gamma * ahead
            returns.append(ahead)
        worth = torch.cat(returns[::-1])
        gain = worth - torch.cat(values)
        gain = (gain - gain.mean()) / (gain.std() + 1e-8)
        return groups, torch.cat(actions), torch.cat(odds), worth, gain

    def _learn(
        self, groups: dict[str, Tensor], actions: Tensor, odds: Tensor, worth: Tensor, gain: Tensor
    ) -> None:
        ppo = self.cfg.ppo
        groups, actions, odds, worth, gain = (
            {name: group.clone() for name, group in groups.items()},
            *(value.clone() for value in (actions, odds, worth, gain)),
        )
        state = self.state.repeat(ppo.rollout, 1)
        for _ in range(ppo.epochs):
            for part in torch.randperm(len(gain)).chunk(ppo.mini_batches):
                means = self.actor(_floats({name: group[part] for name, group in groups.items()}))
                spread = torch.distributions.Normal(means, self.noise)
                ratio = (spread.log_prob(actions[part]).sum(-1) - odds[part]).exp()
                cut = ratio.clamp(1.0 - ppo.clip, 1.0 + ppo.clip)
                loss = -torch.minimum(ratio * gain[part], cut * gain[part]).mean()
                loss = loss + (self.critic(state[part])[:, 0] - worth[part]).square().mean()
                self.adam.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(self.actor.parameters(), ppo.max_gradient)
                nn.utils.clip_grad_norm_(self.critic.parameters(), ppo.max_gradient)
                self.adam.step()


def _floats(groups: dict[str, Tensor]) -> dict[str, Tensor]:
    return {
        name: group.to(torch.float32) / 255.0 if group.dtype == torch.uint8 else group
        for name, group in groups.items()
    }


@dataclass
class Shares:
    """Time spent inside some calls of the worlds and of the learner [s]."""

    spent: dict[str, float]

    def timed(self, name: str, owner: object, method: str) -> None:
        """Count the time of a method under a name; what others inside it take is theirs."""
        inner: Callable = getattr(owner, method)

        def call(*given: object, **named: object) -> object:
            began, before = time.process_time(), sum(self.spent.values())
            try:
                return inner(*given, **named)
            finally:
                others = sum(self.spent.values()) - before
                self.spent[name] += time.process_time() - began - others

        setattr(owner, method, call)


def learner_config(num_worlds: int = 64) -> TrainConfig:
    """Return the default learner with the progress reward at 0.5 to 4 m/s."""
    return TrainConfig(
        num_worlds=num_worlds,
        action_space=ContinuousActions(-30.0, 30.0, 0.5, 4.0),
        reward=rewards.preset("progress"),
        save_every=1_000_000,
    )


def loops(rounds: int = 5) -> None:
    """Print the learner's samples per second against those of the plain loop, and the shares."""
    cfg = learner_config()
    learner = Learner(make_env.make(TrackSet(files.load("reinvent_2018")), cfg), cfg)
    shares = Shares(dict.fromkeys(("compiled step", "cameras", "policy", "learning"), 0.0))
    env = learner.env.race_env
    shares.timed("compiled step", env, "_run")
    shares.timed("cameras", env._sensors, "observe")
    for method in ("act", "process_env_step"):
        shares.timed("policy", learner._alg, method)
    for method in ("compute_returns", "update"):
        shares.timed("learning", learner._alg, method)
    groups = {name: group.clone() for name, group in learner._obs.items() if name != "state"}
    plain = Plain(cfg, groups, learner._obs["state"].clone())
    learner.update(0.0)
    plain.run()
    shares.spent = dict.fromkeys(shares.spent, 0.0)
    ours, theirs, whole = [], [], []
    for _ in range(rounds):  # in turn, so that a busy machine is busy for both
        before = shares.spent["policy"] + shares.spent["learning"]
        began = time.process_time()
        learner.update(0.0)
        whole.append(time.process_time() - began)
        ours.append(shares.spent["policy"] + shares.spent["learning"] - before)
        theirs.append(sum(plain.run()))
    mine, its = statistics.median(ours), statistics.median(theirs)
    figure("plain loop: act and learn", cfg.samples / its, "samples/s")
    figure("our learner: act and learn, without the worlds", cfg.samples / mine, "samples/s")
    figure("our learner against the plain loop", its / mine, "x", 0.85)
    figure(
        "training, evaluations and save points left out",
        cfg.samples / statistics.median(whole),
        "samples/s",
    )
    total = sum(whole)
    rest = total - sum(shares.spent.values())
    for name, spent in [*shares.spent.items(), ("rest of the worlds and the loop", rest)]:
        figure(f"share of time: {name}", 100 * spent / total, "%")
    learner.env.close()


def first_stage(rounds: int = 20) -> None:
    """Print how many decisions a second self-play learns from on the true state.

    One thread is counted in its core's own time, two by the fastest update: what a quiet machine
    does.
    """
    truth = SensorConfig(truth=True)
    ours = replace(learner_config(), kind="head_to_head", num_cars=4, sensors=truth)
    tracks = TrackSet(files.load("reinvent_2018"))
    for name, number, clock, goal in (
        ("one thread, its own time", 1, time.process_time, 25_000),
        ("two threads, the fastest update", 2, time.perf_counter, 40_000),
    ):
        stage = make_racing(tracks, ours)
        with threads(number):
            done, taken = stage.update(0.0).samples, []
            for _ in range(rounds):
                before, began = done, clock()
                done = stage.update(0.0).samples
                taken.append((clock() - began) / (done - before))
        spent = statistics.median(taken) if number == 1 else min(taken)
        figure(f"first stage of self-play, {name}", 1 / spent, "decisions/s", goal)
        stage.env.close()


def main() -> None:
    """Print the figures."""
    heading("Training")
    torch.set_num_threads(1)
    loops()
    first_stage()
    first_rookie()
    rookies()


if __name__ == "__main__":
    main()
