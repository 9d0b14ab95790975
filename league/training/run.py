"""A training run: learn, judge, save, show; from its settings to best.pt, and on after a kill."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING

from league import __version__
from league.agents import checkpoint, roster
from league.agents.card import Card
from league.agents.card import Reward as RewardCard
from league.agents.checkpoint import Checkpoint
from league.atomic_file import replacing
from league.envs import rewards
from league.envs.driver import Driver
from league.envs.rewards import Reward
from league.errors import ConfigError, LeagueError, PolicyError
from league.training import checks, run_config, run_folder, track_selection
from league.training.evaluator import Exam, Judge, Judgement, judged
from league.training.monitor.history import History
from league.training.ppo import distributed, make_env
from league.training.ppo.learner import Learner, Update
from league.training.ppo.teacher import tutored
from league.training.run_config import RunConfig
from league.training.selfplay import SelfPlay, SelfPlayConfig, payoff_matrix
from league.training.selfplay.payoff_matrix import FINAL, PayoffMatrix

if TYPE_CHECKING:
    from league.racing.table import Evaluation
    from league.training.monitor.callback import TrainingCallback


CRITIC_FIRST = 4
"""Updates from which only the critic learns, where the actor begins as another policy."""


@dataclass(frozen=True)
class Outcome:
    """What a run has come to."""

    best: Path
    """The best policy."""
    evaluation: Evaluation | None
    """Its evaluation."""
    samples: int
    """Decisions learnt from."""
    time_s: float
    """Learning time, of earlier parts too [s]."""
    why: str
    """Why it stopped."""
    matrix: PayoffMatrix | None = None
    """Of self-play: who beats whom."""


class Run:
    """One training run in its folder: best.pt, last.pt, state.pt, history.jsonl, settings.json.

    Of several ranks (torchrun) all learn, and the first one alone writes, judges and tells.
    """

    def __init__(self, cfg: RunConfig, folder: Path, *, beside: bool = True) -> None:
        """Build worlds, learner and judge; nothing is written before the first update.

        Args:
            cfg: settings.
            folder: of this run alone.
            beside: whether to judge in a process of its own.

        Raises:
            LeagueError: unknown tracks, rewards or drivers, or settings that contradict.
        """
        self.cfg, self.folder = cfg, folder
        if not cfg.reward.endswith(".py"):
            ways = 2 if cfg.train.both_directions else 1
            rewards.check_name(cfg.reward, ways * track_selection.count(cfg.tracks))
        self._tracks = track_selection.load(cfg.tracks)
        self._exam = _exam(cfg, self._tracks)
        train = cfg.train
        self._parents: tuple[str, ...] = ()
        self._reward, self._reward_card = _reward(cfg)
        self._spent_s, self._complete = 0.0, 0
        checks.card(self._card)
        # Each rank its own card, before any is touched.
        train = replace(train, device=distributed.device(train.device))
        checks.device(train.device)
        if cfg.self_play and distributed.count() > 1:
            raise ConfigError(
                f"self-play learns in one process, and torchrun has started {distributed.count()}: "
                "start it without torchrun, or omit --self-play"
            )
        if train.tutor and (cfg.self_play or cfg.init_from):
            other = "--self-play" if cfg.self_play else "--init-from"
            raise ConfigError(
                f"a tutor teaches a policy that knows nothing yet: omit --tutor or {other}"
            )
        tracks = track_selection.together(self._tracks, train.both_directions)
        self.train = train
        self._parent = checkpoint.load(cfg.init_from) if cfg.init_from else None
        if self._parent is not None:
            self._parents = (self._parent.digest, *self._parent.card.parents)[:64]
        self._self_play: SelfPlay | None = None
        opponents: Mapping[int, Driver | str] = dict(enumerate(cfg.opponents, 1))
        if cfg.self_play:
            self._self_play = SelfPlay(
                self.folder,
                tracks,
                train,
                self._card(),
                cfg=SelfPlayConfig(handicap=cfg.handicap).with_scripted(cfg.scripted_share),
                parent=self._parent,
            )
            opponents = self._self_play.drivers()
        # After what is refused at once, and before what takes seconds: it loads meanwhile.
        self._judge = Judge(self._exam, beside=beside and distributed.is_first())
        if self._reward is None:
            car = make_env.env_config(train).sim.car
            self._reward = rewards.built_in(cfg.reward, tracks, car)
        with checks.memory():
            if train.tutor:
                self.learner = tutored(tracks, train, opponents=opponents, reward=self._reward)
            else:
                env = make_env.make(tracks, train, opponents=opponents, reward=self._reward)
                self.learner = Learner(env, train)
        if self._parent is not None:
            self.learner.begin(dict(self._parent.weights))
        self._waiting: dict[int, Checkpoint] = {}
        self._best: tuple[float, ...] | None = None
        self._best_evaluation: Evaluation | None = None
        self.history = History()
        self._matrix: PayoffMatrix | None = None
        self._lock: int | None = None

    def resume(self) -> None:
        """Go on from the folder's state, with the settings it was begun with.

        A budget other than the folder's is taken over; the schedules then follow the whole of it.

        Raises:
            PolicyError: there is none, or it is of another run.
        """
        if not (self.folder / "state.pt").exists():
            raise PolicyError(
                f"{self.folder / 'state.pt'} cannot be resumed: the run stopped before its "
                "first save point, so begin it anew, without --resume"
            )
        notes = self.learner.restore(self.folder / "state.pt")
        if self._self_play is not None:
            self._self_play.restore(json.loads(notes["self_play"]), self.learner)
        self._spent_s = float(notes["spent_s"])
        self._complete = int(notes["complete"])
        self._best = tuple(notes["best"]) or None
        more = not self.cfg.has_budget_of(run_config.settings(self.folder))
        if more:
            self._complete = 0  # whoever gives more time wants more than complete laps
        distributed.wait()  # all have read before the first one writes
        if not distributed.is_first():
            return
        self._lock = run_folder.lock(self.folder)
        self.history.close()
        self.history = History.resumed(self.folder / "history.jsonl", self.learner.updates)
        if more and not self.over:
            run_config.keep(self.cfg, self.folder)  # a kill goes on with it, too

    @property
    def over(self) -> str:
        """Why there is nothing more to learn; empty while there is."""
        cfg = self.cfg
        if self.learner.updates and not self.learner.has_learnt:
            return ""  # a tutor alone is no outcome: its policy has an update at least
        if cfg.stop_when_complete and self._complete >= cfg.stop_when_complete:
            return "every lap was complete"
        if cfg.steps and self.learner.samples >= cfg.steps:
            return "the steps were driven"
        return "the time was up" if self._share() >= 1.0 else ""

    @property
    def spent_s(self) -> float:
        """Learning time so far, of earlier parts too [s]."""
        return self._spent_s

    def close(self) -> None:
        """Let go of worlds, judge, history and folder; what is not saved is lost."""
        run_folder.unlock(self._lock)
        self._lock = None
        self._judge.close()
        self.history.close()
        for env in self.learner.shown:
            env.close()

    def learn(self, onlookers: Sequence[TrainingCallback] = ()) -> Outcome:
        """Learn until the budget is spent or all is complete; Ctrl-C saves and raises."""
        try:
            if self.learner.updates == 0 and distributed.is_first():
                self._prepare()
        except BaseException:
            self.close()
            raise
        # A run that was killed while its last policy was judged has nothing more to learn.
        started = time.perf_counter() - self._spent_s
        try:
            with distributed.stopping_together() as stopping_place:
                while not distributed.agreed(bool(self.over)):
                    update = self._updated()
                    self._spent_s = time.perf_counter() - started
                    if distributed.is_first():
                        self._after(update, onlookers)
                    stopping_place()
            why = self.over
            distributed.close()  # what is left is done by the first rank alone
            if distributed.is_first():
                self._finish(onlookers)
        except LeagueError:
            # The user's reward function failed, say: what was learnt stays.
            self._save()
            raise
        except KeyboardInterrupt:
            self._save()
            raise
        finally:
            self.close()
            for onlooker in onlookers:
                onlooker.close()
        return Outcome(
            best=self.folder / "best.pt",
            evaluation=self._best_evaluation,
            samples=self.learner.samples,
            time_s=self._spent_s,
            why=why,
            matrix=self._matrix,
        )

    def _after(self, update: Update, onlookers: Sequence[TrainingCallback]) -> None:
        """Tell of an update; at a save point judge and save, too."""
        self.history.add_update(update, self.learner.episodes, self._spent_s)
        for onlooker in onlookers:
            onlooker.update(self.history, update)
        if self.learner.at_save_point:
            self._save_point(update, onlookers)
        elif self._learnt_all():
            self._take(onlookers, wait=False)

    @checks.memory()
    def _updated(self) -> Update:
        share = self._share()
        if self._self_play is not None:
            share = self._self_play.schedule(share)
        update = self.learner.update(share)
        if self._parent is not None and self._only_watches(update.number):
            # A critic that knows nothing yet would spoil what the parent knows.
            self.learner.begin(dict(self._parent.weights))
        if self._self_play is not None:
            self._self_play.after_update(self.learner, self._share())
            update = replace(update, log=update.log | self._self_play.log())
        return update

    def _only_watches(self, number: int) -> bool:
        """Whether the actor was still its parent after this update."""
        return self._parent is not None and number <= CRITIC_FIRST

    def _prepare(self) -> None:
        """Write the settings, and begin the history."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise PolicyError(
                f"the folder {self.folder} cannot be made ({error.strerror}): give --out a place "
                "that can be written"
            ) from None
        self._lock = run_folder.lock(self.folder)
        run_config.keep(self.cfg, self.folder)
        run_folder.clear(self.folder)
        if self._self_play is not None:
            self._self_play.begin(self.learner)
        self.history = History(self.folder / "history.jsonl")

    def _share(self) -> float:
        cfg = self.cfg
        by_time = self._spent_s / (60.0 * cfg.minutes) if cfg.minutes else 0.0
        by_steps = self.learner.samples / cfg.steps if cfg.steps else 0.0
        return max(by_time, by_steps)

    def _save_point(self, update: Update, onlookers: Sequence[TrainingCallback]) -> None:
        self._take(onlookers, wait=False)
        due = (update.number // self.cfg.train.save_every) % self.cfg.exam_every == 0
        # A parent that is only watched yet is not what was learnt, nor is the tutor.
        due = due and self.learner.has_learnt and not self._only_watches(update.number)
        # A judge that is still busy is not waited for: this policy goes without an evaluation.
        if due and not self._judge.waiting:
            self._hand(update.number)
            self._take(onlookers, wait=False)
        # Last, so that the state knows of the best.pt that lies beside it.
        self._save()

    def _learnt_all(self) -> bool:
        """Whether a judgement has come that ends the run.

        All others wait for a save point: a run that is killed before it would lose them.
        """
        in_a_row = self._complete
        for judgement in self._judge.come() if self.cfg.stop_when_complete else ():
            in_a_row = in_a_row + 1 if judgement.evaluation.all_complete else 0
            if in_a_row >= self.cfg.stop_when_complete:
                return True
        return False

    def _hand(self, number: int) -> None:
        self._waiting[number] = self._checkpoint()
        self._judge.hand(number, self._waiting[number])

    def _take(self, onlookers: Sequence[TrainingCallback], *, wait: bool) -> None:
        started = time.perf_counter()
        for judgement in self._judge.take(wait=wait):
            waited = time.perf_counter() - started if wait else 0.0
            self._note(judgement, waited, onlookers)

    def _note(
        self, found: Judgement, waited_s: float, onlookers: Sequence[TrainingCallback]
    ) -> None:
        evaluation, policy = found.evaluation, self._waiting.pop(found.number)
        self._complete = self._complete + 1 if evaluation.all_complete else 0
        merit = _merit(evaluation)
        if self._self_play is not None:
            # Lap times do not tell who wins duels: of those that come as far, the newest has had
            # all others to learn from.
            merit = (*merit[:2], float(found.number))
        best = self._best is None or merit > self._best
        if best:
            self._best = merit
            self._keep_best(policy, found.number, evaluation)
        self.history.add_evaluation(
            evaluation, time_s=self._spent_s, took_s=waited_s, best=best, number=found.number
        )
        for onlooker in onlookers:
            onlooker.evaluated(self.history, evaluation)

    def _keep_best(self, policy: Checkpoint, updates: int, evaluation: Evaluation) -> None:
        self._best_evaluation = evaluation
        results = {"updates": float(updates), **evaluation.summary}
        card = policy.card.model_copy(update={"results": results})
        checkpoint.save(self.folder / "best.pt", replace(policy, card=card, text=""))

    @checks.memory()
    def _finish(self, onlookers: Sequence[TrainingCallback]) -> None:
        """Judge the last policy too, wait for all judgements, and write down what came of them."""
        self._save()
        complete = self.cfg.stop_when_complete and self._complete >= self.cfg.stop_when_complete
        last = self.learner.updates
        if not complete and last not in {*self._waiting, *self._judged}:
            self._hand(last)
        while self._waiting and not complete:
            self._take(onlookers, wait=True)
        best = self.folder / "best.pt"
        if self._best_evaluation is None and self._self_play is None and best.exists():
            # It was judged before a resume, which keeps no table.
            self._best_evaluation = judged(self._exam, checkpoint.load(best))
        if self._self_play is not None:
            for onlooker in onlookers:
                onlooker.racing("racing the policy against its past for the win matrix")
            self._crown(self._self_play)
        self._save()

    def _crown(self, self_play: SelfPlay) -> None:
        """Race the policy against its past; whoever wins most of these races is the best."""
        policy, updates = self._checkpoint(), self.learner.updates
        found = self._matrix = self_play.report(policy)
        found.write(self.folder / "win_matrix.json")
        payoff_matrix.draw(found, self.folder / "win_matrix.png")
        if found.champion != FINAL:
            updates, kept = self_play.snapshot(found.champion)
            spent_s = next(row.time_s for row in self.history.updates if row.number == updates)
            policy = replace(kept, card=self._card(kept.card.steps, spent_s), text="")
        self._keep_best(policy, updates, judged(self._exam, policy))

    @property
    def _judged(self) -> set[int]:
        """Updates after which a policy has been judged."""
        return {row.number for row in self.history.evaluations}

    def _save(self) -> None:
        if self.learner.updates == 0 or not distributed.is_first():
            return
        if self.learner.has_learnt:
            checkpoint.save(self.folder / "last.pt", self._checkpoint())
        notes: dict[str, object] = {
            "spent_s": self._spent_s,
            "complete": self._complete,
            "best": list(self._best or ()),
        }
        if self._self_play is not None:
            notes["self_play"] = json.dumps(self._self_play.state())
        self.learner.save(self.folder / "state.pt", notes)
        printed = getattr(self._reward, "printed", ())  # of a reward file, not of a built-in one
        if printed:
            path = self.folder / run_folder.PRINTED
            with replacing(path, "what the reward function printed", PolicyError) as file:
                file.write_text("".join(f"{line}\n" for line in printed), encoding="utf-8")

    def _checkpoint(self) -> Checkpoint:
        return Checkpoint(self._card(self.learner.samples), self.learner.weights())

    def _card(self, samples: int = 0, spent_s: float | None = None) -> Card:
        cfg = self.cfg
        return Card(
            name=cfg.name,
            sensors=cfg.train.sensors,
            action_space=cfg.train.action_space,
            network=cfg.train.network,
            tracks=tuple(name[-80:] for name in cfg.tracks),
            kind=cfg.train.kind,
            reward=self._reward_card,
            steps=samples,
            train_s=round(self._spent_s if spent_s is None else spent_s, 1),
            seed=cfg.train.seed,
            parents=self._parents,
            licence=cfg.licence,
            league_version=__version__,
            command=cfg.command,
        )


def _merit(evaluation: Evaluation) -> tuple[float, ...]:
    """Return what the best policy has most of: laps, then how far it came, then pace.

    Against others places count before all that: who wins has driven well enough.
    """
    mean = evaluation.mean_lap_s
    laps = evaluation.complete_laps / evaluation.asked
    driven = (laps, round(evaluation.completion, 3), -mean if mean is not None else -1e9)
    return (-fmean(evaluation.places), *driven) if evaluation.places else driven


def _exam(cfg: RunConfig, tracks: list) -> Exam:
    asked = (
        track_selection.load(cfg.exam_tracks)
        if cfg.exam_tracks
        else track_selection.to_judge_on(cfg.tracks)
    )
    # Who learns to race others is judged by racing them; of self-play the matrix tells.
    opponents = cfg.exam_opponents or cfg.opponents
    for name in opponents:
        roster.check(name)
    return Exam(
        tracks=tuple(asked),
        laps=cfg.exam_laps,
        trials=cfg.exam_trials,
        kind=cfg.train.kind if cfg.train.kind != "head_to_head" else "time_trial",
        obstacles=cfg.train.obstacles,
        bots=cfg.train.bots,
        opponents=opponents,
    )


def _reward(cfg: RunConfig) -> tuple[Reward | None, RewardCard]:
    """Return the reward of a file, or None for a built-in one, and what the card says of it."""
    if not cfg.reward.endswith(".py"):
        return None, RewardCard(name=cfg.reward)
    from league.deepracer import user_reward

    sim = make_env.env_config(cfg.train).sim
    reward = user_reward(cfg.reward, cfg.train.num_worlds, (0,), sim=sim)
    return reward, RewardCard(name=Path(cfg.reward).stem[:80], sha256=reward.source.digest)
