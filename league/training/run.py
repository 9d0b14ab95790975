"""A training run: learn, evaluate, save, report; from settings to best.pt, also after a kill."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from pydantic import ValidationError

from league import __version__
from league.agents import checkpoint, roster
from league.agents.checkpoint import Card, Checkpoint, RewardCard
from league.agents.policy import Policy
from league.atomic_file import replacing
from league.envs import rewards
from league.envs.adapters.rsl_vec_env import checked_device
from league.envs.rewards import Reward
from league.errors import ConfigError, LeagueError, PolicyError, brief, explaining, first_problem
from league.racing import duels, trace
from league.racing.duels import DuelConfig, Threshold
from league.racing.table import Evaluation
from league.racing.trace import TrainingTrace
from league.sim.config import ObstacleConfig, SimConfig
from league.training import config, evaluator, run_folder
from league.training.config import RunConfig
from league.training.evaluator import EvalConfig, EvalResult, Evaluator
from league.training.monitor.history import TrainingCallback, TrainingHistory, UpdateRow
from league.training.ppo import distributed, make_env
from league.training.ppo.learner import make_learner, memory_explained
from league.training.ppo.self_play import RacingLearner, make_racing
from league.training.ppo.teacher import make_taught

_DUELS = 60  # races at each pace, for the card of a policy
_CARD_OF_TRAINING = ("sensors", "action_space", "network", "kind", "seed")
CRITIC_FIRST = 4  # Updates from which only the critic learns, where the actor begins trained.


@dataclass(frozen=True)
class Outcome:
    """The result of a run."""

    best: Path  # the best policy
    evaluation: Evaluation | None  # its evaluation
    samples: int  # decisions learnt from
    time_s: float  # learning time, of earlier parts too [s]
    why: str  # why it stopped
    duels: Threshold | None = None  # head to head: which rivals it passes, and keeps behind


class Run:
    """One training run in its folder: best.pt, last.pt, state.pt, history.jsonl, settings.json.

    Of several ranks (torchrun) all learn, and only the first one writes, evaluates and reports.
    """

    def __init__(self, cfg: RunConfig, folder: Path, *, background: bool = True) -> None:
        """Build worlds, learner and evaluator; LeagueError if settings are unknown or contradict.

        Nothing is written yet. Without `background` evaluations come between updates.
        """
        cfg.check()
        self.cfg, self.folder = cfg, folder
        if not cfg.reward.endswith(".py"):
            ways = 2 if cfg.train.both_directions else 1
            rewards.check_name(cfg.reward, ways * make_env.count_tracks(cfg.tracks))
        named_tracks = make_env.load_tracks(cfg.tracks)
        self._eval_cfg = _eval_config(cfg)
        self._parents: tuple[str, ...] = ()
        self._reward, self._reward_card = _reward(cfg)
        self.spent_s = 0.0  # Learning time so far, of earlier parts too [s].
        self._complete = 0
        self._check_card()
        # Each rank its own device, before any is touched.
        self.train = train = replace(cfg.train, device=distributed.device(cfg.train.device))
        checked_device(train.device)
        if cfg.self_play and distributed.count() > 1:
            raise ConfigError(
                f"self-play learns in one process, and torchrun has started {distributed.count()}: "
                "start it without torchrun, or omit --self-play"
            )
        if train.teacher and cfg.init_from:
            raise ConfigError(
                "a teacher is for a policy that has learnt nothing yet: omit --teacher or "
                "--init-from"
            )
        tracks = make_env.track_set(named_tracks, train.both_directions)
        self._parent = checkpoint.load(cfg.init_from) if cfg.init_from else None
        if self._parent is not None:
            self._parents = (self._parent.digest, *self._parent.card.parents)[:64]
        # After what is refused at once, and before what takes seconds: it loads meanwhile.
        leads = distributed.is_first()
        self._evaluator = Evaluator(self._eval_cfg, background=background and leads)
        sim = make_env.env_config(train).sim
        if self._reward is None:
            self._reward = rewards.built_in(cfg.reward, tracks, sim.car)
        self._traces = folder / run_folder.SIMTRACE
        self._simtrace: TrainingTrace | None = None
        if cfg.simtrace and leads:
            self._simtrace = TrainingTrace(self._reward, self._traces, train.action_space, sim)
        reward = self._simtrace or self._reward
        with memory_explained():
            if cfg.self_play:
                # The weights of a built-in reward are compiled, and the curriculum changes them.
                own = reward if cfg.reward.endswith(".py") or cfg.simtrace else None
                self.learner = make_racing(tracks, train, reward=own)
            else:
                make = make_taught if train.teacher else make_learner
                opponents = dict(enumerate(cfg.opponents, 1))
                self.learner = make(tracks, train, opponents=opponents, reward=reward)
        if self._parent is not None:
            self.learner.load_weights(self._parent.weights)
        self._best: tuple[float, ...] | None = None
        self._best_evaluation: Evaluation | None = None
        self.history = TrainingHistory()
        self._duels: Threshold | None = None
        self._lock: int | None = None
        self._callbacks: Sequence[TrainingCallback] = ()

    def resume(self) -> None:
        """Go on from the folder's state; PolicyError if there is none, or it is of another run."""
        if not (self.folder / "state.pt").exists():
            raise PolicyError(
                f"{self.folder / 'state.pt'} cannot be resumed: the run stopped before its "
                "first save point, so start a new one, without --resume"
            )
        notes = self.learner.restore(self.folder / "state.pt")
        self.spent_s = float(notes["spent_s"])
        self._complete = int(notes["complete"])
        self._best = tuple(notes["best"]) or None
        more = self.cfg.budget != config.read(self.folder).budget
        if more:
            self._complete = 0  # more time is given for more than complete laps
        distributed.gather(None)  # all have read before the first one writes
        if not distributed.is_first():
            return
        self._lock = run_folder.lock(self.folder)
        if self._simtrace is not None:
            self._simtrace.resume(notes.get("simtrace", (0, 0)))
            self._write_simtrace_metadata()
        self.history.close()
        self.history = TrainingHistory.resumed(self.folder / "history.jsonl", self.learner.updates)
        if more and not self.over:
            config.write(self.cfg, self.folder)  # also for a resume after a kill

    @property
    def over(self) -> str:
        """Why there is nothing more to learn; empty while there is."""
        cfg = self.cfg
        if self.learner.updates and not self.learner.has_learnt:
            return ""  # a teacher alone is no outcome: the policy has one update at least
        if cfg.stop_when_complete and self._complete >= cfg.stop_when_complete:
            return "every lap was complete"
        if cfg.steps and self.learner.samples >= cfg.steps:
            return "the steps were driven"
        return "the time was up" if self._progress() >= 1.0 else ""

    def close(self) -> None:
        """Close worlds, evaluator, history and folder; what is not saved is lost."""
        run_folder.unlock(self._lock)
        self._lock = None
        self._evaluator.close()
        self.history.close()
        for env in self.learner.shown:
            env.close()

    def learn(self, callbacks: Sequence[TrainingCallback] = ()) -> Outcome:
        """Learn until the budget is spent or all is complete; Ctrl-C saves and raises."""
        self._callbacks = callbacks
        try:
            if self.learner.updates == 0 and distributed.is_first():
                self._prepare()
            started = time.perf_counter() - self.spent_s
            with memory_explained(), distributed.interrupted_together() as interruption_point:
                while not distributed.agreed(bool(self.over)):
                    update = self.learner.update(self._progress())
                    if self._parent is not None and self._is_parent:
                        # An untrained critic would spoil what the parent has learnt.
                        self.learner.load_weights(self._parent.weights)
                    self.spent_s = time.perf_counter() - started
                    if distributed.is_first():
                        self._after(update)
                    interruption_point()
            why = self.over
            distributed.close()  # the first rank does the rest alone
            if distributed.is_first():
                self._finish()
        except (LeagueError, KeyboardInterrupt):  # such as a failure of the user's reward function
            self._save()
            raise
        finally:
            self.close()
            for callback in callbacks:
                callback.close()
        best, samples = self.folder / "best.pt", self.learner.samples
        return Outcome(best, self._best_evaluation, samples, self.spent_s, why, self._duels)

    def _after(self, update: UpdateRow) -> None:
        """Report an update; at a save point evaluate and save, too."""
        update = replace(update, time_s=round(self.spent_s, 4))
        self.history.add_update(update)
        for callback in self._callbacks:
            callback.update(self.history, update)
        at_save_point = self.learner.at_save_point
        if at_save_point or self._all_complete():
            self._take(wait=False)
        if not at_save_point:
            return
        due = (self.learner.updates // self.cfg.train.save_every) % self.cfg.eval_every == 0
        # Neither an unchanged parent nor the teacher is what was learnt.
        due = due and self.learner.has_learnt and not self._is_parent
        # While the evaluator is busy, policies are not evaluated.
        if due and not self._evaluator.pending:
            self._evaluator.submit(self.learner.updates, self._checkpoint())
            self._take(wait=False)
        # Last, so that the state includes the merit of best.pt.
        self._save()

    @property
    def _is_parent(self) -> bool:
        """Whether the actor still equals its parent, while the critic learns."""
        return self._parent is not None and self.learner.updates <= CRITIC_FIRST

    def _prepare(self) -> None:
        """Write the settings, and start the history."""
        failure = f"the folder {self.folder} cannot be made"
        with explaining(failure, PolicyError, "give --out a place that can be written"):
            self.folder.mkdir(parents=True, exist_ok=True)
        self._lock = run_folder.lock(self.folder)
        config.write(self.cfg, self.folder)
        run_folder.clear(self.folder)
        if self._simtrace is not None:
            self._write_simtrace_metadata()
        self.history = TrainingHistory(self.folder / "history.jsonl")

    def _write_simtrace_metadata(self) -> None:
        train, ppo = self.train, self.train.ppo
        hyperparameters: dict[str, float | str] = {
            "batch_size": train.samples // ppo.mini_batches,
            "num_epochs": ppo.epochs,
            "lr": ppo.learning_rate[0],
            "beta_entropy": ppo.entropy[0],
            "discount_factor": ppo.gamma,
            "num_episodes_between_training": trace.EPISODES,
            "exploration_type": "categorical",
            "stack_size": 1,
        }
        trace.write_metadata(self._traces, train.action_space, train.sensors, hyperparameters)

    def _progress(self) -> float:
        cfg = self.cfg
        by_time = self.spent_s / (60.0 * cfg.minutes) if cfg.minutes else 0.0
        by_steps = self.learner.samples / cfg.steps if cfg.steps else 0.0
        return max(by_time, by_steps)

    def _all_complete(self) -> bool:
        """Whether a result has arrived that ends the run; others wait for a save point.

        A run that is killed before its save point would lose them.
        """
        in_a_row = self._complete
        for result in self._evaluator.peek() if self.cfg.stop_when_complete else ():
            in_a_row = in_a_row + 1 if result.evaluation.all_complete else 0
            if in_a_row >= self.cfg.stop_when_complete:
                return True
        return False

    def _take(self, *, wait: bool) -> None:
        started = time.perf_counter()
        for result in self._evaluator.take(wait=wait):
            self._add(result, time.perf_counter() - started if wait else 0.0)
            for callback in self._callbacks:
                callback.evaluated(self.history, result.evaluation)

    def _add(self, result: EvalResult, waited_s: float) -> None:
        number, policy, evaluation = result
        self._complete = self._complete + 1 if evaluation.all_complete else 0
        merit = evaluator.merit_of(evaluation)
        if self.cfg.self_play:
            # Laps alone do not decide duels: of those that come as far, the newest races best.
            merit = (*merit[:2], float(number))
        best = self._best is None or merit > self._best
        if best:
            self._best, self._best_evaluation = merit, evaluation
            self._save_best(policy, {"updates": float(number), **evaluation.summary})
        spent = {"time_s": self.spent_s, "took_s": waited_s}
        self.history.add_evaluation(evaluation, number, **spent, best=best)

    @memory_explained()
    def _finish(self) -> None:
        """Evaluate the last policy too, wait for all results, and write them."""
        self._save()
        complete = self.cfg.stop_when_complete and self._complete >= self.cfg.stop_when_complete
        evaluated = {row.number for row in self.history.evaluations}
        if not complete and self.learner.updates not in {*self._evaluator.pending, *evaluated}:
            self._evaluator.submit(self.learner.updates, self._checkpoint())
        while self._evaluator.pending and not complete:
            self._take(wait=True)
        best = self.folder / "best.pt"
        if self._best_evaluation is None and best.exists():
            # It was evaluated before a resume, which keeps no table.
            policy = checkpoint.load(best)
            self._best_evaluation = evaluator.evaluate_policy(self._eval_cfg, policy)
        if self._best_evaluation is not None and self._best_evaluation.complete_laps:
            self._complete_card(checkpoint.load(best), clean=not complete)
        self._save()

    def _complete_card(self, best: Checkpoint, *, clean: bool) -> None:
        """Write into the best policy's card how clean it drives and how fast rivals it holds."""
        results: dict[str, float | None] = {}
        if clean:  # a run that stops at the first laps is in a hurry
            for callback in self._callbacks:
                callback.racing(f"driving {evaluator.CLEAN_RUNS} runs for the policy's card")
            results["clean_share"] = evaluator.clean_share(self._eval_cfg, best)
            self._save_best(best, results)
        if self.cfg.train.kind == "head_to_head":
            for callback in self._callbacks:
                callback.racing("racing it against itself, slowed, for the policy's card")
            car, cfg = SimConfig().car, DuelConfig(self._eval_cfg.tracks[0], races=_DUELS)
            try:
                self._duels = found = duels.threshold(cfg, Policy(best, car), Policy(best, car))
            except ConfigError:  # a lap in Bullet need not be one in the plane
                return
            results |= {"pass_pace": found.pace, "hold_pace": found.hold}
            for name in ("contacts_per_km", "hard_contacts_per_km", "off_tracks_per_pass"):
                results[name] = getattr(found, name)
            self._save_best(best, results)

    def _save_best(self, policy: Checkpoint, results: Mapping[str, float | None]) -> None:
        """Write the best policy, with these results on its card, too."""
        card = policy.card.model_copy(update={"results": {**policy.card.results, **results}})
        checkpoint.save(self.folder / "best.pt", replace(policy, card=card, text=""))

    def _save(self) -> None:
        if self.learner.updates == 0 or not distributed.is_first():
            return
        if self.learner.has_learnt:
            checkpoint.save(self.folder / "last.pt", self._checkpoint())
        if isinstance(self.learner, RacingLearner):  # what sees the true state is a policy, too
            racer = self.learner.teacher
            changes = {"sensors": racer.cfg.sensors, "network": racer.cfg.network}
            card = self._card(racer.samples).model_copy(update=changes)
            checkpoint.save(self.folder / "truth.pt", Checkpoint(card, racer.weights()))
        notes: dict[str, object] = {"spent_s": self.spent_s, "complete": self._complete}
        notes["best"] = list(self._best or ())
        if self._simtrace is not None:
            self._simtrace.flush()
            notes["simtrace"] = list(self._simtrace.position)
        self.learner.save(self.folder / "state.pt", notes)
        # Of a reward file, not of a built-in one.
        if printed := getattr(self._reward, "printed", ()):
            path = self.folder / run_folder.PRINTED
            with replacing(path, "what the reward function printed", PolicyError) as file:
                file.write_text("".join(f"{line}\n" for line in printed), encoding="utf-8")

    def _checkpoint(self) -> Checkpoint:
        return Checkpoint(self._card(self.learner.samples), self.learner.weights())

    def _check_card(self) -> None:
        """Refuse settings that no checkpoint's card can hold, or no network be built from."""
        try:
            self._card().weight_shapes  # noqa: B018
        except ValidationError as error:
            first, where, reason = first_problem(error, "values")
            raise ConfigError(
                f"the checkpoint's card refuses the {where} {brief(first['input'])}: {reason}"
            ) from None

    def _card(self, samples: int = 0) -> Card:
        cfg = self.cfg
        return Card(
            **{name: getattr(cfg, name) for name in ("name", "licence", "command")},
            **{name: getattr(cfg.train, name) for name in _CARD_OF_TRAINING},
            tracks=tuple(name[-80:] for name in cfg.tracks),
            reward=self._reward_card,
            steps=samples,
            train_s=round(self.spent_s, 1),
            parents=self._parents,
            league_version=__version__,
        )


def _eval_config(cfg: RunConfig) -> EvalConfig:
    find = make_env.load_tracks if cfg.eval_tracks else make_env.tracks_for_evaluation
    # A policy that learns to race others is evaluated by racing them.
    opponents = cfg.eval_opponents or cfg.opponents
    for name in opponents:
        roster.check(name)
    kind = cfg.train.kind
    if kind == "head_to_head":  # without opponents
        kind = "obstacle_avoidance" if cfg.train.obstacles else "time_trial"
    return EvalConfig(
        tracks=tuple(find(cfg.eval_tracks or cfg.tracks)),
        laps=cfg.eval_laps,
        trials=cfg.eval_trials,
        kind=kind,
        obstacles=ObstacleConfig(cfg.train.obstacles, "bot" if cfg.train.bots else "box"),
        opponents=opponents,
    )


def _reward(cfg: RunConfig) -> tuple[Reward | None, RewardCard]:
    """Return the reward of a file, or None for a built-in one, and what the card says of it."""
    if not cfg.reward.endswith(".py"):
        return None, RewardCard(name=cfg.reward)
    from league.deepracer import user_reward

    sim = make_env.env_config(cfg.train).sim
    cars = range(cfg.train.num_cars if cfg.self_play else 1)
    reward = user_reward(cfg.reward, cfg.train.num_worlds, cars, sim=sim)
    return reward, RewardCard(name=Path(cfg.reward).stem[:80], sha256=reward.source.digest)
