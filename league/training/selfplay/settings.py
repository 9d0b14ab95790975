"""Settings of self-play; docs/self_play.md says how they were chosen."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from league.envs.config import OpponentPlacement
from league.errors import ConfigError
from league.sim.config import Spread


@dataclass(frozen=True)
class DuelConfig:
    """A measuring race of two drivers."""

    laps: int = 2
    """Laps of a race; the second is a flying one."""
    spread: Spread = field(
        default_factory=lambda: Spread(grip=0.01, mass=0.01, steering_offset=0.003)
    )
    """How far the cars of a race differ: without it all races of two drivers would be one race.
    Mirrored races swap the drivers, not the cars, so it favours nobody."""
    slowest: float = 1.2
    """A race is stopped after its laps at this mean speed [m/s], and the grace."""
    grace_s: float = 10.0
    """Added to that, for a start and two penalties [s]."""
    at_once: int = 128
    """Races driven side by side."""


@dataclass(frozen=True)
class SelfPlayConfig:
    """How opponents are drawn, and what is kept of the past."""

    newest: float = 0.35
    """Share of episodes against the learner's own weights of the last save point."""
    prioritised: float = 0.45
    """Share against members of the pool, each in proportion to (1 - win rate) squared."""
    hardest: float = 0.10
    """Share against the member with the smallest win rate."""
    scripted: float = 0.10
    """Share against scripted drivers; only where all worlds are on one track."""
    pacers: float = 0.5
    """Part of that share that pacers have, the rest is `centerline`'s."""
    first_paces: tuple[float, float] = (0.4, 0.6)
    """Least and largest pace as the run begins: share of the racing line's that pacers drive, and
    of its top speed that a member may ask for."""
    last_paces: tuple[float, float] = (0.55, 0.8)
    """The same at the most: what is learnt on slow cars is learnt again on faster ones."""
    beaten: float = 0.5
    """Mean win rate against those who are slow from which on they become faster."""
    quickening: float = 2.0
    """How often they would come from the first paces to the last ones in the run after its warm-up,
    if they were beaten all the time."""
    handicap: bool = True
    """Whether members of the pool are held back to shares of their top speed, so that they can be
    passed, and the learner in some of its lone episodes, so that its later self can be."""
    own_share: float = 0.5
    """Part of the learner's lone episodes in which it is held back."""
    own_limits: tuple[float, float] = (0.35, 0.95)
    """Least and largest share of its top speed then."""
    warm_up: float = 0.3
    """Part of the run, at its start, in which the learner drives alone but for starting grids: who
    does not drive well alone does not learn to pass. The learner's schedules run through once for
    this part and once for the rest."""
    window: int = 400
    """Meetings remembered of each opponent."""
    pool_size: int = 48
    """Most members kept."""
    candidate_every: int = 16
    """Updates between two candidates; they come at save points."""
    forced_every: int = 4
    """Every so many candidates one enters without winning."""
    admission: float = 0.55
    """Smallest win rate against every member that is measured, to enter."""
    rivals: int = 6
    """Members that a candidate is measured against, the hardest first."""
    races: int = 8
    """Races against each of them, half from either slot."""
    matrix_members: int = 8
    """Members in the win matrix, spread over the run in ratios of age."""
    matrix_races: int = 16
    """Races of each pair in the win matrix, half from either slot."""
    duel: DuelConfig = field(default_factory=DuelConfig)
    """The measuring races."""

    def with_scripted(self, share: float) -> SelfPlayConfig:
        """Return the settings with another share of scripted drivers, the rest in proportion."""
        if not 0 <= share < 1:
            raise ConfigError(f"the share of scripted drivers is {share}: give 0 to below 1")
        rest = (1.0 - share) / (1.0 - self.scripted)
        return replace(
            self,
            newest=self.newest * rest,
            prioritised=self.prioritised * rest,
            hardest=self.hardest * rest,
            scripted=share,
        )

    def meeting(self, done: float, num_cars: int = 2) -> OpponentPlacement:
        """Return how so many cars meet when so much of the run is done."""
        usual, more = OpponentPlacement(), max(num_cars - 4, 0)
        # More than four about the learner would stand on each other's places, and those at the far
        # end of a starting grid, 0.75 m for each car, would count as left behind at once.
        usual = replace(usual, reach=usual.reach + 0.5 * more, lost=usual.lost + 0.8 * more)
        if done >= self.warm_up:
            return usual
        return replace(usual, alone=1.0 - usual.standing)

    def part_done(self, done: float) -> float:
        """Return how much of the warm-up, or else of the rest, is done: 0 to 1 twice."""
        if done < self.warm_up:
            return done / self.warm_up
        return (done - self.warm_up) / (1.0 - self.warm_up)

    def quicker(self, quickness: float, beaten: float, before: float, done: float) -> float:
        """Return how far the slow ones are from first (0) to last paces (1).

        Args:
            quickness: where they were.
            beaten: mean win rate against them.
            before: share of the run that was done then.
            done: share that is done now.
        """
        if done < self.warm_up or beaten < self.beaten:
            return quickness
        # A run that is given more time goes on at a smaller share of it.
        passed = max(done - max(before, self.warm_up), 0.0) / (1.0 - self.warm_up)
        return min(quickness + self.quickening * passed, 1.0)

    def paces(self, quickness: float) -> tuple[float, float]:
        """Return least and largest pace, as shares, so far between first (0) and last ones (1)."""
        first, last = self.first_paces, self.last_paces
        least, most = (a + quickness * (b - a) for a, b in zip(first, last, strict=True))
        return least, most

    def __post_init__(self) -> None:
        shares = (self.newest, self.prioritised, self.hardest, self.scripted)
        if min(shares) < 0 or abs(sum(shares) - 1.0) > 1e-6:
            raise ConfigError(
                f"the shares of opponents are {shares}: give four from 0 to 1 that add up to 1"
            )
        for name in ("pacers", "own_share", "beaten"):
            if not 0 <= getattr(self, name) <= 1:
                raise ConfigError(f"{name} is {getattr(self, name)}: give a share from 0 to 1")
        if not 0 < self.quickening < 1000:
            raise ConfigError(f"quickening is {self.quickening}: give more than 0 and below 1000")
        if not 0 <= self.warm_up < 1:
            raise ConfigError(f"warm_up is {self.warm_up}: give a share from 0 to below 1")
        for name in ("first_paces", "last_paces", "own_limits"):
            if not 0.1 <= (ends := getattr(self, name))[0] <= ends[1] <= 1:
                raise ConfigError(f"{name} is {ends}: give two shares from 0.1 to 1 that rise")
        if not self.newest:
            raise ConfigError("newest is 0: give a share, at first there is nobody else")
        for name in ("races", "matrix_races"):
            if getattr(self, name) < 2 or getattr(self, name) % 2:
                raise ConfigError(
                    f"{name} is {getattr(self, name)}: give an even number, half for either slot"
                )
        for name in ("window", "candidate_every", "forced_every", "rivals", "matrix_members"):
            if getattr(self, name) < 1:
                raise ConfigError(f"{name} is {getattr(self, name)}: give at least 1")
        if self.pool_size < 4:
            raise ConfigError(f"pool_size is {self.pool_size}: give at least 4")
