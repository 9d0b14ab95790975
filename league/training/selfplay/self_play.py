"""Self-play of a run: its pool, win rates and opponents."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from statistics import fmean
from typing import Any

import torch

from league.agents import roster
from league.agents.card import Card
from league.agents.checkpoint import Checkpoint
from league.agents.driver import Driver
from league.agents.policy import Policy
from league.errors import ConfigError, PolicyError
from league.track.track import TrackSet
from league.training.config import TrainConfig
from league.training.ppo import make_env
from league.training.ppo.learner import Learner
from league.training.selfplay import matches, opponents, payoff_matrix
from league.training.selfplay.opponents import PACER, Lineup, Opponent, Pacer, SpeedCap, WinRates
from league.training.selfplay.payoff_matrix import PayoffMatrix
from league.training.selfplay.pool import PARENT, Candidate, Member, Pool, spread
from league.training.selfplay.settings import PACER_SHARE, SelfPlayConfig, paces

NEWEST = "newest"
STATE_FORMAT = 3
_DRAWS_OF_AN_UPDATE = 1 << 20


class SelfPlay:
    """Opponents from the learner's own past.

    Pass `drivers()` to the worlds, call `begin` once before the first update, or `restore` in a
    resumed run, and `after_update` after each; save `state()` with the learner's state.
    """

    def __init__(
        self,
        folder: Path,
        tracks: TrackSet,
        train: TrainConfig,
        card: Card,
        *,
        cfg: SelfPlayConfig | None = None,
        parent: Checkpoint | None = None,
    ) -> None:
        """Build the opponents, which have no drivers until `begin` or `restore`.

        Args:
            folder: of the run; the pool is kept in `folder/pool`.
            tracks: of the worlds.
            train: settings of the run.
            card: of the snapshots, except for steps.
            cfg: settings of self-play.
            parent: the policy that training starts from, the pool's first member.

        Raises:
            ConfigError: a single car, or a parent with other sensors.
        """
        if train.num_cars < 2:
            raise ConfigError(f"self-play was asked for with {train.num_cars} car: give 2 to 8")
        if parent is not None and parent.card.sensors != train.sensors:
            raise ConfigError(
                f"the parent {parent.card.name!r} needs other sensors than the learner carries, "
                "and it would drive the learner's cars: give the run the parent's sensors"
            )
        self._tracks, self._train, self._card = tracks, train, card
        self._cfg = cfg or SelfPlayConfig()
        self._parent = parent
        self.win_rates = WinRates()
        self.pool = Pool(Path(folder) / "pool", self._cfg.pool_size)
        self._policies: dict[str, Policy] = {}
        self._done, self._quickness = 0.0, 0.0
        self._opponents = {
            car: Opponent(car, train.sensors, train.num_worlds, train.seed, self.win_rates)
            for car in range(1, train.num_cars)
        }
        self._car = make_env.env_config(train).sim.car
        # A scripted driver remembers its car, and knows one track only.
        self._scripted: dict[int, dict[Driver, float]] = {car: {} for car in self._opponents}
        if len(tracks.tracks) == 1 and self._cfg.scripted > 0:
            for car in self._opponents:
                pacer = Pacer(tracks.tracks[0], self._car, train.seed, car)
                slow = roster.load("centerline", tracks, self._car)
                self._scripted[car] = {slow: 1.0 - PACER_SHARE, pacer: PACER_SHARE}

    def drivers(self) -> Mapping[int, Driver]:
        """Return the driver of each car but the learner's."""
        return self._opponents

    def begin(self, learner: Learner) -> None:
        """Assign the first opponents: the learner as it is, its parent, scripted drivers."""
        if self._parent is not None:
            self.pool.add(self._parent, 0, forced=True, measured=None)
        self._assign(learner)

    def after_update(self, learner: Learner, done: float) -> bool:
        """Renew the newest opponent, and maybe the pool, at a save point; call after each update.

        Args:
            learner: after its update.
            done: share of the run's budget that is used up.

        Returns:
            Whether a snapshot entered the pool.
        """
        if not learner.at_save_point:
            return False
        before, self._done = self._done, min(max(done, 0.0), 1.0)
        self._quickness = self._cfg.quicker(self._quickness, self._beaten(), before, self._done)
        self.pool.sweep()
        entered = False
        every = self._cfg.candidate_every
        last = self.pool.candidates[-1].updates if self.pool.candidates else 0
        if learner.updates // every > last // every:
            entered = self._candidate(learner)
        self._assign(learner)
        self.pool.write(self._rates())
        return entered

    def schedule(self, done: float) -> float:
        """Return the progress of the learner's schedules, 0 to 1, at this share of the budget.

        They restart after the warm-up, at a save point.
        """
        warm_up, done = self._cfg.warm_up, min(max(done, 0.0), 1.0)
        if self._done < warm_up:
            return min(done / warm_up, 1.0)
        return self._cfg.part_done(max(done, warm_up))

    def state(self) -> dict[str, Any]:
        """Return all but the files of the pool as JSON-able data."""
        return {
            "format": STATE_FORMAT,
            **self.pool.state(),
            "records": self.win_rates.state(),
            "done": self._done,
            "quickness": self._quickness,
        }

    def restore(self, state: Mapping[str, Any], learner: Learner) -> None:
        """Resume from a state, with a learner that was restored to the same save point.

        Raises:
            PolicyError: it is no such state, or files of the pool are missing.
        """
        try:
            if state["format"] != STATE_FORMAT:
                raise KeyError("format")
            self.pool.restore(state["members"], state["tried"])
            self.win_rates.restore(state["records"])
            self._done, self._quickness = float(state["done"]), float(state["quickness"])
        except (KeyError, TypeError, ValueError) as error:
            raise PolicyError(
                f"the state of self-play cannot be resumed ({type(error).__name__}): "
                "start a new run with another --out"
            ) from None
        self._assign(learner)

    def log(self) -> dict[str, float]:
        """Return metrics: win rates in training, members, and the last candidate's win rates."""
        rates = self._rates()
        past = [rates[member.name] for member in self.pool.members]
        metrics = {
            "/selfplay/win_rate_newest": rates[NEWEST],
            "/selfplay/win_rate_smallest": min(past, default=rates[NEWEST]),
            "/selfplay/members": float(len(self.pool.members)),
        }
        last = self.pool.candidates[-1] if self.pool.candidates else None
        if last is not None and last.smallest is not None and last.mean is not None:
            metrics["/selfplay/candidate_smallest"] = last.smallest
            metrics["/selfplay/candidate_mean"] = last.mean
        return metrics

    def report(self, weights: Checkpoint) -> PayoffMatrix:
        """Race a trained policy, its past, its parent and `centerline` against each other."""
        chosen = spread(self.pool.members, self._cfg.matrix_members)
        first = self.pool.members[:1]
        if first and first[0].name == PARENT and first[0] not in chosen:
            chosen = [*first, *chosen]
        drivers: dict[str, Driver] = {}
        if len(self._tracks.tracks) == 1:
            drivers["centerline"] = roster.load("centerline", self._tracks, self._car)
        drivers |= {member.name: self._loaded(member) for member in chosen}
        drivers[payoff_matrix.FINAL] = self._built(weights, payoff_matrix.FINAL)
        return payoff_matrix.measure(self._tracks, self._car, drivers, self._cfg)

    def snapshot(self, name: str) -> tuple[int, Checkpoint]:
        """Return a member of the pool by name: its number of updates, and its checkpoint."""
        member = next(member for member in self.pool.members if member.name == name)
        return member.updates, self.pool.load(member)

    def _candidate(self, learner: Learner) -> bool:
        """Race the learner's weights for a place in the pool; return whether they entered."""
        snapshot = self._snapshot(learner)
        rivals = self._rivals()
        rates: dict[str, float] = {}
        if rivals:
            field = [self._built(snapshot, "candidate"), *map(self._loaded, rivals)]
            results = matches.race_pairs(
                self._tracks,
                self._car,
                field,
                [(0, place) for place in range(1, len(field))],
                self._cfg.match,
                races=self._cfg.races,
                seed=learner.updates,
            )
            rates = {one.name: results[0, place][0].win_rate for place, one in enumerate(rivals, 1)}
        wins = not rates or min(rates.values()) >= self._cfg.admission
        turn = (len(self.pool.candidates) + 1) % self._cfg.forced_every == 0
        enters = wins or turn
        tried = Candidate(learner.updates, rates, entered=enters, forced=enters and not wins)
        self.pool.candidates.append(tried)
        if not enters:
            return False
        self.pool.add(snapshot, tried.updates, forced=tried.forced, measured=tried.smallest)
        for member in self.pool.thin(lambda one: self.win_rates[one.name] < 0.5):
            self._policies.pop(member.name, None)
            self.win_rates.forget(member.name)
        return True

    def _rivals(self) -> list[Member]:
        """Return the members a candidate must beat: oldest, newest, then the hardest."""
        members = self.pool.members
        certain = members[:1] + members[1:][-1:]
        others = [member for member in members if member not in certain]
        others.sort(key=lambda member: (self.win_rates[member.name], member.updates))
        return (certain + others)[: self._cfg.rivals]

    def _assign(self, learner: Learner) -> None:
        """Resample the opponent of every row from the current pool.

        The first draw's number depends on the updates alone, so that a run that is resumed here
        draws the same.
        """
        newest = self._built(self._snapshot(learner), NEWEST)
        members = [self._policy(member) for member in self.pool.members]
        cfg, rates = self._cfg, self._rates()
        first = learner.updates * _DRAWS_OF_AN_UPDATE
        pace_range = paces(self._quickness)
        free = self._car.max_speed, self._car.max_speed
        limits = [free for _ in members]
        if cfg.handicap:
            tops = [policy.card.action_space.top_speed for policy in members]
            limits = [(pace_range[0] * top, pace_range[1] * top) for top in tops]
        newest_share, member_shares = opponents.shares(
            [rates[member.name] for member in self.pool.members],
            newest=cfg.newest,
            prioritised=cfg.prioritised,
            hardest=cfg.hardest,
        )
        for car, opponent in self._opponents.items():
            scripted = self._scripted[car]
            for driver in scripted:
                if isinstance(driver, Pacer):
                    driver.keep_between(pace_range, first)
            # Without scripted drivers the others have their share in proportion.
            own = (1.0 - cfg.scripted if scripted else 1.0) / (newest_share + sum(member_shares))
            lineup = Lineup(
                names=(NEWEST, *(m.name for m in self.pool.members), *(d.name for d in scripted)),
                drivers=(newest, *members, *scripted),
                shares=(
                    own * newest_share,
                    *(own * share for share in member_shares),
                    *(cfg.scripted * share for share in scripted.values()),
                ),
                speed_limits=(free, *limits, *(free for _ in scripted)),
            )
            opponent.choose_from(lineup, first)
        if cfg.handicap:
            learner.env.speed_limit = SpeedCap(self._train.action_space.top_speed, self._opponents)
        # Restarted, so that a run that is resumed here has the same meetings.
        learner.env.race_env.place_opponents(cfg.meeting(self._done, self._train.num_cars))
        learner.restart_rows()

    def _snapshot(self, learner: Learner) -> Checkpoint:
        return Checkpoint(
            self._card.model_copy(update={"steps": learner.samples}), learner.weights()
        )

    def _policy(self, member: Member) -> Policy:
        if member.name not in self._policies:
            self._policies[member.name] = self._loaded(member)
        return self._policies[member.name]

    def _loaded(self, member: Member) -> Policy:
        return self._built(self.pool.load(member), member.name)

    def _built(self, snapshot: Checkpoint, name: str) -> Policy:
        # A new network draws first weights from torch's generator, with which the learner explores.
        with torch.random.fork_rng(devices=[]):
            return Policy(snapshot, self._car, name=name)

    def _beaten(self) -> float:
        """Return the learner's mean win rate against slow opponents; 0 without any."""
        slow = [member.name for member in self.pool.members] if self._cfg.handicap else []
        if any(self._scripted.values()):
            slow.append(PACER)
        return fmean([self.win_rates[name] for name in slow] or [0.0])

    def _rates(self) -> dict[str, float]:
        names = [NEWEST, *(member.name for member in self.pool.members)]
        return {name: self.win_rates[name] for name in names}
