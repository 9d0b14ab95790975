"""Self-play: the one holder of the pool, the results and the opponents of a run."""

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
from league.training.ppo import make_env
from league.training.ppo.learner import Learner
from league.training.selfplay import matches, opponent, payoff_matrix
from league.training.selfplay.handicap import Handicap
from league.training.selfplay.opponent import Field, Opponent
from league.training.selfplay.payoff_matrix import WinMatrix
from league.training.selfplay.pool import PARENT, Candidate, Member, Pool, spread
from league.training.selfplay.settings import SelfPlayConfig
from league.training.selfplay.speed_cap import PACER, Pacer
from league.training.selfplay.win_rates import Records
from league.training.settings import TrainConfig

NEWEST = "newest"
STATE_FORMAT = 3
_DRAWS_OF_AN_UPDATE = 1 << 20


class SelfPlay:
    """What a run must do so that its learner races its own past.

    Give `drivers()` to the worlds, call `begin` once before the first update, or `restore` instead
    when a run goes on, and `after_update` after each; keep `state()` with the learner's state.
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
        """Build the opponents' seats; they are empty until `begin` or `restore`.

        Args:
            folder: of the run; the pool is kept in `folder/pool`.
            tracks: the courses of the worlds.
            train: settings of the run.
            card: what the cards of snapshots say but for steps.
            cfg: settings of self-play.
            parent: the policy the learner begins from, the pool's first member.

        Raises:
            ConfigError: nobody to race against, or a parent with other sensors.
        """
        if train.num_cars < 2:
            raise ConfigError(f"self-play was asked for with {train.num_cars} car: give 2 to 8")
        if parent is not None and parent.card.sensor_config != train.sensors:
            raise ConfigError(
                f"the parent {parent.card.name!r} needs other sensors than the learner carries, "
                "whose cars it would drive: give the run the parent's sensors"
            )
        self._tracks, self._train, self._card = tracks, train, card
        self._cfg = cfg or SelfPlayConfig()
        self._parent = parent
        self.records = Records(self._cfg.window)
        self.pool = Pool(Path(folder) / "pool", self._cfg.pool_size)
        self._policies: dict[str, Policy] = {}
        self._done, self._quickness = 0.0, 0.0
        self._seats = {
            car: Opponent(car, train.sensors, train.num_worlds, train.seed, self.records)
            for car in range(1, train.num_cars)
        }
        self._car = make_env.env_config(train).sim.car
        # A driver that remembers is one car's alone; with several tracks there are none.
        one_track = len(tracks.tracks) == 1 and self._cfg.scripted > 0
        self._scripted = {car: self._teachers(car) if one_track else {} for car in self._seats}

    def drivers(self) -> Mapping[int, Driver]:
        """Return who drives each car but the learner's."""
        return self._seats

    def begin(self, learner: Learner) -> None:
        """Seat the first opponents: the learner as it is, its parent, scripted drivers."""
        if self._parent is not None:
            self.pool.add(self._parent, 0, forced=True, measured=None)
        self._seat(learner)

    def after_update(self, learner: Learner, done: float) -> bool:
        """Renew the newest opponent, and maybe the pool, at a save point; call after each update.

        Args:
            learner: who races.
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
        self._seat(learner)
        self.pool.write(self._win_rates())
        return entered

    def schedule(self, done: float) -> float:
        """Return where the learner's schedules stand when this share of the budget is used up.

        They restart when meetings change, which is at a save point.
        """
        warm_up, done = self._cfg.warm_up, min(max(done, 0.0), 1.0)
        if self._done < warm_up:
            return min(done / warm_up, 1.0)
        return self._cfg.part_done(max(done, warm_up))

    def state(self) -> dict[str, Any]:
        """Return all that is remembered but the files of the pool, JSON-able."""
        return {
            "format": STATE_FORMAT,
            **self.pool.state(),
            "records": self.records.state(),
            "done": self._done,
            "quickness": self._quickness,
        }

    def restore(self, state: Mapping[str, Any], learner: Learner) -> None:
        """Go on from a state, with a learner that was restored to the same save point.

        Raises:
            PolicyError: it is no such state, or the pool's files are gone.
        """
        try:
            if state["format"] != STATE_FORMAT:
                raise KeyError("format")
            self.pool.restore(state["members"], state["tried"])
            self.records.restore(state["records"])
            self._done, self._quickness = float(state["done"]), float(state["quickness"])
        except (KeyError, TypeError, ValueError) as error:
            raise PolicyError(
                f"the state of self-play cannot be resumed ({type(error).__name__}): "
                "start a new run with another --out"
            ) from None
        self._seat(learner)

    def log(self) -> dict[str, float]:
        """Return figures for a log: win rates in training, members, how the last candidate did.

        The last candidate's win rates are missing until one was measured.
        """
        rates = self._win_rates()
        past = [rates[member.name] for member in self.pool.members]
        told = {
            "/selfplay/win_rate_newest": rates[NEWEST],
            "/selfplay/win_rate_smallest": min(past, default=rates[NEWEST]),
            "/selfplay/members": float(len(self.pool.members)),
        }
        last = self.pool.candidates[-1] if self.pool.candidates else None
        if last is not None and last.smallest is not None and last.mean is not None:
            told["/selfplay/candidate_smallest"] = last.smallest
            told["/selfplay/candidate_mean"] = last.mean
        return told

    def report(self, weights: Checkpoint, *, seed: int = 0) -> WinMatrix:
        """Race a trained policy, its past, its parent and `centerline` against each other.

        Args:
            weights: the trained policy, the last row of the matrix.
            seed: makes the races' seeds.
        """
        chosen = spread(self.pool.members, self._cfg.matrix_members)
        first = self.pool.members[:1]
        if first and first[0].name == PARENT and first[0] not in chosen:
            chosen = [*first, *chosen]
        drivers: dict[str, Driver] = {}
        if len(self._tracks.tracks) == 1:
            drivers["centerline"] = roster.load("centerline", self._tracks, self._car)
        drivers |= {member.name: self._racer(member) for member in chosen}
        drivers[payoff_matrix.FINAL] = self._built(weights, payoff_matrix.FINAL)
        return payoff_matrix.measure(self._tracks, self._car, drivers, self._cfg, seed=seed)

    def snapshot(self, name: str) -> tuple[int, Checkpoint]:
        """Return a member of the pool by name: the updates after which it was taken, and it."""
        member = next(one for one in self.pool.members if one.name == name)
        return member.updates, self.pool.load(member)

    def _candidate(self, learner: Learner) -> bool:
        """Have the learner's weights race for a place in the pool."""
        snapshot = self._snapshot(learner)
        rivals = self._rivals()
        rates: dict[str, float] = {}
        if rivals:
            field = [self._built(snapshot, "candidate"), *map(self._racer, rivals)]
            found = matches.meet(
                self._tracks,
                self._car,
                field,
                [(0, place) for place in range(1, len(field))],
                self._cfg.duel,
                races=self._cfg.races,
                seed=learner.updates,
            )
            rates = {one.name: found[0, place][0].win_rate for place, one in enumerate(rivals, 1)}
        wins = not rates or min(rates.values()) >= self._cfg.admission
        turn = (len(self.pool.candidates) + 1) % self._cfg.forced_every == 0
        enters = wins or turn
        tried = Candidate(learner.updates, rates, entered=enters, forced=enters and not wins)
        self.pool.candidates.append(tried)
        if not enters:
            return False
        self.pool.add(snapshot, tried.updates, forced=tried.forced, measured=tried.smallest)
        for member in self.pool.thin(lambda one: self.records.win_rate(one.name) < 0.5):
            self._policies.pop(member.name, None)
            self.records.forget(member.name)
        return True

    def _rivals(self) -> list[Member]:
        """Return whom a candidate must beat: the oldest, the newest, and who beats the learner."""
        members = self.pool.members
        certain = members[:1] + members[1:][-1:]
        others = [member for member in members if member not in certain]
        others.sort(key=lambda member: (self.records.win_rate(member.name), member.updates))
        return (certain + others)[: self._cfg.rivals]

    def _seat(self, learner: Learner) -> None:
        """Let all cars be driven by whoever there is now, drawn anew.

        The number of the first draw is told by the updates alone, so that a run that goes on from
        here draws what it would have drawn.
        """
        newest = self._built(self._snapshot(learner), NEWEST)
        members = [self._policy(member) for member in self.pool.members]
        cfg, rates = self._cfg, self._win_rates()
        first = learner.updates * _DRAWS_OF_AN_UPDATE
        paces = cfg.paces(self._quickness)
        free = self._car.max_speed, self._car.max_speed
        for car, seat in self._seats.items():
            scripted = self._scripted[car]
            for driver in scripted:
                if isinstance(driver, Pacer):
                    driver.keep_between(paces, first)
            part, each = opponent.shares(
                [rates[member.name] for member in self.pool.members],
                newest=cfg.newest,
                prioritised=cfg.prioritised,
                hardest=cfg.hardest,
            )
            # Without scripted drivers the others have their share in proportion.
            own = (1.0 - cfg.scripted if scripted else 1.0) / (part + sum(each))
            field = Field(
                names=(NEWEST, *(m.name for m in self.pool.members), *(d.name for d in scripted)),
                drivers=(newest, *members, *scripted),
                shares=(
                    own * part,
                    *(own * share for share in each),
                    *(cfg.scripted * share for share in scripted.values()),
                ),
                speed_limits=(
                    free,
                    *(_held(one, paces) if cfg.handicap else free for one in members),
                    *(free for _ in scripted),
                ),
            )
            seat.choose_from(field, first)
        if cfg.handicap:
            top_speed = self._train.action_space.top_speed
            learner.env.speed_limit = Handicap(cfg, top_speed, self._seats)
        # Anew, so that a run that goes on from here begins with the same meetings.
        learner.env.race_env.place_opponents(cfg.meeting(self._done, self._train.num_cars))
        learner.start_rows_anew()

    def _teachers(self, car: int) -> dict[Driver, float]:
        """Return the scripted drivers of a car, each with its part of their share."""
        pacers = self._cfg.pacers
        tracks, seed = self._tracks, self._train.seed
        pacer = Pacer(tracks.tracks[0], self._car, seed, car)
        slow = roster.load("centerline", self._tracks, self._car)
        return {slow: 1.0 - pacers, pacer: pacers}

    def _snapshot(self, learner: Learner) -> Checkpoint:
        return Checkpoint(
            self._card.model_copy(update={"steps": learner.samples}), learner.weights()
        )

    def _policy(self, member: Member) -> Policy:
        if member.name not in self._policies:
            self._policies[member.name] = self._built(self.pool.load(member), member.name)
        return self._policies[member.name]

    def _racer(self, member: Member) -> Policy:
        """Return a member that answers a row alike among any others, to be measured with."""
        return self._built(self.pool.load(member), member.name)

    def _built(self, kept: Checkpoint, name: str) -> Policy:
        # A new network draws first weights from torch's generator, with which the learner explores.
        with torch.random.fork_rng(devices=[]):
            return Policy(kept, self._car, name=name)

    def _beaten(self) -> float:
        """Return the learner's mean win rate against those who are slow; 0 if there are none."""
        slow = [member.name for member in self.pool.members] if self._cfg.handicap else []
        if any(self._scripted.values()):
            slow.append(PACER)
        return fmean([self.records.win_rate(name) for name in slow] or [0.0])

    def _win_rates(self) -> dict[str, float]:
        names = [NEWEST, *(member.name for member in self.pool.members)]
        return {name: self.records.win_rate(name) for name in names}


def _held(policy: Policy, paces: tuple[float, float]) -> tuple[float, float]:
    """Return the least and largest speed [m/s] at these shares of a policy's top speed."""
    top_speed = policy.card.space.top_speed
    return paces[0] * top_speed, paces[1] * top_speed
